"""Extrinsic-Intrinsic Policy Optimization: Algorithm 1 of the paper, with PPO as its inner loop. JAX and optax.

Read from the bottom: `eipo()` is Algorithm 1, tagged with the paper's line numbers. What it calls stands above it,
in the order of Algorithm 1: learners (L3), rollout (L6, L7), estimates (L8, L10, L12), PPO update (L9, L11), the step
on alpha (L13). The networks that all of them call are in `networks.py`.

    J, F            discounted sums of the task reward (Eq. 1) and of the auxiliary cost (Eq. 3)
    pi, pi_prime    the policy that we want, alpha J - F, and the one that only knows the task, J
    alpha           the multiplier of Eq. (4); what Eq. (2) calls lambda is 1 / alpha
    lam             lambda_0: where 1 / alpha starts (EIPO) or stays (PPO)
    T, N            steps of a rollout, environments; D, P, A, K as in `networks.py`

The outer loop is plain Python, so that a `breakpoint()` works anywhere in it; what is worth compiling is jitted. An
environment here is anything that has `reset` and `step` as in `go1_env.py`: this file knows nothing of robots or files.
"""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from networks import init_mlp, log_prob, policy, value

LOG_STD_RANGE = (-4.0, 1.0)  # [ours] the noise of the policy can neither vanish nor explode
LR_RANGE = (1e-5, 1e-3)  # [lab code] at least, [IV-C] at most


@dataclass(frozen=True)
class Config:
    """How to learn. Every field says where its value comes from."""

    algo: str = "eipo"  # [III] "eipo", or "ppo": the same code without pi_prime and with a fixed alpha
    lam: float = 0.005  # [V-A] lambda: its start for EIPO (alpha_0 = 1 / lam), its value for PPO; 0 is no energy term
    seed: int = 0  # [ours] of networks, noise and environments
    num_envs: int = 256  # [ours] environments in all; EIPO gives each policy half of them (D9). The lab: about 4000
    iterations: int = 4000  # [V-A] of Algorithm 1
    num_steps: int = 24  # [IV-C] T, per rollout
    num_epochs: int = 5  # [IV-C] passes over a rollout
    num_minibatches: int = 4  # [IV-C] per pass
    lr: float = 3e-4  # [ours] Adam's step size at the start, eta_pi and eta_pi'; the paper's is 1e-3 (D20)
    target_kl: float = 0.03  # [ours] lr follows the KL, averaged over an update's minibatches; 0 keeps it fixed (D20)
    gamma: float = 0.99  # [lab code] discount, Eq. (1)
    gae_lambda: float = 0.95  # [lab code] of generalised advantage estimation
    clip_eps: float = 0.2  # [lab code] PPO's clip range
    ent_coef: float = 0.0  # [ours] weight of the entropy bonus; the lab's 0.01 lets the noise of pi_prime grow (D21)
    max_grad_norm: float = 1.0  # [IV-C] per network, so that no loss spends another's budget
    reward_scale: float = 0.02  # [lab code] streams are multiplied by this, the usual length of a step in s (D10)
    lr_alpha: float = 0.01  # [IV-C] eta_alpha
    clip_alpha: float = 1.0  # [IV-C] the gradient in alpha is clipped to +- this
    momentum_alpha: float = 0.99  # [IV-C] of the step on alpha
    dampening_alpha: float = 0.0  # [ours] as in torch's SGD: 0 lets momentum build up, 0.99 makes it an average
    alpha0: float = 0.0  # [ours] alpha at the start; 0 means 1 / lam (D6)
    log_std: float = 0.0  # [lab code] of the policy's noise, at the start
    hidden: tuple = (512, 256, 128)  # [IV-C] actor and critic
    hidden_estimator: tuple = (256, 128)  # [IV-C] of the estimator


class Learner(NamedTuple):
    """A policy with all that trains it."""

    params: dict  # {"actor": {"layers", "log_std"}, "critic": layers, "estimator": layers}
    opt_state: tuple
    lr: jax.Array  # () Adam's step size now


class Rollout(NamedTuple):
    """tau of Algorithm 1: T steps of N environments. An episode's last step is terminated or truncated, not both."""

    obs: np.ndarray  # (T, N, D)
    privileged: np.ndarray  # (T, N, P)
    action: np.ndarray  # (T, N, A)
    reward: np.ndarray  # (T, N, K): task reward r and cost lam f, both times reward_scale
    terminated: np.ndarray  # (T, N)
    truncated: np.ndarray  # (T, N)
    final_value: np.ndarray  # (T, N, K) the critic's value of the final observation where truncated, else 0
    next_obs: np.ndarray  # (N, D) after the last step
    next_privileged: np.ndarray  # (N, P)


class Estimate(NamedTuple):
    """What lines 8 and 10 estimate from a rollout."""

    advantage: jax.Array  # (T, N, K) never normalised
    target: jax.Array  # (T, N, K) lambda-returns: what the critic learns, and whose mean estimates J
    log_prob: jax.Array  # (T, N)


class Dual(NamedTuple):
    """The multiplier and its momentum."""

    alpha: float
    velocity: float


class State(NamedTuple):
    """Everything that an iteration depends on, apart from the environments' own state."""

    iteration: int
    pi: Learner
    pi_prime: Learner | None  # None for PPO
    dual: Dual
    at: tuple  # obs, privileged: where pi's environments are
    at_prime: tuple | None  # None for PPO


# ---- L3: learners ----


def optimizer(cfg):
    """Adam's direction, with each network's gradient clipped by its own norm; non-finite updates are skipped."""
    clip = {name: optax.clip_by_global_norm(cfg.max_grad_norm) for name in ("actor", "critic", "estimator")}
    direction = optax.chain(optax.partition(clip, {name: name for name in clip}), optax.scale_by_adam(b1=0.9, b2=0.999))
    return optax.apply_if_finite(direction, max_consecutive_errors=2**30)


@partial(jax.jit, static_argnames=("sizes", "heads", "cfg"))
def init_learner(key, sizes, heads, cfg):
    """A new Learner. sizes: widths of obs, privileged and action; heads: K, 2 for pi (task, cost), 1 for pi_prime."""
    obs, privileged, action = sizes
    k_actor, k_critic, k_estimator = jax.random.split(key, 3)
    actor = init_mlp(k_actor, (obs + privileged, *cfg.hidden, action))
    critic = init_mlp(k_critic, (obs + privileged, *cfg.hidden, heads))
    estimator = init_mlp(k_estimator, (obs, *cfg.hidden_estimator, privileged))
    log_std = jnp.full(action, cfg.log_std, jnp.float32)
    params = dict(actor=dict(layers=actor, log_std=log_std), critic=critic, estimator=estimator)
    return Learner(params, optimizer(cfg).init(params), jnp.float32(cfg.lr))


# ---- L6, L7: rollouts ----


@jax.jit
def act(params, obs, key, t):
    """Sample actions (N, A) for obs (N, D). key, t: random key of the rollout and step within it."""
    mean, std, _ = policy(params, obs)
    return mean + std * jax.random.normal(jax.random.fold_in(key, t), mean.shape)


def rollout(env, params, at, key, cfg):
    """T steps of env under the policy, from where it is.

    at: (obs, privileged) of the N environments now
    returns Rollout, the new `at`, and the log: means of the environment's float columns, counts of its boolean ones
    """
    heads = params["critic"][-1][1].shape[0]
    steps, logs = [], []
    for t in range(cfg.num_steps):
        obs, privileged = at
        action = np.asarray(act(params, obs, key, t))
        next_obs, reward, terminated, truncated, info = env.step(action)
        streams = cfg.reward_scale * np.stack([reward, cfg.lam * info["cost"]], -1)[:, :heads]
        final_value = np.zeros(streams.shape, np.float32)
        if truncated.any():  # a time limit is not the end of the world: bootstrap from the final observation
            final = value(params, info["final_obs"], info["final_privileged"].astype(np.float32))
            final_value = np.where(truncated[:, None], final, final_value)
        steps.append((obs, privileged, action, streams.astype(np.float32), terminated, truncated, final_value))
        logs.append(dict(reward=reward, cost=info["cost"]) | info["log"])
        at = next_obs, info["privileged"].astype(np.float32)
    tau = Rollout(*(np.stack(column) for column in zip(*steps, strict=True)), *at)
    columns = {name: np.stack([log[name] for log in logs]) for name in logs[0]}
    return tau, at, {name: float(c.sum() if c.dtype == bool else c.mean()) for name, c in columns.items()}


# ---- L8, L10, L12: estimates ----


def gae(reward, value, next_value, terminated, truncated, gamma, gae_lambda):
    """Generalised advantage estimation: sum over l of (gamma gae_lambda)^l delta_{t+l}, up to the episode's end.

    reward, value: (T, ...); next_value: (T, ...) value of the state that step t led to, also where truncated
    terminated, truncated: (T, ...) bool. Both cut the sum; only `terminated` says that nothing comes after.
    returns (T, ...) advantages
    """
    delta = reward + gamma * next_value * ~terminated - value
    decay = gamma * gae_lambda * ~(terminated | truncated)

    def backwards(advantage, step):
        delta_t, decay_t = step
        advantage = delta_t + decay_t * advantage
        return advantage, advantage

    return jax.lax.scan(backwards, jnp.zeros_like(delta[0]), (delta, decay), reverse=True)[1]


@partial(jax.jit, static_argnames="cfg")
def estimate(params, tau, cfg):
    """Advantages and returns of a rollout, each stream by itself: GAE is linear, so mixing can wait (L8, L10)."""
    values = value(params, tau.obs, tau.privileged)
    after = value(params, tau.next_obs, tau.next_privileged)
    terminated, truncated = tau.terminated[..., None], tau.truncated[..., None]
    next_values = jnp.where(truncated, tau.final_value, jnp.concatenate([values[1:], after[None]]))
    advantage = gae(tau.reward, values, next_values, terminated, truncated, cfg.gamma, cfg.gae_lambda)
    mean, std, _ = policy(params, tau.obs)
    return Estimate(advantage, advantage + values, log_prob(mean, std, tau.action))


def mix(advantage, alpha, lam):
    """Advantage (T, N) of alpha J - F, up to a positive factor. Eqs. (2) and (4), D6.

    advantage: (T, N, 2) of the streams r and lam f. The weights (alpha lam, -1) give lam (alpha A_r - A_f); with
    alpha = 1 / lam that is A_r - lam A_f: PPO on Eq. (2). lam = 0, alpha infinite, leaves the task alone.
    """
    return advantage[..., 0] if lam == 0 else alpha * lam * advantage[..., 0] - advantage[..., 1]


def estimate_J(estimate):
    """J of a policy from its rollout: batch mean of the lambda-returns of the task stream (L12, D8).

    Never from normalised advantages: their mean is 0 whatever the policy, and alpha would not move.
    """
    return estimate.target[..., 0].mean()


# ---- L9, L11: the PPO update ----


def clipped_surrogate(ratio, advantage, clip_eps):
    """PPO's objective (...,): min(ratio A, clip(ratio, 1 - eps, 1 + eps) A)."""
    return jnp.minimum(ratio * advantage, jnp.clip(ratio, 1 - clip_eps, 1 + clip_eps) * advantage)


def ppo_loss(params, batch, cfg):
    """Loss of a minibatch, and what to log. The three networks share no parameters, so the sum trains each alone."""
    mean, std, velocity = policy(params, batch["obs"])
    log_ratio = log_prob(mean, std, batch["action"]) - batch["log_prob"]
    ratio = jnp.exp(log_ratio)
    surrogate = clipped_surrogate(ratio, batch["advantage"], cfg.clip_eps).mean()
    entropy = 0.5 * jnp.log(2 * jnp.pi * jnp.e * std**2).sum(-1).mean()
    value_loss = jnp.square(value(params, batch["obs"], batch["privileged"]) - batch["target"]).sum(-1).mean()
    estimator_loss = jnp.square(velocity - batch["privileged"]).sum(-1).mean()
    loss = -surrogate - cfg.ent_coef * entropy + value_loss + estimator_loss
    kl = (ratio - 1 - log_ratio).mean()  # an estimate of KL(old, new) that is never negative
    return loss, dict(value_loss=value_loss, estimator_loss=estimator_loss, kl=kl, std=std.mean())


def adapt_lr(lr, kl, cfg):
    """The lab's rule, once per iteration: a smaller step if the policy moved too far, a larger one if hardly at all."""
    if cfg.target_kl == 0:
        return lr
    factor = jnp.where(kl > 2 * cfg.target_kl, 1 / 1.5, jnp.where(kl < cfg.target_kl / 2, 1.5, 1.0))
    return jnp.clip(lr * factor, *LR_RANGE)


@partial(jax.jit, static_argnames="cfg", donate_argnames="learner")
def ppo_update(learner, tau, estimate, advantage, key, cfg):
    """All epochs and minibatches of one iteration. advantage: (T, N), mixed, not normalised yet.

    returns the new Learner and the means of what ppo_loss logs. The old Learner's buffers are reused: do not touch it.
    """
    advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    data = dict(obs=tau.obs, privileged=tau.privileged, action=tau.action, advantage=advantage,
                target=estimate.target, log_prob=estimate.log_prob)  # fmt: skip
    size = advantage.size
    data = {name: x.reshape(size, *x.shape[2:]) for name, x in data.items()}
    orders = jax.vmap(lambda k: jax.random.permutation(k, size))(jax.random.split(key, cfg.num_epochs))
    minibatches = orders[:, : size - size % cfg.num_minibatches].reshape(cfg.num_epochs * cfg.num_minibatches, -1)

    def step(learner, chosen):
        batch = {name: x[chosen] for name, x in data.items()}
        gradient, log = jax.grad(ppo_loss, has_aux=True)(learner.params, batch, cfg)
        direction, opt_state = optimizer(cfg).update(gradient, learner.opt_state)
        params = jax.tree.map(lambda p, d: p - learner.lr * d, learner.params, direction)
        params["actor"]["log_std"] = jnp.clip(params["actor"]["log_std"], *LOG_STD_RANGE)
        return Learner(params, opt_state, learner.lr), log

    learner, log = jax.lax.scan(step, learner, minibatches)
    log = {name: x.mean() for name, x in log.items()} | dict(skipped=learner.opt_state.total_notfinite, lr=learner.lr)
    return learner._replace(lr=adapt_lr(learner.lr, log["kl"], cfg)), log


# ---- L13: the multiplier ----


def step_alpha(dual, gap, cfg):
    """One step on alpha: gradient ascent on L of Eq. (4) with momentum, as torch's SGD does it. Section IV-C.c.

    gap: J(pi) - J(pi_prime). dL/dalpha = -gap, so alpha rises while pi is worse than pi_prime. Deviation D2: the
    paper prints +gap. The gradient is clipped to +- clip_alpha; alpha stays >= 0 and loses its momentum there.
    returns Dual, unchanged if the gap is not finite
    """
    if not np.isfinite(gap):
        return dual
    gradient = float(np.clip(-gap, -cfg.clip_alpha, cfg.clip_alpha))
    velocity = cfg.momentum_alpha * dual.velocity + (1 - cfg.dampening_alpha) * gradient
    alpha = dual.alpha + cfg.lr_alpha * velocity
    return Dual(alpha, velocity) if alpha > 0 else Dual(0.0, 0.0)


# ---- Algorithm 1 ----


def start(env, seed):
    """Reset env; returns `at`: obs (N, D) and privileged (N, P) of every environment. None stays None."""
    if env is None:
        return None
    obs, info = env.reset(seed)
    return obs, info["privileged"].astype(np.float32)


def eipo(env, env_prime, cfg, resume=None, step_alpha=step_alpha):
    """Algorithm 1, as a generator: yields State and a dict of metrics, before the first and after every iteration.

    env, env_prime: environments of pi and of pi_prime; PPO has no env_prime (None)
    resume:         State to continue from (the caller restores the environments), None to start
    step_alpha:     what line 13 does, replaceable by experiments
    A State is valid until the generator is asked for the next one. The tags are the paper's line numbers.
    """
    # Alg.1 L1   Input: step sizes, cfg.lr of pi and of pi_prime and cfg.lr_alpha
    # Alg.1 L2   Output: policy pi, in every State that is yielded
    both = cfg.algo == "eipo"
    root, key, key_prime = jax.random.split(jax.random.key(cfg.seed), 3)
    sizes = env.obs_size, env.privileged_size, env.action_size
    pi = init_learner(key, sizes, 2, cfg)
    pi_prime = init_learner(key_prime, sizes, 1, cfg) if both else None  # Alg.1 L3
    dual = Dual(cfg.alpha0 or (1 / cfg.lam if cfg.lam else np.inf), 0.0)  # Alg.1 L4
    state = resume or State(0, pi, pi_prime, dual, start(env, 2 * cfg.seed), start(env_prime, 2 * cfg.seed + 1))
    yield state, {}
    done, pi, pi_prime, dual, at, at_prime = state
    for iteration in range(done + 1, cfg.iterations + 1):  # Alg.1 L5
        keys = jax.random.split(jax.random.fold_in(root, iteration), 4)
        tau, at, log = rollout(env, pi.params, at, keys[0], cfg)  # Alg.1 L6
        if both:
            tau_prime, at_prime, log_prime = rollout(env_prime, pi_prime.params, at_prime, keys[1], cfg)  # Alg.1 L7
        est = estimate(pi.params, tau, cfg)  # Alg.1 L8
        metrics = log | dict(J=estimate_J(est), alpha=dual.alpha)
        pi, trained = ppo_update(pi, tau, est, mix(est.advantage, dual.alpha, cfg.lam), keys[2], cfg)  # Alg.1 L9
        if both:
            est_prime = estimate(pi_prime.params, tau_prime, cfg)  # Alg.1 L10
            task = est_prime.advantage[..., 0]
            pi_prime, trained_prime = ppo_update(pi_prime, tau_prime, est_prime, task, keys[3], cfg)  # Alg.1 L11, D1
            gap = float(estimate_J(est) - estimate_J(est_prime))  # Alg.1 L12
            dual = step_alpha(dual, gap, cfg)  # Alg.1 L13
            metrics |= dict(gap=gap) | {f"prime_{name}": x for name, x in (log_prime | trained_prime).items()}
        state = State(iteration, pi, pi_prime, dual, at, at_prime)
        yield state, dict(steps=iteration * cfg.num_steps * cfg.num_envs) | metrics | trained
    # Alg.1 L14  end for
