"""Algorithm 1 as a whole: its lines in order, its two policies, its multiplier; a toy with a known answer; probes.

The probes, after Andy Jones, are environments so small that the right answer is plain: one that fails says which part
is broken. All tests share two Configs, one of EIPO and one of PPO, so that JAX compiles each function once for each.
"""

import inspect
import re
from dataclasses import replace
from itertools import islice

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_eipo import CONFIG, plain

import eipo
import networks
from eipo import Dual

EIPO = replace(CONFIG, algo="eipo")  # one set of numbers for both files: JAX compiles once
PPO = replace(EIPO, algo="ppo")  # on Eq. (2): r - 4 f


class Probe:
    """16 environments with episodes of `length` steps. One sees x, drawn from -1 and 1, and t; x + t is privileged.

    reward, cost: functions of x, t and the action, each (16,). truncates: whether episodes end by a time limit. The
    final observation of such an episode shows x and length - 1. `diary` holds what was seen and done, `seeds` resets.
    """

    num_envs, obs_size, privileged_size, action_size = 16, (2, 0), (1, 0), (1, 0)

    def __init__(self, reward, cost=lambda x, t, a: 0 * x, length=1, truncates=False):
        self.reward, self.cost, self.length, self.truncates = reward, cost, length, truncates
        self.diary, self.seeds = [], []

    def reset(self, seed):
        self.seeds.append(seed)
        self.rng = np.random.default_rng(seed)
        self.x, self.t = self.rng.choice([-1.0, 1.0], self.num_envs), np.zeros(self.num_envs)
        obs, privileged = self.look()
        return obs, dict(privileged=privileged)

    def look(self):
        return np.stack([self.x, self.t], -1).astype(np.float32), (self.x + self.t)[:, None].astype(np.float32)

    def step(self, action):
        self.diary.append((self.look()[0], action))
        now = self.x, self.t, action[:, 0]
        ended = self.t == self.length - 1
        self.t = np.minimum(self.t + 1, self.length - 1)
        final_obs, final_privileged = self.look()
        self.x = np.where(ended, self.rng.choice([-1.0, 1.0], self.num_envs), self.x)
        self.t = np.where(ended, 0.0, self.t)
        obs, privileged = self.look()
        log = dict(action=now[2], ended=ended)
        info = dict(cost=self.cost(*now), privileged=privileged, final_obs=final_obs,
                    final_privileged=final_privileged, log=log)  # fmt: skip
        return obs, self.reward(*now), ended & (not self.truncates), ended & self.truncates, info


def one(x, t, a):
    return 1 + 0 * x


def near_half(x, t, a):
    return -((a - 0.5) ** 2)


def effort(x, t, a):
    return a**2


def run(env, env_prime, cfg, iterations, state=None, **options):
    """[(State, metrics)] before the first and after every iteration. Without env_prime it is PPO."""
    state = state or eipo.init_state(env, env_prime, cfg)
    steps = eipo.eipo(env, env_prime, cfg, state, **options) if env_prime else eipo.ppo(env, cfg, state)
    return [(state, {}), *islice(steps, iterations)]


def trees_equal(a, b):
    return jax.tree.all(jax.tree.map(np.array_equal, a, b))


# ---- L6, L7: rollouts ----


def known(heads):
    """Parameters with mean action 0, std 1 and values 3 t, and 6 t where there are two heads, of what a Probe shows.

    3 t = -x + 2 t + (x + t), of which x + t is privileged.
    """
    actor = dict(layers=[plain(jnp.zeros((3, 1)), jnp.zeros(1))], log_std=jnp.zeros(1))
    critic = [plain(jnp.array([[-1.0, -2.0], [2.0, 4.0], [1.0, 2.0]])[:, :heads], jnp.zeros(heads))]
    return dict(actor=actor, critic=critic, estimator=[plain(jnp.zeros((2, 1)), jnp.zeros(1))])


def start(env):
    obs, info = env.reset(0)
    return obs, info["privileged"]


def roll(env, heads, cfg):
    return eipo.rollout(env, known(heads), start(env), jax.random.key(0), cfg)


def test_rollout_bootstraps_from_the_final_observation():
    """Two-step episodes, cut by a time limit at t = 1, their final observations being (x, 1). gamma = 1/2, r = 0.

    V = (3 t, 6 t). The one-step errors, with gae_lambda = 0, of the three steps, and where they lead:
    t = 0: 0 + 3/2 - 0 = 3/2     to t = 1
    t = 1: 0 + 3/2 - 3 = -3/2    to the final observation; the first one of the next episode would give -3
    t = 0: 0 + 3/2 - 0 = 3/2     the rollout ends, at t = 1
    """
    cfg = replace(EIPO, num_steps=3, gae_lambda=0.0)
    tau, at, log = roll(Probe(lambda x, t, a: 0 * x, length=2, truncates=True), 2, cfg)
    assert tau.truncated.all(1).tolist() == [False, True, False] and not tau.terminated.any()
    advantage = eipo.estimate(known(2), tau, cfg).advantage
    assert (np.asarray(advantage) == np.array([[1.5, 3], [-1.5, -3], [1.5, 3]])[:, None]).all()
    assert tau.obs[:, 0, 1].tolist() == [0, 1, 0] and tau.after[0][0, 1] == 1
    assert trees_equal(at, tau.after)
    assert log["ended"] == 16 and log["reward"] == 0


def test_rollout_each_truncation_has_its_own_final_observation():
    """Robots are cut at different times: V(final) = obs, which says who was cut when (100 t + robot)."""

    class Cut(Probe):
        num_envs, cuts = 3, {1: [2], 2: [0, 1]}  # step: robots

        def step(self, action):
            obs, reward, _, _, info = super().step(action)
            step = len(self.diary) - 1
            truncated = np.isin(np.arange(3), self.cuts.get(step, []))
            final = np.column_stack([100.0 * step + np.arange(3), np.zeros(3)]).astype(np.float32)
            return (
                0 * obs,
                reward,
                np.zeros(3, bool),
                truncated,
                info | dict(final_obs=final, privileged=0 * obs[:, :1]),
            )

    cfg = replace(EIPO, num_steps=3, gae_lambda=0.0, gamma=1.0)
    params = known(1) | dict(critic=[plain(jnp.array([[1.0], [0.0], [0.0]]), jnp.zeros(1))])
    env = Cut(lambda x, t, a: np.zeros(3))
    tau, _, _ = eipo.rollout(env, params, start(env), jax.random.key(0), cfg)
    bootstrapped = eipo.estimate(params, tau, cfg).target[..., 0]
    assert bootstrapped.tolist() == [[0, 0, 0], [0, 0, 102], [200, 201, 0]]


def test_rollout_a_fall_has_no_final_observation():
    tau, _, _ = roll(Probe(one, length=2), 2, replace(EIPO, num_steps=3))
    assert tau.terminated.all(1).tolist() == [False, True, False] and not tau.truncated.any()
    assert tau.final[0].shape == (0, 2)


def test_rollout_streams_are_of_comparable_size():
    """D6, D10. Standing: r = 1, f = -126 W. In training 0.02 * 1 = 0.02 and 0.02 * 0.005 * -126 = -0.0126 a step."""
    env, cfg = Probe(one, cost=lambda x, t, a: -126 + 0 * x), replace(EIPO, reward_scale=0.02, lam=0.005, num_steps=3)
    tau, _, log = roll(env, 2, cfg)
    assert tau.reward.shape == (3, 16, 2)
    assert tau.reward[..., 0].ravel().tolist() == pytest.approx([0.02] * 48)
    assert tau.reward[..., 1].ravel().tolist() == pytest.approx([-0.0126] * 48)
    assert log["cost"] == -126
    assert np.array_equal(roll(env, 1, cfg)[0].reward, tau.reward[..., :1])


def test_rollout_noise_is_fresh_at_every_step():
    """With mean 0 and std 1 the actions are the noise: 3 steps of 16 robots are 48 different numbers."""
    tau, _, _ = roll(Probe(one), 2, replace(EIPO, num_steps=3))
    assert np.unique(tau.action).size == 48


# ---- Algorithm 1 ----


def test_algorithm1_has_its_fourteen_lines_in_order():
    tags = re.findall(r"# Alg\.1 L(\d+)", inspect.getsource(eipo.eipo))
    assert [int(tag) for tag in tags] == list(range(1, 15))


@pytest.fixture(scope="module")
def with_effort():
    """Three states of EIPO, with the environments of pi and pi_prime."""
    env, env_prime = Probe(near_half, effort), Probe(near_half, effort)
    return run(env, env_prime, EIPO, 2), env, env_prime


def test_algorithm1_pi_prime_never_sees_energy(with_effort):
    """Another cost makes another pi; pi_prime has the same bits."""
    states, _, _ = with_effort
    free = run(Probe(near_half), Probe(near_half), EIPO, 2)
    assert trees_equal(free[2][0].pi_prime, states[2][0].pi_prime)
    assert not trees_equal(free[1][0].pi.params, states[1][0].pi.params)
    assert not trees_equal(states[1][0].pi_prime.params, states[2][0].pi_prime.params)


def test_algorithm1_same_seed_same_bits(with_effort):
    states, _, _ = with_effort
    again = run(Probe(near_half, effort), Probe(near_half, effort), EIPO, 2)
    assert trees_equal(again[2], states[2])


def test_algorithm1_other_seed_other_start(monkeypatch):
    """Seeds 0 and 1, pi and pi_prime: the networks have four different keys, the environments four different seeds."""
    monkeypatch.setattr(eipo, "init_learner", lambda key, *_: tuple(jax.random.key_data(key).tolist()))
    keys, envs = [], []
    for seed in (0, 1):
        env, env_prime = Probe(one), Probe(one)
        state = eipo.init_state(env, env_prime, replace(EIPO, seed=seed))
        keys += [state.pi, state.pi_prime]
        envs += env.seeds + env_prime.seeds
    assert len(set(keys)) == len(set(envs)) == len(envs) == 4


def test_algorithm1_policies_share_no_luck(with_effort):
    """Line 3 initialises two policies. 2 policies x 2 iterations x 8 steps x 16 robots: all their noise differs."""
    states, env, env_prime = with_effort
    start = states[0][0]
    assert not trees_equal(start.pi.params["actor"], start.pi_prime.params["actor"])
    noise = []
    for diary, name in ((env.diary, "pi"), (env_prime.diary, "pi_prime")):
        for t, (obs, action) in enumerate(diary):
            mean, std, _ = networks.policy(getattr(states[t // 8][0], name).params, obs)
            noise.append((action - np.asarray(mean)) / np.asarray(std))
    assert len(noise) == 32
    assert np.unique(np.round(noise, 4)).size > 0.95 * np.size(noise)


def test_algorithm1_ppo_has_neither_pi_prime_nor_a_moving_alpha():
    (start, _), (_, _), (end, metrics) = run(Probe(near_half), None, PPO, 2)
    assert end.pi_prime is None and end.at_prime is None
    assert start.dual == end.dual == Dual(0.25, 0)
    assert "gap" not in metrics and not [name for name in metrics if name.startswith("prime_")]


def test_algorithm1_eipo_starts_as_ppo(with_effort):
    """D6: alpha_0 = 1 / lam, so that EIPO's first update of pi is PPO's at that lam, bit by bit; the second is not."""
    states, _, _ = with_effort
    ppo = run(Probe(near_half, effort), None, PPO, 2)
    assert trees_equal(ppo[1][0].pi, states[1][0].pi)
    assert not trees_equal(ppo[2][0].pi, states[2][0].pi)


@pytest.mark.parametrize(
    ("changes", "alpha"),
    [(dict(lam=0.25), 4), (dict(lam=0.25, alpha0=1.5), 1.5), (dict(algo="ppo", lam=0.0), np.inf)],
    ids=str,
)
def test_algorithm1_alpha_at_the_start(monkeypatch, changes, alpha):
    """1 / lam = 4, unless alpha0 says otherwise; no energy term is an infinite alpha."""
    monkeypatch.setattr(eipo, "init_learner", lambda *_: None)
    assert eipo.init_state(Probe(one), Probe(one), replace(EIPO, **changes)).dual == Dual(alpha, 0)


def test_algorithm1_line_13_gets_the_gap_and_line_9_its_alpha(with_effort):
    """pi earns 1 a step, pi_prime 3: the gap is far below 0. What line 13 returns is what the next line 9 uses."""
    gaps = []

    def jump(dual, gap, cfg):
        gaps.append(gap)
        return Dual(64.0, 7.0)

    states = run(Probe(one), Probe(lambda x, t, a: 3 + 0 * x), EIPO, 2, line_13=jump)
    assert gaps == [metrics["gap"] for _, metrics in states[1:]]
    assert gaps[0] < -0.5
    assert [state.dual for state, _ in states] == [Dual(0.25, 0), Dual(64, 7), Dual(64, 7)]
    assert [metrics["alpha"] for _, metrics in states[1:]] == [0.25, 64]
    jumped = run(Probe(near_half, effort), Probe(near_half, effort), EIPO, 2, line_13=jump)
    assert trees_equal(jumped[1][0].pi, with_effort[0][1][0].pi)
    assert not trees_equal(jumped[2][0].pi, with_effort[0][2][0].pi)


def test_algorithm1_counts_the_steps_of_both_policies(with_effort):
    """2 iterations of 8 steps in 32 environments, 16 for each policy (D9)."""
    states, env, env_prime = with_effort
    assert states[2][1]["steps"] == 2 * 8 * 32 == 16 * len(env.diary) + 16 * len(env_prime.diary)
    assert [state.iteration for state, _ in states] == [0, 1, 2]


def test_algorithm1_resumes_with_the_same_bits(with_effort):
    """Stopped after the first iteration and continued, with the environments as they were: they are not reset."""
    states, _, _ = with_effort
    envs = Probe(near_half, effort), Probe(near_half, effort)
    first, _ = run(*envs, EIPO, 1)[1]
    resumed = run(*envs, EIPO, 1, first)
    assert trees_equal(resumed[0][0], first)
    assert trees_equal(resumed[1], states[2])
    assert [env.seeds for env in envs] == [[0], [1]]


# ---- the toy: one number theta, F = theta^2 ----


def toy(J, climb, cfg, iterations):
    """Lines 5 to 14 on one number, with the shipped line 13. returns alphas and thetas, one per iteration.

    climb(theta, alpha, weight): a step up on alpha J - weight F; pi has weight 1, pi_prime climbs J alone
    """
    theta, theta_prime, dual, history = 0.0, 0.0, Dual(0.2, 0.0), []
    for _ in range(iterations):
        theta, theta_prime = climb(theta, dual.alpha, 1), climb(theta_prime, 1.0, 0)
        dual = eipo.step_alpha(dual, J(theta) - J(theta_prime), cfg)
        history.append((dual.alpha, theta))
    return np.transpose(history)


def capped(theta):
    """Faster than the command of 1 earns no more, as in Eq. (5), which has no kink there, however."""
    return min(theta, 1.0)


def climb_capped(theta, alpha, weight, lr=0.05):
    """The step down on F, then the one up on alpha J, which ends at the kink (a proximal gradient step)."""
    theta -= lr * weight * 2 * theta
    return max(theta, min(theta + lr * alpha, 1.0))


def smooth(theta):
    return -((theta - 1) ** 2)


def climb_smooth(theta, alpha, weight, lr=0.02):
    return theta - lr * (2 * alpha * (theta - 1) + weight * 2 * theta)


def test_algorithm1_toy_stops_at_the_smallest_alpha_that_keeps_the_task():
    """argmax alpha J - F = min(alpha / 2, 1), and pi_prime has J' = 1: from below, alpha stops at 2, theta at 1."""
    alpha, theta = toy(capped, climb_capped, replace(EIPO, lr_alpha=0.02, momentum_alpha=0.0), 2000)
    assert alpha[-1] == pytest.approx(2, abs=1e-3)
    assert theta[-1] == pytest.approx(1, abs=1e-3)
    assert (np.diff(alpha) >= 0).all() and alpha.max() < 2.001


def test_algorithm1_toy_momentum_overshoots_and_stays():
    """The momentum carries alpha past 2; with J = J' there the gradient is 0, and nothing pulls it down again."""
    alpha, theta = toy(capped, climb_capped, replace(EIPO, lr_alpha=0.02, momentum_alpha=0.99), 6000)
    assert alpha[-1] > 2.5
    assert alpha[-1000] == alpha[-1]
    assert theta[-1] == 1


def test_algorithm1_toy_alpha_grows_without_bound_where_the_task_has_no_kink():
    """J = -(theta - 1)^2: theta = alpha / (1 + alpha) < 1, so the gap -1 / (1 + alpha)^2 is never 0, alpha never rests.

    d alpha / dn = 1 / (1 + alpha)^2: 1 + alpha = (3 n)^(1/3), about 18 after 2000 iterations.
    """
    alpha, theta = toy(smooth, climb_smooth, replace(EIPO, lr_alpha=1.0, momentum_alpha=0.0), 2000)
    assert 15 < alpha[-1] < 20
    assert (np.diff(alpha[100:]) > 0).all()
    assert theta[-1] < 1


# ---- probes ----


def learn(env, iterations, env_prime=None, cfg=PPO):
    """The State after so many iterations."""
    return run(env, env_prime, cfg, iterations)[-1][0]


def at(t):
    """What a Probe shows where x is -1 and where it is 1: obs (2, 2), privileged (2, 1)."""
    return np.array([[-1, t], [1, t]], np.float32), np.array([[t - 1], [t + 1]], np.float32)


def values(state, t=0):
    """V (2, K) where x is -1 and where it is 1."""
    return np.asarray(networks.value(state.pi.params, *at(t)))


def means(learner):
    """Mean actions where x is -1 and where it is 1."""
    return np.asarray(networks.policy(learner.params, at(0)[0])[0])[:, 0]


def near(x):
    return pytest.approx(np.broadcast_to(x, 2), abs=0.1)


def test_probe_1_constant_reward():
    """One step, reward 1, cost 1/2: V = (1, 4 / 2)."""
    state = learn(Probe(one, cost=lambda x, t, a: 0.5 + 0 * x), 60)
    assert values(state)[:, 0] == near(1)
    assert values(state)[:, 1] == near(2)


def test_probe_2_reward_seen_in_the_observation():
    """One step, reward x: V = -1 and 1."""
    assert values(learn(Probe(lambda x, t, a: x), 60))[:, 0] == near([-1, 1])


@pytest.fixture(scope="module")
def after_two_steps():
    """Two-step episodes that pay 2 x at their end."""
    return learn(Probe(lambda x, t, a: 2 * x * t, length=2), 100)


def test_probe_3_discounting(after_two_steps):
    """V = -2 and 2 at the second step, gamma = 1/2 of it at the first."""
    assert values(after_two_steps, t=1)[:, 0] == near([-2, 2])
    assert values(after_two_steps, t=0)[:, 0] == near([-1, 1])


def test_estimator_learns_what_is_privileged(after_two_steps):
    """x + t, from an observation of x and t."""
    for t in (0, 1):
        obs, privileged = at(t)
        estimate = networks.policy(after_two_steps.pi.params, obs)[2]
        assert np.ravel(estimate) == near(np.ravel(privileged))


def test_probe_4_a_time_limit_is_not_the_end():
    """Reward x at every step, for as long as one likes: V = x / (1 - 1/2) = 2 x.

    Cut as if by a fall it would be x (probe 2), bootstrapped from the next episode's x it would be x too.
    """
    assert values(learn(Probe(lambda x, t, a: x, truncates=True), 100))[:, 0] == near([-2, 2])


def test_probe_5_action():
    """The best action is 1/2, wherever one is."""
    assert means(learn(Probe(near_half), 60).pi) == near(0.5)


def test_probe_6_action_for_an_observation():
    """The best action is x / 2."""
    assert means(learn(Probe(lambda x, t, a: -((a - x / 2) ** 2)), 60).pi) == near([-0.5, 0.5])


def test_probe_7_ppo_trades_the_task_for_energy():
    """-(a - 1/2)^2 - 4 a^2 is best at a = 1/10."""
    assert means(learn(Probe(near_half, effort), 60).pi) == near(0.1)


def test_probe_7_eipo_puts_the_task_first():
    """From the same weight, pi_prime shows that the task pays more: alpha rises, and pi comes to 1/2 as well."""
    state = learn(Probe(near_half, effort), 100, Probe(near_half, effort), EIPO)
    assert state.dual.alpha > 4
    assert (means(state.pi) > 0.35).all()
    assert means(state.pi_prime) == near(0.5)
