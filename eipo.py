"""Extrinsic-Intrinsic Policy Optimization: Algorithm 1 of the paper.

`eipo()` is Algorithm 1, tagged with the paper's line numbers. `ppo()` is the paper's baseline. It
has neither pi_prime nor alpha, and weighs r and f by 1 and -lambda. At alpha = 1 / lambda both have
the same objective up to a factor, which normalising the advantages removes. Helpers follow
in the order of the lines, and `ppo.py` has the update of lines 9 and 11.

    J, F            discounted sums of the task reward r (Eq. 1) and of the auxiliary cost f (Eq. 3)
    pi, pi_prime    pi maximises alpha J - F and is the result; pi_prime maximises J alone
    alpha           the multiplier of Eq. (4), the weight of J. It starts at 1 / lam (D6)
    lam             lambda_0 of EIPO, or for PPO lambda, the weight of F in Eq. (2)
    T, N            steps of a rollout, and robots of one policy: num_envs, or half of it for EIPO
    D, P, A, K      widths, see `networks.py`

An environment has `reset(seed)`, `observe()`, `step(action)`, `obs_size`, `privileged_size` and
`action_size`, as `go1_env.Go1Env` documents them. An observation is the whole history of IV-C.a.
`train.py` makes an environment for each policy, and picks the algorithm. The loop over iterations
is plain Python, so that a `breakpoint()` works in it. Acting and learning are compiled. D6 is an
entry of `deviations.md`, which says where we depart from the paper and why; "the lab" there is the
authors' group and its public code.
"""

from dataclasses import dataclass
from functools import partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from networks import init_params, sample, value
from ppo import Learner, PPOConfig, init_learner, ppo_update


@dataclass(frozen=True)
class Config(PPOConfig):
    """How to learn. A tag says where a value is from: the paper's section, the lab's code, us."""

    algo: Literal["eipo", "ppo"] = "eipo"  # [III] ppo: without pi_prime, with a fixed lambda
    lam: float = 0.005  # [V-A] EIPO: lambda_0, alpha starts at 1 / lam; PPO: lambda of Eq. (2)
    seed: int = 0  # [ours] seed of networks, exploration and environments, but not of the ground
    num_envs: int = 256  # [ours] robots in all, of which EIPO gives each policy half
    iterations: int = 600  # [ours] iterations of Algorithm 1; the paper: 4000 or 10 000 (D38)
    num_steps: int = 24  # [IV-C] T, control steps of each robot in a rollout
    gamma: float = 0.99  # [lab code] discount, Eq. (1)
    gae_lambda: float = 0.95  # [lab code] lambda of generalised advantage estimation (GAE)
    reward_scale: float = 0.02  # [lab code] factor on reward and cost: a control step in s
    lr_alpha: float = 0.01  # [IV-C] eta_alpha, step size of alpha; each task has its own (D38)
    clip_alpha: float = 1.0  # [IV-C] bound on the size of the gradient in alpha
    momentum_alpha: float = 0.99  # [IV-C] of the step on alpha; each task has its own (D38)
    mirror: bool = True  # [ours] let `train.py` tie weights by the robot's left-right mirror (D28)


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
    dual: Dual | None  # None for PPO


class Transition(NamedTuple):
    """One step of N robots, (N, ...). tau of Algorithm 1 is T of them, (T, N, ...)."""

    obs: np.ndarray  # (N, D)
    privileged: np.ndarray  # (N, P) true body velocity, for the critic and the estimator
    action: np.ndarray  # (N, A)
    log_prob: np.ndarray  # (N,) of the action, under the policy that chose it
    reward: np.ndarray  # (N,) r of the step
    cost: np.ndarray  # (N,) f of the step
    terminated: np.ndarray  # (N,) bool, where the episode failed, and nothing follows
    truncated: np.ndarray  # (N,) bool, where its time was up; never both
    next_obs: np.ndarray  # (N, D) after the step, and before any reset
    next_privileged: np.ndarray  # (N, P)


class Estimate(NamedTuple):
    """What lines 8 and 10 estimate from a rollout. Rewards have the factor reward_scale (D10).

    K, the critic's heads, is 2 (r and f) for pi, and 1 (r) for pi_prime and where lam is 0.
    """

    advantage: jax.Array  # (T, N, K) of r and f, not normalised yet
    target: jax.Array  # (T, N, K) TD(gae_lambda) returns of r and lam f, for the critic
    # (K,) the share of each target's variance that the critic had foreseen: at most 1
    explained_variance: jax.Array


# ---- Algorithm 1 ----


def eipo(env, env_prime, cfg, state=None):
    """Algorithm 1, for Eqs. (3) and (4), as a generator of the State and metrics of each iteration.

    env, env_prime: environments of pi and of pi_prime
    state:          State to resume from, with both environments as they were then; None: a new one,
                    with networks.MLP
    cfg:            Config, whose lam is above 0
    Metrics are of pi and alpha before the iteration changes them; losses and noise are means over
    its update. The tags are the paper's line numbers. Where line 11 prints pi, it means pi_prime
    (D1).
    """
    # Alg.1 L1   Input: step sizes, cfg.lr at first (D20), and cfg.lr_alpha
    # Alg.1 L2   Output: policy pi, in every State that is yielded
    state = state or init_state([env, env_prime], cfg)  # which does what lines 3 and 4 say
    pi, pi_prime = state.pi, state.pi_prime  # Alg.1 L3
    dual = state.dual  # Alg.1 L4
    for iteration in range(state.iteration + 1, cfg.iterations + 1):  # Alg.1 L5
        key, key_prime, key_update, key_update_prime = iteration_keys(state.key, iteration)
        tau, log = rollout(env, pi, key, cfg)  # Alg.1 L6
        tau_prime, log_prime = rollout(env_prime, pi_prime, key_prime, cfg)  # Alg.1 L7

        est = estimate(pi, tau, cfg)  # of r and f, which line 8 weighs
        advantage = mix(est.advantage, (dual.alpha, -1))  # Alg.1 L8
        pi, losses = ppo_update(pi, tau, est.target, advantage, key_update, cfg)  # Alg.1 L9

        est_prime = estimate(pi_prime, tau_prime, cfg)  # Alg.1 L10
        advantage_prime = mix(est_prime.advantage, (1,))  # of r alone
        pi_prime, losses_prime = ppo_update(  # Alg.1 L11
            pi_prime, tau_prime, est_prime.target, advantage_prime, key_update_prime, cfg
        )

        # of the policies that made tau and tau_prime, before lines 9 and 11
        gap = float(estimate_J(est) - estimate_J(est_prime))  # Alg.1 L12
        metrics = summary(est, log | losses) | dict(
            task_share=task_share(est.advantage, (dual.alpha, -1)), alpha=dual.alpha, gap=gap
        )
        logged_prime = summary(est_prime, log_prime | losses_prime)
        metrics |= {f"prime_{name}": x for name, x in logged_prime.items()}
        dual = step_alpha(dual, gap, cfg)  # Alg.1 L13
        yield State(iteration, state.key, pi, pi_prime, dual), metrics
    # Alg.1 L14  end for


def ppo(env, cfg, state=None):
    """PPO on Eq. (2), the paper's baseline, as a generator like `eipo`; lam may be 0."""
    state = state or init_state([env], cfg)
    pi = state.pi
    for iteration in range(state.iteration + 1, cfg.iterations + 1):
        key, _, key_update, _ = iteration_keys(state.key, iteration)
        tau, log = rollout(env, pi, key, cfg)
        est = estimate(pi, tau, cfg)
        weights = (1, -cfg.lam)[: len(pi.heads)]
        advantage = mix(est.advantage, weights)
        pi, losses = ppo_update(pi, tau, est.target, advantage, key_update, cfg)
        share = task_share(est.advantage, weights)
        metrics = summary(est, log | losses) | dict(task_share=share)
        yield State(iteration, state.key, pi, None, None), metrics


def iteration_keys(key, iteration):
    """Four random keys: of the rollouts of pi and pi_prime, then of their updates."""
    return jax.random.split(jax.random.fold_in(key, iteration), 4)


def summary(est, logged):
    """Metrics of a policy in an iteration: J, how well its critic foresaw, and what was logged."""
    names = "explained_variance", "explained_variance_cost"
    explained = zip(names, est.explained_variance, strict=False)
    return dict(J=estimate_J(est)) | dict(explained) | logged


def task_share(advantage, weights):
    """The task's share of pi's objective: std(alpha A_r) / (std(alpha A_r) + std(A_f)).

    Near 1 the cost hardly counts. advantage, weights: as in `mix`
    """
    weighted = advantage.std((0, 1)) * abs(jnp.array(weights))
    return weighted[0] / (weighted.sum() + 1e-30)


# ---- L3, L4: the start ----


def init_state(envs, cfg, init=init_params):
    """The State before the first iteration: random policies and alpha_0. Environments are reset.

    envs: of pi and, for EIPO, of pi_prime
    init: makes networks, see `ppo.init_learner`
    """
    key = jax.random.PRNGKey(cfg.seed)
    rng, rng_prime = np.random.default_rng(cfg.seed).spawn(2)
    envs[0].reset(2 * cfg.seed)  # even seeds for pi and odd ones for pi_prime: none comes twice
    # the critic learns lam f, and if lam is 0 nothing of f (D30)
    heads = dict(reward=1.0, cost=cfg.lam) if cfg.lam else dict(reward=1.0)
    pi = init_learner(rng, envs[0], heads, cfg, init)
    if len(envs) == 1:
        return State(0, key, pi, None, None)
    envs[1].reset(2 * cfg.seed + 1)
    pi_prime = init_learner(rng_prime, envs[1], dict(reward=1.0), cfg, init)
    return State(0, key, pi, pi_prime, Dual(1 / cfg.lam, 0.0))


# ---- L6, L7: rollouts ----


@jax.jit
def act(learner, obs, key, t):
    """Random actions (N, A) for obs (N, D) in step t of a rollout, and their log-probabilities."""
    return sample(learner.params, obs, jax.random.fold_in(key, t))


def rollout(env, learner, key, cfg):
    """T steps of every robot from where it is: a Transition of (T, N, ...) arrays, and the log.

    log: means over steps and robots of r, f and the numbers that the environment logs
    """
    steps = []
    logs = []
    obs, privileged = env.observe()
    for t in range(cfg.num_steps):
        action, log_prob = map(np.asarray, act(learner, obs, key, t))
        # where an episode ended the next one has begun; final_obs is always from before that reset
        following, reward, terminated, truncated, info = env.step(action)
        transition = Transition(
            obs=obs,
            privileged=privileged,
            action=action,
            log_prob=log_prob,
            reward=reward,
            cost=info["cost"],
            terminated=terminated,
            truncated=truncated,
            next_obs=info["final_obs"],
            next_privileged=info["final_privileged"],
        )
        steps.append(transition)
        obs, privileged = following, info["privileged"]
        logs.append(dict(reward=reward, cost=info["cost"]) | info["log"])
    tau = Transition(*map(np.stack, zip(*steps, strict=True)))
    return tau, {name: mean([log[name] for log in logs]) for name in logs[0]}


def mean(x):
    """The mean of x without its NaNs, or NaN if there is nothing else."""
    known = np.ravel(x)[~np.isnan(np.ravel(x))]
    return float(known.mean()) if known.size else np.nan


# ---- L8, L10, L12: estimates ----


@partial(jax.jit, static_argnames="cfg")
def estimate(learner, tau, cfg):
    """The Estimate of a rollout, in which r and f stay apart, or of r alone for a policy without f.

    GAE is linear, so the advantages can be mixed later (L8), and the critic stays right however
    alpha moves.
    """
    values = value(learner.params, tau.obs, tau.privileged)
    next_values = value(learner.params, tau.next_obs, tau.next_privileged)
    r_and_f = jnp.stack([getattr(tau, name) for name, _ in learner.heads], -1)
    factors = jnp.array([factor for _, factor in learner.heads])
    earned = cfg.reward_scale * factors * r_and_f
    ends = tau.terminated[..., None], tau.truncated[..., None]
    advantage = gae(earned, values, next_values, *ends, cfg.gamma, cfg.gae_lambda)
    target = advantage + values
    explained = 1 - advantage.var((0, 1)) / (target.var((0, 1)) + 1e-30)
    # The critic learns r and lam f, which are of moderate size. Line 8 mixes r and f, so factors
    # are taken out again, but not reward_scale, which both have.
    return Estimate(advantage / factors, target, explained)


def gae(reward, values, next_values, terminated, truncated, gamma, gae_lambda):
    """GAE: advantages (T, ...), which with values 0 and gae_lambda 1 are returns, Eq. (1).

    An advantage is the sum over l of (gamma gae_lambda)^l delta_{t+l}, up to the end of the episode
    or of the rollout, where delta = r + gamma V(next) - V.

    reward, values: (T, ...)
    next_values:    (T, ...) of the state to which step t led, also where truncated
    terminated, truncated: (T, ...) bool. Both end the sum; only `terminated` has no next value.
    """
    delta = reward + gamma * next_values * ~terminated - values
    decay = gamma * gae_lambda * ~(terminated | truncated)

    def backwards(advantage, step):
        delta_t, decay_t = step
        advantage = delta_t + decay_t * advantage
        return advantage, advantage

    return jax.lax.scan(backwards, jnp.zeros_like(delta[0]), (delta, decay), reverse=True)[1]


def mix(advantage, weights):
    """Advantage (T, N) of r and f, weighted and added. Line 8.

    advantage: (T, N, K) of r and, for pi, of f
    weights:   K numbers: (alpha, -1) in Eq. (4), (1, -lambda) in Eq. (2), (1,) for r alone
    """
    return sum(weight * advantage[..., k] for k, weight in enumerate(weights))


def estimate_J(est):
    """J of a policy (L12): the mean of the task's target over the states of its rollout.

    A target blends the rewards of the rollout with the values of the policy's own critic. It is
    averaged over all visited states, not only the first, and has the factor reward_scale. It is not
    made of normalised advantages, because their mean is 0 for every policy (D8).
    """
    return est.target[..., 0].mean()


# ---- L13: the multiplier ----


def step_alpha(dual, gap, cfg):
    """The Dual after a step of ascent on L of Eq. (4), with momentum. Line 13, IV-C.c (D38).

    gap: J(pi) - J(pi_prime)

    dL/dalpha is -gap, where the paper prints +gap (D2), so alpha is pushed up while pi is the worse
    one. Momentum is that of torch's SGD: alpha lags behind the gap, and a steady gradient counts
    1 / (1 - momentum_alpha) times. Where alpha would fall below 0, it becomes 0 and loses its
    momentum. If the gap is not finite, both stay (D36).
    """
    if not np.isfinite(gap):
        return dual
    gradient = float(np.clip(-gap, -cfg.clip_alpha, cfg.clip_alpha))
    momentum = cfg.momentum_alpha * dual.momentum + gradient
    alpha = dual.alpha + cfg.lr_alpha * momentum
    return Dual(alpha, momentum) if alpha > 0 else Dual(0.0, 0.0)
