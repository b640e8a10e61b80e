"""Section III: Algorithm 1 as a whole, its rollouts, its lines and, at the end, probes.

A probe is an environment so small that the right answer is plain, so one that fails says which part
is broken. (The idea is of Andy Jones's "Debugging RL".)
"""

import inspect
import re
from dataclasses import replace
from itertools import islice

import jax
import numpy as np
import pytest
from support import EIPO, handmade, learner_of, trees_equal

import eipo
import networks
from eipo import Dual, State
from tasks import LAMBDAS


@jax.jit
def policy(pi, obs):
    """Mean and deviation of the action, and the estimate, of a Learner."""
    return networks.policy(pi.params, obs)


class Probe:
    """16 environments whose episodes have `length` steps. An observation is (x, t): x is -1 or 1,
    and t counts the steps.

    reward, cost: functions of x, t and the action, each (16,)
    truncates:    whether episodes end because their time is up, or as by a fall

    What is privileged is x + t. The final observation of an episode shows x and length - 1.
    `diary` holds what was seen and done, `seeds` the seeds of all resets.
    """

    num_envs, obs_size, privileged_size, action_size = 16, 2, 1, 1

    def __init__(self, reward, cost=lambda x, t, a: 0 * x, length=1, truncates=False):
        self.reward, self.cost, self.length, self.truncates = reward, cost, length, truncates
        self.diary, self.seeds = [], []

    def reset(self, seed):
        self.seeds.append(seed)
        self.rng = np.random.default_rng(seed)
        self.x, self.t = self.rng.choice([-1.0, 1.0], self.num_envs), np.zeros(self.num_envs)

    def observe(self):
        obs = np.stack([self.x, self.t], -1).astype(np.float32)
        return obs, obs.sum(-1, keepdims=True)

    def step(self, action):
        self.diary.append((self.observe()[0], action))
        now = self.x, self.t, action[:, 0]
        ended = self.t == self.length - 1
        self.t = np.minimum(self.t + 1, self.length - 1)
        final_obs, final_privileged = self.observe()
        self.x = np.where(ended, self.rng.choice([-1.0, 1.0], self.num_envs), self.x)
        self.t = np.where(ended, 0.0, self.t)
        info = dict(cost=self.cost(*now), log=dict(action=now[2], ended=ended))
        obs, privileged = self.observe()
        info |= dict(final_obs=final_obs, final_privileged=final_privileged, privileged=privileged)
        ends = ended & (not self.truncates), ended & self.truncates
        return obs, self.reward(*now), *ends, info


def one(x, t, a):
    return 1 + 0 * x


def near_half(x, t, a):
    return -((a - 0.5) ** 2)


def effort(x, t, a):
    return a**2


def run(env, env_prime, cfg=EIPO, iterations=2):
    """[(State, metrics)] before the first iteration and after each. Without env_prime it is PPO."""
    state = eipo.init_state([env, env_prime] if env_prime else [env], cfg)
    steps = eipo.eipo(env, env_prime, cfg, state) if env_prime else eipo.ppo(env, cfg, state)
    return [(state, {}), *islice(steps, iterations)]


# ---- L6, L7: rollouts ----


def known():
    """A Learner with mean action 0, deviation 1, and values 3 t and 6 t in a Probe.

    3 t = -x + 2 t + (x + t), of which x + t is privileged.
    """
    critic = [[-1.0, -2.0], [2.0, 4.0], [1.0, 2.0]]
    params = handmade(critic, estimator=np.zeros((2, 1)), actor=np.zeros((3, 1)))
    return learner_of(params)


def roll(env, pi):
    """Three steps of env, from a reset: tau and the log."""
    env.reset(0)
    return eipo.rollout(env, pi, jax.random.PRNGKey(0), replace(EIPO, num_steps=3))


def test_algorithm1_line06_rollout_bootstraps_from_the_final_observation():
    """Episodes of 1, 2 and 3 steps, until time is up. gamma = 1/2, r = 0, and V = 3 t and 6 t.

    The final observation is (x, length - 1), and the next episode begins at t = 0. Errors of the
    first value in each of the three steps, V(next) / 2 - V:

    length 1:   0/2 - 0 = 0       0                    0             each from 0 to the final 0
    length 2:   3/2 - 0 = 3/2     3/2 - 3 = -3/2       3/2           from 0 to 1, 1 to final 1, anew
    length 3:   3/2 - 0 = 3/2     6/2 - 3 = 0          6/2 - 6 = -3  from 0 to 1, 1 to 2, 2 to final
    """
    probe = Probe(lambda x, t, a: 0 * x, length=1 + np.arange(16) % 3, truncates=True)
    tau, log = roll(probe, known())
    ends = [[True, False, False], [True, True, False], [True, False, True]]
    assert tau.truncated[:, :3].tolist() == ends
    assert not tau.terminated.any()
    assert tau.obs[:, :3, 1].tolist() == [[0, 0, 0], [0, 1, 1], [0, 0, 2]]
    assert tau.next_obs[:, :3, 1].tolist() == [[0, 1, 1], [0, 1, 2], [0, 1, 2]]
    first = np.array([[0, 1.5, 1.5], [0, -1.5, 0], [0, 1.5, -3]])[:, np.arange(16) % 3]
    errors = eipo.estimate(known(), tau, replace(EIPO, gae_lambda=0.0)).advantage
    assert (errors == first[..., None] * [1, 2]).all()
    assert log["ended"] == pytest.approx(tau.truncated.mean()) == pytest.approx(28 / 48)
    assert log["reward"] == 0


def test_algorithm1_line08_the_critic_learns_lam_f_and_line_8_mixes_f():
    """D6, D10. A rollout holds r and f as they are, here r = 1 and f = 74 - 200 = -126 W of a robot
    that draws 74 W.

    With V = 0, a scale of 0.02 and lam = 1/200 pi's critic learns both, and pi_prime's r alone:

    r:  0.02 * 1             =  0.02
    f:  0.02 * -126 / 200    = -0.0126

    Line 8 mixes f itself, with the advantages 0.02 and 0.02 * -126 = -2.52.
    """
    cfg = replace(EIPO, reward_scale=0.02)
    for heads in (1, 2):
        params = handmade(np.zeros((3, heads)), np.zeros((2, 1)), np.zeros((3, 1)))
        pi = learner_of(params, lam=1 / 200)
        tau, log = roll(Probe(one, cost=lambda x, t, a: -126 + 0 * x), pi)
        assert (tau.reward == 1).all() and (tau.cost == -126).all() and log["cost"] == -126
        est = eipo.estimate(pi, tau, cfg)
        for found, expected in ((est.target, [0.02, -0.0126]), (est.advantage, [0.02, -2.52])):
            expected = np.tile(expected[:heads], (48, 1))
            assert found.reshape(48, heads) == pytest.approx(expected)


def test_the_log_leaves_out_what_is_not_known():
    assert eipo.mean(np.array([[np.nan, 1], [3, np.nan]])) == 2
    assert np.isnan(eipo.mean([np.nan]))


def test_algorithm1_line06_rollout_acts_with_fresh_noise_and_knows_its_density():
    """At mean 0 and deviation 1 the actions are the noise, 48 different numbers in 3 steps of 16
    robots, and log density is -a^2 / 2 - log(2 pi) / 2.
    """
    env = Probe(one)
    tau, _ = roll(env, known())
    a = tau.action[..., 0]
    assert np.unique(a).size == 48
    assert np.array_equal(tau.action, [done for _, done in env.diary])
    assert tau.log_prob == pytest.approx(-(a**2) / 2 - 0.91893853, abs=1e-6)


# ---- Algorithm 1 ----


def test_algorithm1_has_its_fourteen_lines_in_order():
    """The source of `eipo.eipo` is tagged with L1 to L14, each once."""
    tags = re.findall(r"# Alg\.1 L(\d+)", inspect.getsource(eipo.eipo))
    assert [int(tag) for tag in tags] == list(range(1, 15))


@pytest.fixture(scope="module")
def with_effort():
    """Three states of EIPO with their metrics, and the environments of pi and pi_prime."""
    env, env_prime = Probe(near_half, effort), Probe(near_half, effort)
    return run(env, env_prime), env, env_prime


def test_algorithm1_line10_pi_prime_never_sees_energy(with_effort):
    """Another cost makes another pi, but pi_prime has the same bits."""
    states, _, _ = with_effort
    free = run(Probe(near_half), Probe(near_half))
    assert trees_equal(free[2][0].pi_prime, states[2][0].pi_prime)
    assert not trees_equal(free[1][0].pi.params, states[1][0].pi.params)
    assert not trees_equal(states[1][0].pi_prime.params, states[2][0].pi_prime.params)


def test_algorithm1_line03_other_seed_other_start(monkeypatch):
    """For seeds 0 and 1, pi and pi_prime, networks and environments have four seeds each, and the
    exploration of a run has one.
    """
    monkeypatch.setattr(eipo, "init_learner", lambda rng, *_: int(rng.integers(2**62)))
    networks, envs, keys = [], [], []
    for seed in (0, 1):
        env, env_prime = Probe(one), Probe(one)
        state = eipo.init_state([env, env_prime], replace(EIPO, seed=seed))
        networks += [state.pi, state.pi_prime]
        envs += env.seeds + env_prime.seeds
        keys.append(state.key.tolist())
    assert len(set(networks)) == len(set(envs)) == len(envs) == 4
    assert keys[0] != keys[1]


def test_algorithm1_line06_a_rollout_goes_on_from_where_the_robots_are(with_effort):
    """In two iterations each environment is reset once, before the first."""
    _, env, env_prime = with_effort
    assert len(env.seeds) == len(env_prime.seeds) == 1


def test_algorithm1_line06_line07_each_policy_acts_in_its_own_environment(monkeypatch):
    """pi does 64 x and pi' -64 x, up to noise of deviation 1, so their signs say who acted."""
    monkeypatch.setattr(eipo, "ppo_update", lambda learner, *_: (learner, dict(kl=0.0)))
    pi, pi_prime = (
        learner_of(handmade(np.zeros((3, heads)), np.zeros((2, 1)), [[weight], [0.0], [0.0]]))
        for heads, weight in ((2, 64.0), (1, -64.0))
    )
    env, env_prime = Probe(one), Probe(one)
    for each in (env, env_prime):
        each.reset(0)
    state = State(0, jax.random.PRNGKey(0), pi, pi_prime, Dual(1.0, 0.0))
    next(eipo.eipo(env, env_prime, EIPO, state))
    for each, sign in ((env, 1), (env_prime, -1)):
        assert len(each.diary) == 8
        assert all((sign * obs[:, :1] * action > 0).all() for obs, action in each.diary)


def test_algorithm1_uses_no_key_twice(monkeypatch):
    """Two iterations have two rollouts and two updates each: eight keys."""
    keys = []
    for name, place in (("rollout", 2), ("ppo_update", 4)):

        def spy(*args, function=getattr(eipo, name), place=place):
            keys.append(tuple(args[place].tolist()))
            return function(*args)

        monkeypatch.setattr(eipo, name, spy)
    run(Probe(near_half, effort), Probe(near_half, effort))
    assert len(keys) == len(set(keys)) == 8


def test_algorithm1_ppo_has_neither_pi_prime_nor_alpha(with_effort):
    """Its metrics are those of EIPO, but for alpha, the gap and what is of pi_prime."""
    (_, _), (_, _), (end, metrics) = run(Probe(near_half), None)
    assert end.pi_prime is end.dual is None
    of_eipo = with_effort[0][2][1]
    own = {x for x in of_eipo if x not in ("alpha", "gap") and not x.startswith("prime_")}
    assert set(metrics) == own


def test_algorithm1_line14_ends_after_its_iterations():
    """From 2, 1 and 0 iterations before the last, EIPO and PPO go through as many."""
    env, env_prime = Probe(one), Probe(one)
    start, end = eipo.init_state([env, env_prime], EIPO), EIPO.iterations
    for left in range(3):
        state = start._replace(iteration=end - left)
        for steps in (eipo.eipo(env, env_prime, EIPO, state), eipo.ppo(env, EIPO, state)):
            assert [state.iteration for state, _ in steps] == list(range(end - left + 1, end + 1))


def test_algorithm1_without_a_state_begins_anew(with_effort):
    """As from `init_state`, bit by bit."""
    states, _, _ = with_effort
    state, _ = next(eipo.eipo(Probe(near_half, effort), Probe(near_half, effort), EIPO))
    assert trees_equal(state, states[1][0])
    state, _ = next(eipo.ppo(Probe(near_half, effort), EIPO))
    assert trees_equal(state, run(Probe(near_half, effort), None)[1][0])


def test_eq02_algorithm1_line04_eipo_starts_as_ppo(with_effort):
    """D6. alpha_0 = 1 / lam, so the first update of pi is PPO's at that lam, bit by bit. If alpha
    is held, all are.
    """
    states, _, _ = with_effort
    ppo = run(Probe(near_half, effort), None)
    assert trees_equal(ppo[1][0].pi, states[1][0].pi)
    assert not trees_equal(ppo[2][0].pi, states[2][0].pi)
    assert ppo[1][1]["task_share"] == pytest.approx(states[1][1]["task_share"])
    held = run(Probe(near_half, effort), Probe(near_half, effort), replace(EIPO, lr_alpha=0.0))
    assert trees_equal(ppo[2][0].pi, held[2][0].pi)


def test_eq10_algorithm1_line04_alpha_at_the_start(monkeypatch):
    """1 / lam for each lambda of Eq. (10) but 0."""
    monkeypatch.setattr(eipo, "init_learner", lambda *_: None)

    def start(**changes):
        return eipo.init_state([Probe(one), Probe(one)], replace(EIPO, **changes)).dual

    expected = [10_000, 5_000, 2_000, 1_000, 500, 200, 100, 50]
    assert [start(lam=lam).alpha for lam in LAMBDAS[1:]] == pytest.approx(expected)
    assert start(lam=0.25) == Dual(4, 0)


@pytest.mark.parametrize("algo, lam", [("eipo", 4.0), ("ppo", 4.0), ("ppo", 0.0)])
def test_algorithm1_learns_in_every_branch(algo, lam):
    """One iteration moves every network and skips no minibatch, also at lam = 0."""
    env, env_prime = Probe(near_half, effort), Probe(near_half, effort)
    prime = dict(eipo=env_prime, ppo=None)[algo]
    (start, _), (end, log) = run(env, prime, replace(EIPO, lam=lam), 1)
    names = dict(pi="skipped", pi_prime="prime_skipped") if prime else dict(pi="skipped")
    for name, skipped in names.items():
        before, after = getattr(start, name).params, getattr(end, name).params
        assert jax.tree.all(jax.tree.map(lambda a, b: bool((a != b).any()), before, after))
        assert log[skipped] == 0


def test_eq04_algorithm1_line08_line09_line10_line11_what_each_policy_learns_from(monkeypatch):
    """Episodes of two steps end as by a fall, and pay r = 1 and f = 4 a step. Every output of
    both critics is V = 3 t; gamma = 1/2, gae_lambda = 0, alpha = 2:

                t = 0                    t = 1
    target r    1 + 3/2 = 5/2            1
    target f    4 + 3/2 = 11/2           4
    A_r         5/2 - 0 = 5/2            1 - 3 = -2
    A_f         11/2 - 0 = 11/2          4 - 3 = 1
    pi          2 * 5/2 - 11/2 = -1/2    2 (-2) - 1 = -5

    pi' learns from A_r alone, and line 11 changes pi' (D1). Nothing is normalised before it is
    mixed (D33).
    """
    seen = []

    def spy(learner, tau, target, advantage, *_):
        seen.append((len(learner.heads), target[:2, 0].tolist(), advantage[:2, 0].tolist()))
        return learner, dict(kl=0.0)

    monkeypatch.setattr(eipo, "ppo_update", spy)
    critic, others = np.array([[-1.0], [2.0], [1.0]]), (np.zeros((2, 1)), np.zeros((3, 1)))
    pi, pi_prime = (learner_of(handmade(np.tile(critic, heads), *others)) for heads in (2, 1))
    envs = [Probe(one, lambda x, t, a: 4 + 0 * x, length=2) for _ in range(2)]
    for env in envs:
        env.reset(0)
    state = State(0, jax.random.PRNGKey(0), pi, pi_prime, Dual(2.0, 0.0))
    after, _ = next(eipo.eipo(*envs, replace(EIPO, gae_lambda=0.0), state))
    assert seen == [(2, [[2.5, 5.5], [1.0, 4.0]], [-0.5, -5.0]), (1, [[2.5], [1.0]], [2.5, -2.0])]
    assert after.pi is pi and after.pi_prime is pi_prime  # D1


def test_algorithm1_line12_the_gap_is_of_the_policies_before_their_updates(monkeypatch):
    """Episodes are cut by time after one step, and pay 1 and 3. With V = 0 the gap is 1 - 3 = -2.
    Lines 9 and 11 give the policies other critics, which would value what follows.
    """

    def flat_critic(heads, weight):
        weights = np.full((3, heads), weight)
        return learner_of(handmade(weights, np.zeros((2, 1)), np.zeros((3, 1))))

    def update(learner, *_):
        heads = len(learner.heads)
        return flat_critic(heads, 64.0 * heads), dict(kl=0.0)

    monkeypatch.setattr(eipo, "ppo_update", update)
    env, env_prime = Probe(one, truncates=True), Probe(lambda x, t, a: 3 + 0 * x, truncates=True)
    env.reset(0)
    env_prime.reset(1)
    policies = flat_critic(2, 0.0), flat_critic(1, 0.0)
    state = State(0, jax.random.PRNGKey(0), *policies, Dual(1.0, 0.0))
    _, metrics = next(eipo.eipo(env, env_prime, EIPO, state))
    assert metrics["gap"] == -2


def test_algorithm1_line12_line13_gets_the_gap_and_line_9_its_alpha(with_effort, monkeypatch):
    """At a scale of 1/2 (D10) pi earns 1 a step and pi_prime 3, in episodes of one step: J = 1 and
    J' = 3, so the gap is -2. What line 13 returns is what the next line 9 uses.
    """
    gaps = []

    def jump(dual, gap, cfg):
        gaps.append(gap)
        return Dual(64.0, 7.0)

    monkeypatch.setattr(eipo, "step_alpha", jump)
    two, six = Probe(lambda x, t, a: 2 + 0 * x), Probe(lambda x, t, a: 6 + 0 * x)
    states = run(two, six, replace(EIPO, reward_scale=0.5))
    assert gaps == [metrics["gap"] for _, metrics in states[1:]] == pytest.approx([-2, -2])
    for _, metrics in states[1:]:
        assert (metrics["J"], metrics["prime_J"]) == pytest.approx((1, 3))
        assert metrics["lr"] == metrics["prime_lr"] == pytest.approx(EIPO.lr)
        assert (metrics["reward"], metrics["prime_reward"]) == (2, 6)
    assert [state.dual for state, _ in states] == [Dual(0.25, 0), Dual(64, 7), Dual(64, 7)]
    assert [metrics["alpha"] for _, metrics in states[1:]] == [0.25, 64]
    jumped = run(Probe(near_half, effort), Probe(near_half, effort))
    assert trees_equal(jumped[1][0].pi, with_effort[0][1][0].pi)
    assert not trees_equal(jumped[2][0].pi, with_effort[0][2][0].pi)
    assert jumped[2][1]["task_share"] > 2 * with_effort[0][2][1]["task_share"]


@pytest.mark.parametrize("algo", ["eipo", "ppo"])
def test_algorithm1_learns_nothing_from_what_is_not_finite(algo):
    """D36. Every reward is NaN: 5 iterations x 4 epochs x 2 minibatches are skipped, as many as
    there are, and alpha stays where it is.
    """
    env, env_prime = Probe(lambda x, t, a: np.nan * x, effort), Probe(near_half, effort)
    (start, _), *_, (end, log) = run(env, env_prime if algo == "eipo" else None, iterations=5)
    assert log["skipped"] == 5 * 4 * 2 and log.get("prime_skipped", 0) == 0  # pi' learns on
    assert trees_equal(start.pi.params, end.pi.params)
    assert start.dual == end.dual == (Dual(0.25, 0) if algo == "eipo" else None)


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


def means(pi):
    """Mean actions where x is -1 and where it is 1."""
    return np.asarray(policy(pi, at(0)[0])[0])[:, 0]


def near(x):
    return pytest.approx(np.broadcast_to(x, 2), abs=0.1)


def test_probe_1_constant_reward():
    """One step, reward 1 and cost 1/2 with lam = 4: V = (1, 4 / 2)."""
    state = learn(Probe(one, cost=lambda x, t, a: 0.5 + 0 * x), 60)
    assert values(state)[:, 0] == near(1)
    assert values(state)[:, 1] == near(2)


@pytest.fixture(scope="module")
def after_two_steps():
    """Episodes of two steps that pay 2 x at their end."""
    return learn(Probe(lambda x, t, a: 2 * x * t, length=2), 100)


def test_probe_2_discounting(after_two_steps):
    """V = -2 and 2 at the second step, and gamma = 1/2 of it at the first."""
    assert values(after_two_steps, t=1)[:, 0] == near([-2, 2])
    assert values(after_two_steps, t=0)[:, 0] == near([-1, 1])


def test_estimator_learns_what_is_privileged(after_two_steps):
    """It is x + t, and an observation shows x and t."""
    for t in (0, 1):
        obs, privileged = at(t)
        estimate = policy(after_two_steps.pi, obs)[2]
        assert np.ravel(estimate) == near(np.ravel(privileged))


def test_probe_3_a_time_limit_is_not_the_end():
    """Reward x at every step, for ever: V = x / (1 - 1/2) = 2 x.

    If it ended as by a fall, V would be x. From the next episode's x it would be x as well.
    """
    assert values(learn(Probe(lambda x, t, a: x, truncates=True), 100))[:, 0] == near([-2, 2])


@pytest.mark.parametrize(
    "reward, cost, best",
    [
        (near_half, None, [0.5, 0.5]),
        (lambda x, t, a: -((a - x / 2) ** 2), None, [-0.5, 0.5]),
        (near_half, effort, [0.1, 0.1]),
    ],
    ids=["4: 1/2 wherever one is", "5: x / 2", "6: -(a - 1/2)^2 - 4 a^2 is best at 1/10"],
)
def test_probes_4_to_6_the_best_action(reward, cost, best):
    """PPO finds it: alone, for an observation, and where it trades the task for energy."""
    assert means(learn(Probe(reward, cost) if cost else Probe(reward), 60).pi) == near(best)


def test_eq03_eipo_puts_the_task_first():
    """-alpha (a - 1/2)^2 - a^2 is greatest at a = alpha / (2 (1 + alpha)), which is 1/10 at alpha =
    1/4, 0.4 at 4, and 1/2 in the limit.

    alpha starts at 1/4, as in probe 6. pi_prime, at 1/2, shows that the task pays more, so alpha
    rises, and pi follows.
    """
    state = learn(Probe(near_half, effort), 100, Probe(near_half, effort))
    assert state.dual.alpha > 4
    assert (means(state.pi) > 0.35).all()
    assert means(state.pi_prime) == near(0.5)
