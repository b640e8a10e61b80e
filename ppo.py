"""Proximal policy optimization: the update of a policy from one rollout, in lines 9 and 11 of Algorithm 1.

It knows nothing of EIPO. It takes one advantage for each sample, in which the streams of `eipo.py` are mixed already.
The widths D, P, A and K are those of `networks.py`. Everything here is compiled.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax

from networks import init_mlp, log_prob, policy, value
from runtime.parallel import average, compiled

LOG_STD_RANGE = (-4.0, 1.0)  # [ours] of log_std, so that the policy's noise can neither vanish nor explode (D40)
LR_RANGE = (1e-5, 1e-3)  # of an adapted step size: the least is the lab's, the greatest is the paper's (D20)


class Learner(NamedTuple):
    """A policy and what its training keeps."""

    params: dict  # {"actor": {"layers", "log_std"}, "critic": layers, "estimator": layers}
    opt_state: tuple  # of `optimizer`
    lr: jax.Array  # () Adam's step size now, one for all three networks (D32)


@partial(jax.jit, static_argnames=("sizes", "heads", "cfg"))
def init_learner(key, sizes, heads, cfg):
    """A new Learner, whose networks are random.

    sizes: for each of obs, privileged and action, how many coordinates are even and how many odd (see `networks.py`)
    heads: K, outputs of the critic: 2 for pi (task, cost), 1 for pi_prime (task) (D30)
    """
    obs, privileged, action = sizes
    both = obs[0] + privileged[0], obs[1] + privileged[1]
    hidden, hidden_estimator = ([(n // 2, n // 2) if obs[1] else (n, 0) for n in widths]
                                for widths in (cfg.hidden, cfg.hidden_estimator))  # fmt: skip
    k_actor, k_critic, k_estimator = jax.random.split(key, 3)
    actor = init_mlp(k_actor, (both, *hidden, action))
    critic = init_mlp(k_critic, (both, *hidden, (heads, 0)))
    estimator = init_mlp(k_estimator, (obs, *hidden_estimator, privileged))
    log_std = jnp.full(action[0], cfg.log_std, jnp.float32)
    params = dict(actor=dict(layers=actor, log_std=log_std), critic=critic, estimator=estimator)
    return Learner(params, optimizer(cfg).init(params), jnp.float32(cfg.lr))


def optimizer(cfg):
    """Adam without its step size. Gradients are clipped network by network (D39), non-finite ones are skipped (D44)."""
    clip = {name: optax.clip_by_global_norm(cfg.max_grad_norm) for name in ("actor", "critic", "estimator")}
    direction = optax.chain(optax.partition(clip, {name: name for name in clip}), optax.scale_by_adam(b1=0.9, b2=0.999))
    return optax.apply_if_finite(direction, max_consecutive_errors=2**30)


def ppo_update(learner, tau, estimate, advantage, key, cfg):
    """All epochs and minibatches of one iteration; returns the new Learner and the log.

    log: the means of what `ppo_loss` logs; lr; how many gradients were skipped since the start

    advantage: (T, N), mixed. It is normalised here, once (D43). Each epoch shuffles the samples anew (D41).
    """
    data = dict(obs=tau.obs, privileged=tau.privileged, action=tau.action, advantage=advantage,
                target=estimate.target, log_prob=estimate.log_prob)  # fmt: skip
    return ppo_epochs(learner, data, key, cfg)


@compiled
def ppo_epochs(learner, data, key, cfg):
    """`ppo_update` of data: arrays (T, N, ...) by name. Gradients and logs are averaged over the processes."""
    advantage = data["advantage"] - global_mean(data["advantage"])
    advantage = advantage / (jnp.sqrt(global_mean(jnp.square(advantage))) + 1e-8)
    size = advantage.size
    data = {name: x.reshape(size, *x.shape[2:]) for name, x in (data | dict(advantage=advantage)).items()}
    orders = jax.vmap(lambda k: jax.random.permutation(k, size))(jax.random.split(key, cfg.num_epochs))
    minibatches = orders[:, : size - size % cfg.num_minibatches].reshape(cfg.num_epochs * cfg.num_minibatches, -1)

    def step(learner, chosen):
        batch = {name: x[chosen] for name, x in data.items()}
        gradient, log = average(jax.grad(ppo_loss, has_aux=True)(learner.params, batch, cfg))
        direction, opt_state = optimizer(cfg).update(gradient, learner.opt_state)
        params = jax.tree.map(lambda p, d: p - learner.lr * d, learner.params, direction)
        params["actor"]["log_std"] = jnp.clip(params["actor"]["log_std"], *LOG_STD_RANGE)
        return Learner(params, opt_state, learner.lr), log

    learner, log = jax.lax.scan(step, learner, minibatches)
    log = {name: x.mean() for name, x in log.items()} | dict(skipped=learner.opt_state.total_notfinite, lr=learner.lr)
    return learner._replace(lr=adapt_lr(learner.lr, log["kl"], cfg)), log


def global_mean(x):
    """The mean of an array (...,) over all samples, those of other processes included."""
    return average(x.mean())


def ppo_loss(params, batch, cfg):
    """Loss of a minibatch, and what to log. Each network learns from its own term; values are not clipped (D31)."""
    mean, std, velocity = policy(params, batch["obs"])
    log_ratio = log_prob(mean, std, batch["action"]) - batch["log_prob"]
    ratio = jnp.exp(log_ratio)
    surrogate = clipped_surrogate(ratio, batch["advantage"], cfg.clip_eps).mean()
    entropy = 0.5 * jnp.log(2 * jnp.pi * jnp.e * std**2).sum(-1).mean()
    value_loss = jnp.square(value(params, batch["obs"], batch["privileged"]) - batch["target"]).sum(-1).mean()
    estimator_loss = jnp.square(velocity - batch["privileged"]).sum(-1).mean()
    loss = -surrogate - cfg.ent_coef * entropy + value_loss + estimator_loss
    kl = (ratio - 1 - log_ratio).mean()  # estimates KL(old, new) from the samples and is never negative
    return loss, dict(value_loss=value_loss, estimator_loss=estimator_loss, kl=kl, std=std.mean())


def clipped_surrogate(ratio, advantage, clip_eps):
    """PPO's objective (...,): min(ratio A, clip(ratio, 1 - eps, 1 + eps) A)."""
    return jnp.minimum(ratio * advantage, jnp.clip(ratio, 1 - clip_eps, 1 + clip_eps) * advantage)


def adapt_lr(lr, kl, cfg):
    """The next step size: smaller if the policy moved too far, larger if it hardly moved. The lab's rule (D20, D32)."""
    if cfg.target_kl == 0:
        return lr
    factor = jnp.where(kl > 2 * cfg.target_kl, 1 / 1.5, jnp.where(kl < cfg.target_kl / 2, 1.5, 1.0))
    return jnp.clip(lr * factor, *LR_RANGE)
