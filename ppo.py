"""Proximal policy optimization: a policy's update from one rollout, lines 9 and 11 of Algorithm 1.

It needs no alpha, J or F. It takes one advantage for each sample, in which for pi those of r and f
have already been mixed. The widths D, P, A and K are those of `networks.py`.
"""

from dataclasses import dataclass, field
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import optax

from networks import init_params, log_prob, policy, value

LOG_STD_RANGE = (-4.0, 1.0)  # [ours] so that the policy's noise neither vanishes nor explodes
LR_RANGE = (1e-5, 1e-3)  # of an adapted step size: from the lab's least to the paper's (D20)


@dataclass(frozen=True)
class PPOConfig:
    """Static settings of a learner. A tag says where a value is from, as in `eipo.Config`."""

    num_epochs: int = 5  # [IV-C] passes over a rollout
    num_minibatches: int = 4  # [IV-C] minibatches per pass
    lr: float = 3e-4  # [lab code] eta_pi, eta_pi': Adam's initial step size; the paper: 1e-3 (D20)
    target_kl: float = 0.03  # [ours] mean KL of an update that lr aims at; 0: fixed lr (D20)
    clip_eps: float = 0.2  # [lab code] PPO's clip range
    ent_coef: float = 0.0  # [ours] weight of the entropy bonus; the lab's is 0.01
    max_grad_norm: float = 1.0  # [IV-C] bound on the norm of each network's gradient (D31)
    log_std: float = 0.0  # [lab code] log of the noise's standard deviation at the start
    hidden: tuple = (512, 256, 128)  # [IV-C] widths of actor and critic
    hidden_estimator: tuple = (256, 128)  # [IV-C] widths of the estimator


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Learner:
    """A policy and what its training keeps."""

    params: dict  # of the networks, see `networks.py`
    opt_state: tuple  # of `optimizer`
    lr: jax.Array  # () Adam's step size now, one for all three networks
    # ((name, factor), ...): each head of the critic learns factor * reward or factor * cost
    heads: tuple = field(metadata=dict(static=True))


def init_learner(rng, env, heads, cfg, init=init_params):
    """A new Learner for an environment, whose networks are random.

    rng:     np.random.Generator
    heads:   {"reward": factor, perhaps "cost": factor} of the critic; a factor makes what its head
             learns of moderate size
    init:    `networks.init_params`, or a function with the same signature
    """
    params = init(rng, env, len(heads), cfg)
    opt_state = jax.jit(optimizer(cfg).init)(params)
    return Learner(params, opt_state, np.float32(cfg.lr), tuple(heads.items()))


@partial(jax.jit, static_argnames="cfg")
def ppo_update(learner, tau, target, advantage, key, cfg):
    """All epochs and minibatches of one iteration (L9, L11): the new Learner, and losses by name.

    tau:       eipo.Transition of the rollout
    target:    (T, N, K) for the critic
    advantage: (T, N), mixed. It is normalised here, once, over steps and robots
    Losses are the means of what `ppo_loss` logs. With them come lr, and the steps skipped so far.
    """
    advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    data = dict(obs=tau.obs, privileged=tau.privileged, action=tau.action, log_prob=tau.log_prob)
    data |= dict(target=target, advantage=advantage)
    data = {name: x.reshape(-1, *x.shape[2:]) for name, x in data.items()}

    def descend(carry, chosen):
        params, opt_state = carry
        batch = {name: x[chosen] for name, x in data.items()}
        grads, log = jax.grad(ppo_loss, has_aux=True)(params, batch, cfg)
        direction, opt_state = optimizer(cfg).update(grads, opt_state)
        params = jax.tree.map(lambda p, d: p - learner.lr * d, params, direction)
        params["log_std"] = jnp.clip(params["log_std"], *LOG_STD_RANGE)
        return (params, opt_state), log

    start = learner.params, learner.opt_state
    minibatches = shuffled(key, advantage.size, cfg)
    (params, opt_state), log = jax.lax.scan(descend, start, minibatches)
    losses = {name: x.mean() for name, x in log.items()}
    losses |= dict(skipped=opt_state.total_notfinite, lr=learner.lr)
    lr = adapt_lr(learner.lr, losses["kl"], cfg)
    return Learner(params, opt_state, lr, learner.heads), losses


def shuffled(key, size, cfg):
    """Indices (epochs * minibatches, samples): every epoch has an order of its own (D31).

    Samples left over after an equal split are dropped for that epoch.
    """
    keys = jax.random.split(key, cfg.num_epochs)
    orders = jax.vmap(lambda k: jax.random.permutation(k, size))(keys)
    whole = size - size % cfg.num_minibatches
    return orders[:, :whole].reshape(cfg.num_epochs * cfg.num_minibatches, -1)


def ppo_loss(params, batch, cfg):
    """Loss of a minibatch, and what to log. Each network learns from a term of its own.

    batch: of S samples: obs (S, D), privileged (S, P), action (S, A), log_prob (S,), target (S, K)
           and advantage (S,)
    """
    mean, std, estimated = policy(params, batch["obs"])
    log_ratio = log_prob(mean, std, batch["action"]) - batch["log_prob"]
    ratio = jnp.exp(log_ratio)
    surrogate = clipped_surrogate(ratio, batch["advantage"], cfg.clip_eps).mean()
    entropy = 0.5 * jnp.log(2 * jnp.pi * jnp.e * std**2).sum(-1).mean()
    values = value(params, batch["obs"], batch["privileged"])
    value_loss = jnp.square(values - batch["target"]).sum(-1).mean()
    estimator_loss = jnp.square(estimated - batch["privileged"]).sum(-1).mean()
    loss = -surrogate - cfg.ent_coef * entropy + value_loss + estimator_loss
    kl = (ratio - 1 - log_ratio).mean()  # estimates KL(old, new), and is never negative
    log = dict(value_loss=value_loss, estimator_loss=estimator_loss, kl=kl, std=std.mean())
    clipped = jnp.abs(ratio - 1) > cfg.clip_eps
    return loss, log | dict(policy_loss=-surrogate, clip_fraction=clipped.mean())


def clipped_surrogate(ratio, advantage, clip_eps):
    """PPO's objective (...,): min(ratio A, clip(ratio, 1 - eps, 1 + eps) A)."""
    return jnp.minimum(ratio * advantage, jnp.clip(ratio, 1 - clip_eps, 1 + clip_eps) * advantage)


def optimizer(cfg):
    """Adam without its step size, which changes, so that `ppo_update` applies it.

    The gradient of each network is clipped by itself, with the noise's in the actor's. If a number
    in any is not finite, the whole step is skipped.
    """
    nets = dict(actor="actor", log_std="actor", critic="critic", estimator="estimator")
    clip = dict.fromkeys(nets.values(), optax.clip_by_global_norm(cfg.max_grad_norm))
    adam = optax.scale_by_adam(b1=0.9, b2=0.999)
    direction = optax.chain(optax.partition(clip, nets), adam)
    # optax would let a bad step through after so many in a row, which is never
    return optax.apply_if_finite(direction, max_consecutive_errors=2**30)


def adapt_lr(lr, kl, cfg):
    """The next step size: smaller if the policy moved too far, larger if it hardly moved (D20)."""
    if cfg.target_kl == 0:
        return lr
    factor = jnp.where(kl > 2 * cfg.target_kl, 1 / 1.5, jnp.where(kl < cfg.target_kl / 2, 1.5, 1.0))
    return jnp.clip(lr * factor, *LR_RANGE)
