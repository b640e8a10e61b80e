"""Extrinsic-Intrinsic Policy Optimization: Algorithm 1 of the paper.

`eipo()` is Algorithm 1, tagged with the paper's line numbers. `ppo()` is the paper's baseline,
which is Algorithm 1 without pi_prime. What they call follows in the order of the lines, and
`ppo.py` has the update of lines 9 and 11.

    J, F            discounted sums of the task reward r (Eq. 1) and of the auxiliary cost f (Eq. 3)
    pi, pi_prime    pi maximises alpha J - F and is the result; pi_prime maximises J alone
    alpha, lam      the multiplier of Eq. (4), and lambda_0: 1 / alpha is the lambda of Eq. (2),
                    and starts at lam (D6)
    T, N            steps of a rollout, and number of environments
    D, P, A, K      widths, see `networks.py`

An environment is anything with `reset(seed)`, `step(action)`, `obs_size`, `privileged_size`,
`action_size` and, if it has one, a `mirror`, as `go1_env.Go1Env` documents them. No robot, no file
and no other process is known here. The loop over iterations is plain Python, so that a
`breakpoint()` works in it. Acting and learning are compiled.
"""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from networks import Mirror, log_prob, policy, sample, value
from ppo import Learner, global_mean, init_learner, ppo_update


@dataclass(frozen=True)
class Config:
    """How to learn. A tag says where a value is from: the paper's section, the lab's code, us."""

    algo: str = "eipo"  # [III] "eipo", or "ppo": without pi_prime and with a fixed alpha
    lam: float = 0.005  # [V-A] lambda_0; alpha starts at 1 / lam. PPO: of Eq. (10), 0: no energy
    seed: int = 0  # [ours] seed of all random numbers: networks, exploration and environments
    num_envs: int = 256  # [ours] environments in all, of which EIPO gives each policy half
    iterations: int = 600  # [ours] iterations of Algorithm 1; the paper: 4000 or 10 000 (D38)
    num_steps: int = 24  # [IV-C] T, control steps of each environment in a rollout
    num_epochs: int = 5  # [IV-C] passes over a rollout
    num_minibatches: int = 4  # [IV-C] minibatches per pass
    lr: float = 3e-4  # [ours] eta_pi, eta_pi': Adam's first step size; the paper: 1e-3 (D20)
    target_kl: float = 0.03  # [ours] KL divergence of an update that lr aims at; 0: fixed (D20)
    gamma: float = 0.99  # [lab code] discount, Eq. (1)
    gae_lambda: float = 0.95  # [lab code] lambda of generalised advantage estimation (GAE)
    clip_eps: float = 0.2  # [lab code] PPO's clip range
    ent_coef: float = 0.0  # [ours] weight of the entropy bonus; the lab: 0.01
    max_grad_norm: float = 1.0  # [IV-C] bound on the norm of each network's gradient
    reward_scale: float = 0.02  # [lab code] factor on reward and cost: a control step in s
    lr_alpha: float = 0.01  # [IV-C] eta_alpha; two tasks have a longer one (D38)
    clip_alpha: float = 1.0  # [IV-C] bound on the size of the gradient in alpha
    momentum_alpha: float = 0.99  # [IV-C] momentum of the step on alpha
    dampening_alpha: float = 0.0  # [ours] as in torch's SGD; 0.99 makes momentum an average
    alpha0: float | None = None  # [ours] alpha at the start; without it, 1 / lam (D6)
    log_std: float = 0.0  # [lab code] log of the noise's standard deviation at the start
    mirror: bool = True  # [ours] tie weights by the robot's mirror symmetry, or plain MLPs
    hidden: tuple = (512, 256, 128)  # [IV-C] widths of actor and critic
    hidden_estimator: tuple = (256, 128)  # [IV-C] widths of the estimator


class Dual(NamedTuple):
    """The multiplier and its momentum."""

    alpha: float
    momentum: float  # the decaying sum of past gradients, see `step_alpha`


class State(NamedTuple):
    """Everything that an iteration depends on, apart from the environments' own state."""

    iteration: int
    key: jax.Array  # (2,) from which `iteration_keys` makes the random keys of every iteration
    pi: Learner
    pi_prime: Learner | None  # None for PPO
    dual: Dual
    start: tuple  # obs (N, D), privileged (N, P) with which pi's next rollout begins
    start_prime: tuple | None  # None for PPO


class Rollout(NamedTuple):
    """tau of Algorithm 1: T steps of N environments."""

    obs: np.ndarray  # (T, N, D)
    privileged: np.ndarray  # (T, N, P)
    action: np.ndarray  # (T, N, A)
    reward: np.ndarray  # (T, N, K) streams: reward r and, for pi, cost lam f, times reward_scale
    terminated: np.ndarray  # (T, N) where an episode ended
    truncated: np.ndarray  # (T, N) where its time was up; never both
    after: tuple  # obs (N, D), privileged (N, P) after the last step
    final: tuple  # obs (M, D), privileged (M, P), the last ones of truncated episodes, and padding


class Estimate(NamedTuple):
    """What lines 8 and 10 estimate from a rollout."""

    advantage: jax.Array  # (T, N, K) of each stream, never normalised
    target: jax.Array  # (T, N, K) lambda-returns: the critic learns them, their mean estimates J
    log_prob: jax.Array  # (T, N) of the actions, under the policy that chose them


# ---- Algorithm 1 ----


def eipo(env, env_prime, cfg, state=None):
    """Algorithm 1, for Eqs. (3) and (4), as a generator of the State and metrics of each iteration.

    env, env_prime: environments of pi and of pi_prime
    state:          the State to go on from, with env and env_prime as they were then, or None
    The tags are the paper's line numbers. Where line 11 prints pi, it means pi_prime (D1).
    """
    # Alg.1 L1   Input: step sizes, cfg.lr of pi and of pi_prime and cfg.lr_alpha
    # Alg.1 L2   Output: policy pi, in every State that is yielded
    state = state or init_state(env, env_prime, cfg)  # train.py passes one, with its own key
    pi, pi_prime = state.pi, state.pi_prime  # Alg.1 L3
    dual = state.dual  # Alg.1 L4
    start, start_prime = state.start, state.start_prime
    for iteration in range(state.iteration + 1, cfg.iterations + 1):  # Alg.1 L5
        key, key_prime, key_update, key_update_prime = iteration_keys(state.key, iteration)
        tau, start, log = rollout(env, pi.params, start, key, cfg)  # Alg.1 L6
        tau_prime, start_prime, log_prime = rollout(  # Alg.1 L7
            env_prime, pi_prime.params, start_prime, key_prime, cfg
        )

        est = estimate(pi.params, tau, cfg)
        objective = mix(est.advantage, dual.alpha, cfg.lam)  # Alg.1 L8
        pi, trained = ppo_update(pi, tau, est, objective, key_update, cfg)  # Alg.1 L9

        est_prime = estimate(pi_prime.params, tau_prime, cfg)  # Alg.1 L10
        objective_prime = est_prime.advantage[..., 0]
        pi_prime, trained_prime = ppo_update(  # Alg.1 L11
            pi_prime, tau_prime, est_prime, objective_prime, key_update_prime, cfg
        )

        gap = float(estimate_J(est) - estimate_J(est_prime))  # Alg.1 L12
        metrics = summary(est, dual, cfg) | dict(gap=gap) | log | trained
        metrics |= {f"prime_{name}": x for name, x in (log_prime | trained_prime).items()}
        dual = step_alpha(dual, gap, cfg)  # Alg.1 L13
        yield State(iteration, state.key, pi, pi_prime, dual, start, start_prime), metrics
    # Alg.1 L14  end for


def ppo(env, cfg, state=None):
    """PPO on Eq. (2), the paper's baseline, as a generator like `eipo`. Arguments are as there."""
    state = state or init_state(env, None, cfg)
    pi = state.pi
    dual = state.dual
    start = state.start
    for iteration in range(state.iteration + 1, cfg.iterations + 1):
        key, _, key_update, _ = iteration_keys(state.key, iteration)
        tau, start, log = rollout(env, pi.params, start, key, cfg)
        est = estimate(pi.params, tau, cfg)
        objective = mix(est.advantage, dual.alpha, cfg.lam)  # alpha stays 1 / lam
        pi, trained = ppo_update(pi, tau, est, objective, key_update, cfg)
        metrics = summary(est, dual, cfg) | log | trained
        yield State(iteration, state.key, pi, None, dual, start, None), metrics


def iteration_keys(key, iteration):
    """Four random keys: of the rollouts of pi and pi_prime, then of their updates."""
    return jax.random.split(jax.random.fold_in(key, iteration), 4)


def summary(est, dual, cfg):
    """Metrics of an iteration: J(pi), alpha, and the task's share of pi's objective.

    The share is std(alpha A_r) / (std(alpha A_r) + std(A_f)). Near 1, alpha no longer matters.
    """
    task, cost = est.advantage.std((0, 1))
    weighed = dual.alpha * cfg.lam * task  # as in `mix`
    share = weighed / (weighed + cost + 1e-30) if cfg.lam else 1.0
    return dict(J=estimate_J(est), alpha=dual.alpha, task_share=share)


# ---- L3, L4: the start ----


def init_state(env, env_prime, cfg):
    """The State before the first iteration: random policies, alpha_0, environments that were reset.

    env_prime: None for PPO
    """
    base = jax.random.PRNGKey(cfg.seed)

    def begin(env, key, heads, seed):
        obs, info = env.reset(seed)
        sizes = env.obs_size, env.privileged_size, env.action_size
        symmetry = getattr(env, "mirror", None)
        mirror = Mirror(**symmetry) if cfg.mirror and symmetry else None
        return init_learner(key, sizes, mirror, heads, cfg), (obs, info["privileged"])

    key, key_prime = jax.random.split(jax.random.fold_in(base, 0))
    pi, start = begin(env, key, 2, 2 * cfg.seed)
    pi_prime, start_prime = None, None
    if env_prime is not None:
        pi_prime, start_prime = begin(env_prime, key_prime, 1, 2 * cfg.seed + 1)
    alpha = cfg.alpha0
    if alpha is None:
        alpha = 1 / cfg.lam if cfg.lam else np.inf
    return State(0, base, pi, pi_prime, Dual(alpha, 0.0), start, start_prime)


# ---- L6, L7: rollouts ----


@jax.jit
def act(params, obs, key, t):
    """Random actions (N, A) for obs (N, D) in step t of the rollout that has this random key."""
    return sample(params, obs, jax.random.fold_in(key, t))


def rollout(env, params, start, key, cfg):
    """Take T steps in env with the policy, from where env is.

    start: (obs, privileged) of the N environments now
    Returns the Rollout, the next `start`, and the log: means of the environment's numbers, and how
    often what is boolean was true.
    """
    heads = len(params["critic"][-1].bias)
    steps = []
    finals = []
    logs = []
    for t in range(cfg.num_steps):
        action = np.asarray(act(params, start[0], key, t))
        obs, reward, terminated, truncated, info = env.step(action)
        streams = cfg.reward_scale * np.stack([reward, cfg.lam * info["cost"]], -1)[:, :heads]
        steps.append((*start, action, streams.astype(np.float32), terminated, truncated))
        finals.append((info["final_obs"][truncated], info["final_privileged"][truncated]))
        logs.append(dict(reward=reward, cost=info["cost"]) | info["log"])
        start = obs, info["privileged"]
    final = [np.concatenate(column) for column in zip(*finals, strict=True)]
    padding = -len(final[0]) % len(obs)  # to multiples of N, as JAX compiles anew for each shape
    final = tuple(np.pad(x, [(0, padding), (0, 0)]) for x in final)
    tau = Rollout(*(np.stack(column) for column in zip(*steps, strict=True)), start, final)
    log = {}
    columns = {name: np.stack([step[name] for step in logs]) for name in logs[0]}
    for name, column in columns.items():
        log[name] = int(column.sum()) if column.dtype == bool else float(column.mean())
    return tau, start, log


# ---- L8, L10, L12: estimates ----


@partial(jax.jit, static_argnames="cfg")
def estimate(params, tau, cfg):
    """The Estimate of a rollout, in which the streams stay apart.

    GAE is linear, so that their advantages can be mixed later (L8).
    """
    values = value(params, tau.obs, tau.privileged)
    next_values = jnp.concatenate([values[1:], value(params, *tau.after)[None]])
    terminated, truncated = tau.terminated[..., None], tau.truncated[..., None]
    if len(tau.final[0]):  # where time was up, more would have followed
        k = jnp.cumsum(tau.truncated).reshape(tau.truncated.shape) - 1
        next_values = jnp.where(truncated, value(params, *tau.final)[k], next_values)  # the k-th
    advantage = gae(
        tau.reward, values, next_values, terminated, truncated, cfg.gamma, cfg.gae_lambda
    )
    mean, std, _ = policy(params, tau.obs)
    return Estimate(advantage, advantage + values, log_prob(mean, std, tau.action))


def gae(reward, value, next_value, terminated, truncated, gamma, gae_lambda):
    """GAE, the advantages (T, ...); with values 0 and gae_lambda 1 these are returns, Eq. (1).

    They are sums over l of (gamma gae_lambda)^l delta_{t+l}, up to the end of the episode.

    reward, value: (T, ...)
    next_value:    (T, ...) of the state to which step t led, also where truncated
    terminated, truncated: (T, ...) bool. Both end the sum; only `terminated` has no next value.
    """
    delta = reward + gamma * next_value * ~terminated - value
    decay = gamma * gae_lambda * ~(terminated | truncated)

    def backwards(advantage, step):
        delta_t, decay_t = step
        advantage = delta_t + decay_t * advantage
        return advantage, advantage

    return jax.lax.scan(backwards, jnp.zeros_like(delta[0]), (delta, decay), reverse=True)[1]


def mix(advantage, alpha, lam):
    """Advantage (T, N) of alpha J - F, Eq. (4), up to a positive factor (D6). Line 8.

    advantage: (T, N, 2) of the streams r and lam f

    The weights alpha lam and -1 give lam (alpha A_r - A_f). With alpha = 1 / lam this is
    A_r - lam A_f, as in Eq. (2). With lam = 0, alpha is infinite and the task alone counts.
    """
    return advantage[..., 0] if lam == 0 else alpha * lam * advantage[..., 0] - advantage[..., 1]


def estimate_J(est):
    """J of a policy: the mean of the lambda-returns of the task in its rollout (L12).

    Normalised advantages would not do: their mean is 0 for every policy, so alpha would not move.
    """
    return global_mean(est.target[..., 0])


# ---- L13: the multiplier ----


def step_alpha(dual, gap, cfg):
    """The Dual after a step of ascent on L of Eq. (4), with momentum. Line 13, IV-C.c (D38).

    gap: J(pi) - J(pi_prime)

    dL/dalpha is -gap, where the paper prints +gap (D2), so alpha rises while pi is the worse one.
    Momentum is that of torch's SGD. Where alpha would fall below 0, it becomes 0 and loses its
    momentum. If the gap is not finite, nothing moves.
    """
    if not np.isfinite(gap):
        return dual
    gradient = float(np.clip(-gap, -cfg.clip_alpha, cfg.clip_alpha))
    momentum = cfg.momentum_alpha * dual.momentum + (1 - cfg.dampening_alpha) * gradient
    alpha = dual.alpha + cfg.lr_alpha * momentum
    return Dual(alpha, momentum) if alpha > 0 else Dual(0.0, 0.0)
