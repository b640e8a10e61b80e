"""Section III: Algorithm 1 as a whole. Its rollouts, lines, two policies and multiplier; a toy;
probes.

The toy has a known answer. The probes, after Andy Jones, are environments so small that the right
answer is plain: one that fails says which part is broken.
"""

import inspect
import re
from dataclasses import replace
from itertools import islice

import jax
import numpy as np
import pytest
from support import EIPO, handmade, trees_equal

import eipo
import networks
from eipo import Dual

policy = jax.jit(networks.policy)


class Probe:
    """16 environments with episodes of `length` steps. One sees x, drawn from -1 and 1, and t; x +
    t is privileged.

    reward, cost: functions of x, t and the action, each (16,). truncates: whether episodes end by a
        time limit. The
    final observation of such an episode shows x and length - 1. `diary` holds what was seen and
    done, `seeds` resets.
    """

    num_envs, obs_size, privileged_size, action_size, mirror = 16, 2, 1, 1, None

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
        return np.stack([self.x, self.t], -1).astype(np.float32), (self.x + self.t)[:, None].astype(
            np.float32
        )

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
        info = dict(
            cost=self.cost(*now),
            privileged=privileged,
            final_obs=final_obs,
            final_privileged=final_privileged,
            log=log,
        )
        return obs, self.reward(*now), ended & (not self.truncates), ended & self.truncates, info


def one(x, t, a):
    return 1 + 0 * x


def near_half(x, t, a):
    return -((a - 0.5) ** 2)


def effort(x, t, a):
    return a**2


def run(env, env_prime, cfg=EIPO, iterations=2, state=None, **options):
    """[(State, metrics)] before the first and after every iteration. Without env_prime it is PPO on
    r - lam f.
    """
    state = state or eipo.init_state(env, env_prime, cfg)
    steps = (
        eipo.eipo(env, env_prime, cfg, state, **options) if env_prime else eipo.ppo(env, cfg, state)
    )
    return [(state, {}), *islice(steps, iterations)]


# ---- L6, L7: rollouts ----


def known(heads):
    """Parameters with mean action 0, std 1 and values 3 t, and 6 t where there are two heads, of
    what a Probe shows.

    3 t = -x + 2 t + (x + t), of which x + t is privileged.
    """
    critic = np.array([[-1.0, -2.0], [2.0, 4.0], [1.0, 2.0]])[:, :heads]
    return handmade(critic, estimator=np.zeros((2, 1)), actor=np.zeros((3, 1)))


def roll(env, params, **changes):
    """Three steps of env, from a reset."""
    obs, info = env.reset(0)
    cfg = replace(EIPO, num_steps=3, **changes)
    return *eipo.rollout(env, params, (obs, info["privileged"]), jax.random.key(0), cfg), cfg


def test_algorithm1_line06_rollout_bootstraps_from_the_final_observation():
    """Episodes of 1, 2 and 3 steps, cut by a time limit; the final observation is (x, length - 1).
    gamma = 1/2, r = 0.

    V = (3 t, 6 t). The one-step errors of the first value, with gae_lambda = 0, by where the three
    steps lead:
    length 1: to the final observation, 0 + 0/2 - 0 = 0, three times
    length 2: to t = 1, 0 + 3/2 - 0 = 3/2; final, 0 + 3/2 - 3 = -3/2 (the next episode's first would
        give -3); 3/2
    length 3: to t = 1, 3/2; to t = 2, 6/2 - 3 = 0; final, 6/2 - 6 = -3
    """
    probe = Probe(lambda x, t, a: 0 * x, length=1 + np.arange(16) % 3, truncates=True)
    tau, at, log, cfg = roll(probe, known(2), gae_lambda=0.0)
    assert tau.truncated[:, :3].tolist() == [
        [True, False, False],
        [True, True, False],
        [True, False, True],
    ]
    assert not tau.terminated.any() and tau.final[0].shape == (32, 2)  # 6, 11 and 11 robots, padded
    first = np.array([[0, 1.5, 1.5], [0, -1.5, 0], [0, 1.5, -3]])[:, np.arange(16) % 3]
    advantage = np.asarray(eipo.estimate(known(2), tau, cfg).advantage)
    assert (advantage == first[..., None] * [1, 2]).all()
    assert tau.obs[:, 1, 1].tolist() == [0, 1, 0] and tau.after[0][1, 1] == 1
    assert trees_equal(at, tau.after)
    assert log["ended"] == tau.truncated.sum() == 28 and log["reward"] == 0


class Overtime(Probe):
    """A Probe whose final observation shows the time `length`, at which no step begins."""

    def step(self, action):
        *result, info = super().step(action)
        info["final_obs"][:, 1] += 1
        info["final_privileged"] += 1
        return *result, info


def test_algorithm1_line06_rollout_bootstraps_from_where_the_last_step_led():
    """Episodes of 2 steps lead to t = 1 and, at the time limit, to t = 2, before the next one's 0.
    gamma = 1/2, r = 0.

    V = 3 t: 0 + 3/2 - 0 = 3/2; final, 6/2 - 3 = 0; 3/2 again. From the observation with which the
    last step began it would be 3/2 - 3.
    """
    tau, _, _, cfg = roll(
        Overtime(lambda x, t, a: 0 * x, length=2, truncates=True), known(1), gae_lambda=0.0
    )
    own = tau.obs[1, :, 0]  # x of the episodes that end
    assert tau.final[0].tolist() == [[x, 2] for x in own]
    assert tau.final[1].tolist() == [[x + 2] for x in own]
    advantage = np.asarray(eipo.estimate(known(1), tau, cfg).advantage)
    assert (advantage[..., 0] == [[1.5], [0], [1.5]]).all()


def test_algorithm1_line06_rollout_a_fall_has_no_final_observation():
    tau, *_ = roll(Probe(one, length=2), known(2))
    assert tau.terminated.all(1).tolist() == [False, True, False] and not tau.truncated.any()
    assert tau.final[0].shape == (0, 2)


def test_algorithm1_line06_rollout_streams_are_of_comparable_size():
    """D6, D10. Standing: r = 1, f = -126 W. In training 0.02 * 1 = 0.02 and 0.02 * 0.005 * -126 =
    -0.0126 a step.
    """
    env, scales = Probe(one, cost=lambda x, t, a: -126 + 0 * x), dict(reward_scale=0.02, lam=0.005)
    tau, _, log, _ = roll(env, known(2), **scales)
    assert tau.reward.shape == (3, 16, 2) and log["cost"] == -126
    assert tau.reward.reshape(48, 2) == pytest.approx(np.tile([0.02, -0.0126], (48, 1)))
    assert np.array_equal(roll(env, known(1), **scales)[0].reward, tau.reward[..., :1])


def test_algorithm1_line06_rollout_noise_is_fresh_at_every_step():
    """With mean 0 and std 1 the actions are the noise: 3 steps of 16 robots are 48 different
    numbers.
    """
    assert np.unique(roll(Probe(one), known(2))[0].action).size == 48


# ---- Algorithm 1 ----


def test_algorithm1_has_its_fourteen_lines_in_order():
    tags = re.findall(r"# Alg\.1 L(\d+)", inspect.getsource(eipo.eipo))
    assert [int(tag) for tag in tags] == list(range(1, 15))


@pytest.fixture(scope="module")
def with_effort():
    """Three states of EIPO, with the environments of pi and pi_prime."""
    env, env_prime = Probe(near_half, effort), Probe(near_half, effort)
    return run(env, env_prime), env, env_prime


def test_algorithm1_pi_prime_never_sees_energy(with_effort):
    """Another cost makes another pi; pi_prime has the same bits."""
    states, _, _ = with_effort
    free = run(Probe(near_half), Probe(near_half))
    assert trees_equal(free[2][0].pi_prime, states[2][0].pi_prime)
    assert not trees_equal(free[1][0].pi.params, states[1][0].pi.params)
    assert not trees_equal(states[1][0].pi_prime.params, states[2][0].pi_prime.params)


def test_algorithm1_same_seed_same_bits(with_effort):
    states, _, _ = with_effort
    assert trees_equal(run(Probe(near_half, effort), Probe(near_half, effort))[2], states[2])


def test_algorithm1_other_seed_other_start(monkeypatch):
    """Seeds 0 and 1, pi and pi_prime: the networks have four different keys, the environments four
    different seeds.
    """
    monkeypatch.setattr(
        eipo, "init_learner", lambda key, *_: tuple(jax.random.key_data(key).tolist())
    )
    keys, envs = [], []
    for seed in (0, 1):
        env, env_prime = Probe(one), Probe(one)
        state = eipo.init_state(env, env_prime, replace(EIPO, seed=seed))
        keys += [state.pi, state.pi_prime]
        envs += env.seeds + env_prime.seeds
    assert len(set(keys)) == len(set(envs)) == len(envs) == 4


def test_algorithm1_policies_share_no_luck(with_effort):
    """Line 3 initialises two policies. 2 policies x 2 iterations x 8 steps x 16 robots: all their
    noise differs.
    """
    states, env, env_prime = with_effort
    start = states[0][0]
    assert not trees_equal(start.pi.params["actor"], start.pi_prime.params["actor"])
    noise = []
    for diary, name in ((env.diary, "pi"), (env_prime.diary, "pi_prime")):
        for t, (obs, action) in enumerate(diary):
            mean, std, _ = policy(getattr(states[t // 8][0], name).params, obs)
            noise.append((action - np.asarray(mean)) / np.asarray(std))
    assert len(noise) == 32
    assert np.unique(np.round(noise, 4)).size > 0.95 * np.size(noise)


def test_algorithm1_uses_no_key_twice(monkeypatch):
    """Two iterations of two rollouts and two updates, each of which shuffles: eight keys."""
    keys = []
    for name, place in (("rollout", 3), ("ppo_update", 4)):

        def spy(*args, function=getattr(eipo, name), place=place):
            keys.append(tuple(jax.random.key_data(args[place]).tolist()))
            return function(*args)

        monkeypatch.setattr(eipo, name, spy)
    run(Probe(near_half, effort), Probe(near_half, effort))
    assert len(keys) == len(set(keys)) == 8


def test_algorithm1_ppo_has_neither_pi_prime_nor_a_moving_alpha(with_effort):
    """Its metrics are those of EIPO, but for the gap and what is of pi_prime."""
    (start, _), (_, _), (end, metrics) = run(Probe(near_half), None)
    assert end.pi_prime is None and end.start_prime is None
    assert start.dual == end.dual == Dual(0.25, 0)
    assert set(metrics) == {
        name for name in with_effort[0][2][1] if name != "gap" and not name.startswith("prime_")
    }


def test_algorithm1_ends_after_its_iterations():
    """Line 14. From two, one and no iterations before the last, EIPO and PPO go through two, one
    and none.
    """
    env, env_prime = Probe(one), Probe(one)
    start, end = eipo.init_state(env, env_prime, EIPO), EIPO.iterations
    for left in range(3):
        state = start._replace(iteration=end - left)
        for steps in (eipo.eipo(env, env_prime, EIPO, state), eipo.ppo(env, EIPO, state)):
            assert [state.iteration for state, _ in steps] == list(range(end - left + 1, end + 1))


def test_algorithm1_eipo_starts_as_ppo(with_effort):
    """D6: alpha_0 = 1 / lam, so the first update of pi is PPO's at that lam, bit by bit. All are,
    if alpha is held.
    """
    states, _, _ = with_effort
    ppo = run(Probe(near_half, effort), None)
    assert trees_equal(ppo[1][0].pi, states[1][0].pi)
    assert not trees_equal(ppo[2][0].pi, states[2][0].pi)
    held = run(Probe(near_half, effort), Probe(near_half, effort), replace(EIPO, lr_alpha=0.0))
    assert trees_equal(ppo[2][0].pi, held[2][0].pi)


@pytest.mark.parametrize(
    ("changes", "alpha"),
    [(dict(lam=0.25), 4), (dict(lam=0.25, alpha0=1.5), 1.5), (dict(algo="ppo", lam=0.0), np.inf)],
    ids=str,
)
def test_algorithm1_alpha_at_the_start(monkeypatch, changes, alpha):
    """1 / lam = 4, unless alpha0 says otherwise; no energy term is an infinite alpha."""
    monkeypatch.setattr(eipo, "init_learner", lambda *_: None)
    assert eipo.init_state(Probe(one), Probe(one), replace(EIPO, **changes)).dual == Dual(alpha, 0)


@pytest.mark.parametrize("mirror", [True, False])
def test_algorithm1_both_policies_have_the_mirror_of_the_robot(monkeypatch, mirror):
    """D28. Unless it is told not to, and where the robot has one."""
    monkeypatch.setattr(eipo, "init_learner", lambda key, sizes, mirror, *_: mirror)
    env, env_prime = Probe(one), Probe(one)
    env.mirror = dict(obs=((0, 1), (-1, 1)), privileged=((0,), (1,)), action=((0,), (-1,)))
    env_prime.mirror = env.mirror | dict(action=((0,), (1,)))
    state = eipo.init_state(env, env_prime, replace(EIPO, mirror=mirror))
    of_env = networks.Mirror(((0, 1), (-1, 1)), ((0,), (1,)), ((0,), (-1,)))
    of_env_prime = networks.Mirror(((0, 1), (-1, 1)), ((0,), (1,)), ((0,), (1,)))
    expected = (of_env, of_env_prime) if mirror else (None, None)
    assert (state.pi, state.pi_prime) == expected
    assert eipo.init_state(Probe(one), None, replace(EIPO, mirror=mirror)).pi is None


def test_algorithm1_another_key_is_other_luck(with_effort):
    """A process is given a key of its own in the State: its exploration and minibatches differ from
    the start on.
    """
    start = eipo.init_state(Probe(one), Probe(one), EIPO)
    others = start.key, jax.random.fold_in(start.key, 1)
    assert len({tuple(key.tolist()) for own in others for key in eipo.iteration_keys(own, 1)}) == 8
    envs = Probe(near_half, effort), Probe(near_half, effort)
    start = eipo.init_state(*envs, EIPO)._replace(key=others[1])
    other = run(*envs, EIPO, 1, start)
    assert not trees_equal(other[1][0].pi.params, with_effort[0][1][0].pi.params)


@pytest.mark.parametrize("algo, lam", [("eipo", 4.0), ("ppo", 4.0), ("ppo", 0.0)])
def test_algorithm1_learns_in_every_branch(algo, lam):
    """One iteration moves every network, and skips no minibatch; without energy an infinite alpha
    is no 0 * inf.
    """
    cfg = replace(EIPO, lam=lam)
    (start, _), (end, log) = run(
        Probe(near_half, effort), Probe(near_half, effort) if algo == "eipo" else None, cfg, 1
    )
    for name in ("pi", "pi_prime") if algo == "eipo" else ("pi",):
        before, after = getattr(start, name).params, getattr(end, name).params
        moved = jax.tree.map(lambda a, b: bool((a != b).any()) or a.size == 0, before, after)
        assert (
            jax.tree.all(moved) and log["prime_skipped" if name == "pi_prime" else "skipped"] == 0
        )


def test_algorithm1_at_alpha_zero_pi_knows_the_cost_alone():
    """alpha J - F = -F: whatever the task pays, the actor of pi learns the same bits."""
    ends = []
    for reward in (one, near_half):
        env, env_prime = Probe(reward, effort), Probe(reward, effort)
        state = eipo.init_state(env, env_prime, EIPO)._replace(dual=Dual(0.0, 0.0))
        ends.append(run(env, env_prime, EIPO, 1, state)[-1][0].pi.params["actor"])
    assert trees_equal(*ends)
    assert not trees_equal(ends[0], state.pi.params["actor"])


def test_algorithm1_line_13_gets_the_gap_and_line_9_its_alpha(with_effort, monkeypatch):
    """pi earns 1 a step, pi_prime 3: the gap is far below 0. What line 13 returns is what the next
    line 9 uses.
    """
    gaps = []

    def jump(dual, gap, cfg):
        gaps.append(gap)
        return Dual(64.0, 7.0)

    monkeypatch.setattr(eipo, "step_alpha", jump)
    states = run(Probe(one), Probe(lambda x, t, a: 3 + 0 * x))
    assert gaps == [metrics["gap"] for _, metrics in states[1:]]
    assert gaps[0] < -0.5
    assert [state.dual for state, _ in states] == [Dual(0.25, 0), Dual(64, 7), Dual(64, 7)]
    assert [metrics["alpha"] for _, metrics in states[1:]] == [0.25, 64]
    jumped = run(Probe(near_half, effort), Probe(near_half, effort))
    assert trees_equal(jumped[1][0].pi, with_effort[0][1][0].pi)
    assert not trees_equal(jumped[2][0].pi, with_effort[0][2][0].pi)


def test_algorithm1_steps_both_policies(with_effort):
    """2 iterations of 8 steps in 32 environments, 16 for each policy (D9)."""
    states, env, env_prime = with_effort
    assert 16 * len(env.diary) + 16 * len(env_prime.diary) == 2 * 8 * 32
    assert [state.iteration for state, _ in states] == [0, 1, 2]


def test_algorithm1_resumes_with_the_same_bits(with_effort):
    """Stopped after the first iteration and continued, with the environments as they were: they are
    not reset.
    """
    states, _, _ = with_effort
    envs = Probe(near_half, effort), Probe(near_half, effort)
    first, _ = run(*envs, iterations=1)[1]
    resumed = run(*envs, iterations=1, state=first)
    assert trees_equal(resumed[0][0], first)
    assert trees_equal(resumed[1], states[2])
    assert [env.seeds for env in envs] == [[0], [1]]


# ---- what is not finite (D44) ----


class Faulty(Probe):
    """A Probe whose robot 5 has a `value` that is no number in the place of a `name`, once or at
    every step after.
    """

    def __init__(self, name, value, step=3, always=False, **fields):
        super().__init__(near_half, effort, **fields)
        self.name, self.value, self.step_of_fault, self.always = name, value, step, always

    def step(self, action):
        obs, reward, terminated, truncated, info = super().step(action)
        if len(self.diary) == self.step_of_fault or self.always:
            dict(obs=obs, reward=reward, **info)[self.name][slice(None) if self.always else 5] = (
                self.value
            )
        return obs, reward, terminated, truncated, info


@pytest.mark.parametrize("algo", ["eipo", "ppo"])
def test_algorithm1_learns_nothing_from_what_is_not_finite(algo):
    """Two iterations of rewards that are no number: 2 x 4 x 2 minibatches are skipped, and alpha
    stays where it is.
    """
    env, env_prime = Faulty("reward", np.nan, always=True), Probe(near_half, effort)
    (start, _), _, (end, log) = run(env, env_prime if algo == "eipo" else None)
    assert log["skipped"] == end.pi.opt_state.notfinite_count == 2 * 4 * 2
    assert trees_equal(start.pi.params, end.pi.params) and start.dual == end.dual == Dual(0.25, 0)


# ---- the toy: a robot of one number, its speed theta, that can be solved by hand; F = theta^2 ----


def toy(J, climb, cfg, iterations):
    """Lines 5 to 14 on one number, with the shipped line 13. returns alphas and thetas, one per
    iteration.

    climb(theta, alpha, weight): a step up on alpha J - weight F; pi has weight 1, pi_prime climbs J
    alone
    """
    theta, theta_prime, dual, history = 0.0, 0.0, Dual(0.2, 0.0), []
    for _ in range(iterations):
        theta, theta_prime = climb(theta, dual.alpha, 1), climb(theta_prime, 1.0, 0)
        dual = eipo.step_alpha(dual, J(theta) - J(theta_prime), cfg)
        history.append((dual.alpha, theta))
    return np.transpose(history)


def capped(theta):
    """J: faster than the command of 1 earns no more, as in Eq. (5), which has no kink there,
    however.
    """
    return min(theta, 1.0)


def climb_capped(theta, alpha, weight, lr=0.05):
    """The step down on F, then the one up on alpha J, which ends at the kink (a proximal gradient
    step).
    """
    theta -= lr * weight * 2 * theta
    return max(theta, min(theta + lr * alpha, 1.0))


def smooth(theta):
    """J without a kink."""
    return -((theta - 1) ** 2)


def climb_smooth(theta, alpha, weight, lr=0.02):
    """A gradient step."""
    return theta - lr * (2 * alpha * (theta - 1) + weight * 2 * theta)


def test_eq03_algorithm1_toy_stops_at_the_smallest_alpha_that_keeps_the_task():
    """argmax alpha J - F = min(alpha / 2, 1), and pi_prime has J' = 1: from below, alpha stops at
    2, theta at 1.
    """
    alpha, theta = toy(capped, climb_capped, replace(EIPO, lr_alpha=0.02, momentum_alpha=0.0), 2000)
    assert alpha[-1] == pytest.approx(2, abs=1e-3)
    assert theta[-1] == pytest.approx(1, abs=1e-3)
    assert (np.diff(alpha) >= 0).all() and alpha.max() < 2.001


def test_algorithm1_toy_momentum_overshoots_and_stays():
    """The momentum carries alpha past 2; with J = J' there the gradient is 0, and nothing pulls it
    down again.
    """
    alpha, theta = toy(
        capped, climb_capped, replace(EIPO, lr_alpha=0.02, momentum_alpha=0.99), 6000
    )
    assert alpha[-1] > 2.5
    assert alpha[-1000] == alpha[-1]
    assert theta[-1] == 1


def test_algorithm1_toy_alpha_grows_without_bound_where_the_task_has_no_kink():
    """J = -(theta - 1)^2: theta = alpha / (1 + alpha) < 1, so the gap -1 / (1 + alpha)^2 is never
    0, alpha never rests.

    d alpha / dn = 1 / (1 + alpha)^2: 1 + alpha = (3 n)^(1/3), about 18 after 2000 iterations.
    """
    alpha, theta = toy(smooth, climb_smooth, replace(EIPO, lr_alpha=1.0, momentum_alpha=0.0), 2000)
    assert 15 < alpha[-1] < 20
    assert (np.diff(alpha[100:]) > 0).all()
    assert theta[-1] < 1


# ---- probes ----


def learn(env, iterations, env_prime=None):
    """The State after so many iterations."""
    return run(env, env_prime, EIPO, iterations)[-1][0]


def at(t):
    """What a Probe shows where x is -1 and where it is 1: obs (2, 2), privileged (2, 1)."""
    return np.array([[-1, t], [1, t]], np.float32), np.array([[t - 1], [t + 1]], np.float32)


def values(state, t=0):
    """V (2, K) where x is -1 and where it is 1."""
    return np.asarray(networks.value(state.pi.params, *at(t)))


def means(learner):
    """Mean actions where x is -1 and where it is 1."""
    return np.asarray(policy(learner.params, at(0)[0])[0])[:, 0]


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
        estimate = policy(after_two_steps.pi.params, obs)[2]
        assert np.ravel(estimate) == near(np.ravel(privileged))


def test_probe_4_a_time_limit_is_not_the_end():
    """Reward x at every step, for as long as one likes: V = x / (1 - 1/2) = 2 x.

    Cut as if by a fall it would be x (probe 2), bootstrapped from the next episode's x it would be
    x too.
    """
    assert values(learn(Probe(lambda x, t, a: x, truncates=True), 100))[:, 0] == near([-2, 2])


@pytest.mark.parametrize(
    "reward, cost, best",
    [
        (near_half, None, [0.5, 0.5]),
        (lambda x, t, a: -((a - x / 2) ** 2), None, [-0.5, 0.5]),
        (near_half, effort, [0.1, 0.1]),
    ],
    ids=["5: 1/2 wherever one is", "6: x / 2", "7: -(a - 1/2)^2 - 4 a^2 is best at 1/10"],
)
def test_probes_5_to_7_the_best_action(reward, cost, best):
    """PPO finds it: alone, for an observation, and where it trades the task for energy."""
    assert means(learn(Probe(reward, cost) if cost else Probe(reward), 60).pi) == near(best)


def test_eq03_eipo_puts_the_task_first():
    """From the same weight, pi_prime shows that the task pays more: alpha rises, and pi comes to
    1/2 as well.
    """
    state = learn(Probe(near_half, effort), 100, Probe(near_half, effort))
    assert state.dual.alpha > 4
    assert (means(state.pi) > 0.35).all()
    assert means(state.pi_prime) == near(0.5)
