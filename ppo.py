"""Proximal policy optimization: a policy's update from one rollout, lines 9 and 11 of Algorithm 1.

It knows nothing of EIPO. It takes one advantage for each sample, in which the streams of `eipo.py`
are mixed already. The widths D, P, A and K are those of `networks.py`.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax

from networks import init_params, log_prob, policy, value
from runtime.parallel import average, compiled

LOG_STD_RANGE = (-4.0, 1.0)  # [ours] so that the policy's noise neither vanishes nor explodes
LR_RANGE = (1e-5, 1e-3)  # of an adapted step size: least the lab's, greatest the paper's (D20)


class Learner(NamedTuple):
    """A policy and what its training keeps."""

    params: dict  # of the networks, see `networks.py`
    opt_state: tuple  # of `optimizer`
    lr: jax.Array  # () Adam's step size now, one for all three networks


@partial(jax.jit, static_argnames=("sizes", "mirror", "heads", "cfg"))
def init_learner(key, sizes, mirror, heads, cfg):
    """A new Learner, whose networks are random.

    sizes:  widths (D, P, A) of an observation, of the privileged part and of an action
    mirror: networks.Mirror, or None for plain MLPs
    heads:  K, outputs of the critic: 2 for pi (task, cost), 1 for pi_prime (task)
    """
    params = init_params(key, sizes, mirror, heads, cfg)
    return Learner(params, optimizer(cfg).init(params), jnp.float32(cfg.lr))


def optimizer(cfg):
    """Adam without its step size.

    Gradients are clipped network by network, and non-finite ones are skipped.
    """
    networks = "actor", "critic", "estimator"
    clip = {name: optax.clip_by_global_norm(cfg.max_grad_norm) for name in networks}

    def labels(params):  # what is no network, the mirror, has nothing to learn
        return params | {name: name for name in networks}

    adam = optax.scale_by_adam(b1=0.9, b2=0.999)
    direction = optax.chain(optax.partition(clip, labels), adam)
    return optax.apply_if_finite(direction, max_consecutive_errors=2**30)


def ppo_update(learner, tau, est, advantage, key, cfg):
    """All epochs and minibatches of one iteration (L9, L11); returns the new Learner and the log.

    tau, est:  eipo.Rollout and eipo.Estimate. `ppo_epochs` gets only what it needs of them, because
               `tau.final` has another shape in each iteration, and JAX would compile anew

    advantage: (T, N), mixed. It is normalised here, once
    log:       means of what `ppo_loss` logs; lr; how many gradients were skipped since the start
    """
    data = dict(obs=tau.obs, privileged=tau.privileged, action=tau.action)
    data |= dict(target=est.target, log_prob=est.log_prob, advantage=advantage)
    return ppo_epochs(learner, data, key, cfg)


@compiled
def ppo_epochs(learner, data, key, cfg):
    """`ppo_update` of data, arrays (T, N, ...) by name. Each epoch shuffles the samples anew.

    Gradients and logs are averaged over the processes.
    """
    advantage = data["advantage"] - global_mean(data["advantage"])
    advantage = advantage / (jnp.sqrt(global_mean(jnp.square(advantage))) + 1e-8)
    size = advantage.size
    parts = cfg.num_minibatches
    data |= dict(advantage=advantage)
    data = {name: x.reshape(size, *x.shape[2:]) for name, x in data.items()}
    keys = jax.random.split(key, cfg.num_epochs)
    orders = jax.vmap(lambda k: jax.random.permutation(k, size))(keys)
    minibatches = orders[:, : size - size % parts].reshape(cfg.num_epochs * parts, -1)

    def step(learner, chosen):
        batch = {name: x[chosen] for name, x in data.items()}
        gradient, log = average(jax.grad(ppo_loss, has_aux=True)(learner.params, batch, cfg))
        direction, opt_state = optimizer(cfg).update(gradient, learner.opt_state)
        params = jax.tree.map(lambda p, d: p - learner.lr * d, learner.params, direction)
        params["actor"]["log_std"] = jnp.clip(params["actor"]["log_std"], *LOG_STD_RANGE)
        return Learner(params, opt_state, learner.lr), log

    learner, log = jax.lax.scan(step, learner, minibatches)
    log = {name: x.mean() for name, x in log.items()}
    log |= dict(skipped=learner.opt_state.total_notfinite, lr=learner.lr)
    return learner._replace(lr=adapt_lr(learner.lr, log["kl"], cfg)), log


def global_mean(x):
    """The mean of an array (...,) over all samples, those of other processes included."""
    return average(x.mean())


def ppo_loss(params, batch, cfg):
    """Loss of a minibatch, and what to log. Each network learns from a term of its own."""
    mean, std, velocity = policy(params, batch["obs"])
    log_ratio = log_prob(mean, std, batch["action"]) - batch["log_prob"]
    ratio = jnp.exp(log_ratio)
    surrogate = clipped_surrogate(ratio, batch["advantage"], cfg.clip_eps).mean()
    entropy = 0.5 * jnp.log(2 * jnp.pi * jnp.e * std**2).sum(-1).mean()
    values = value(params, batch["obs"], batch["privileged"])
    value_loss = jnp.square(values - batch["target"]).sum(-1).mean()
    estimator_loss = jnp.square(velocity - batch["privileged"]).sum(-1).mean()
    loss = -surrogate - cfg.ent_coef * entropy + value_loss + estimator_loss
    kl = (ratio - 1 - log_ratio).mean()  # estimates KL(old, new), and is never negative
    return loss, dict(value_loss=value_loss, estimator_loss=estimator_loss, kl=kl, std=std.mean())


def clipped_surrogate(ratio, advantage, clip_eps):
    """PPO's objective (...,): min(ratio A, clip(ratio, 1 - eps, 1 + eps) A)."""
    return jnp.minimum(ratio * advantage, jnp.clip(ratio, 1 - clip_eps, 1 + clip_eps) * advantage)


def adapt_lr(lr, kl, cfg):
    """The next step size: smaller if the policy moved too far, larger if it hardly moved (D20)."""
    if cfg.target_kl == 0:
        return lr
    factor = jnp.where(kl > 2 * cfg.target_kl, 1 / 1.5, jnp.where(kl < cfg.target_kl / 2, 1.5, 1.0))
    return jnp.clip(lr * factor, *LR_RANGE)
