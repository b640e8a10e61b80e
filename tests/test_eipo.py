"""Equations (1)-(4) and (10), and the pieces of Algorithm 1: GAE, PPO, the networks, the step on alpha.

The numbers are dyadic, so that floating-point arithmetic is exact and `==` is meant. Each docstring does the sum.
"""

import ast
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

import eipo
import networks
from eipo import Config, Dual, Estimate, Rollout
from networks import Layer

# gamma = gae_lambda = 1/2. The settings of test_algorithm1.py's PPO: JAX compiles once for both files
CONFIG = Config(
    algo="ppo", lam=4.0, num_envs=32, num_steps=8, num_epochs=4, num_minibatches=2, lr=0.01, target_kl=0.0,
    gamma=0.5, gae_lambda=0.5, clip_eps=0.2, ent_coef=0.01, max_grad_norm=1.0, reward_scale=1.0, lr_alpha=1.0,
    momentum_alpha=0.9, clip_alpha=1.0, dampening_alpha=0.0, log_std=0.0, hidden=(32,),
    hidden_estimator=(8,),
)  # fmt: skip
PAPER = replace(CONFIG, lr_alpha=0.01, clip_alpha=1.0, momentum_alpha=0.99)  # line 13 as in Section IV-C.c
KEY = jax.random.key(0)
gae = jax.jit(eipo.gae)
ones, never = np.ones(3), np.zeros(3, bool)
at_1 = np.array([False, True, False])


def dyadic(rng, *shape):
    """Random multiples of 1/8 between -1 and 1: their sums and products are exact in float32."""
    return (rng.integers(-8, 9, shape) / 8).astype(np.float32)


def trees_equal(a, b):
    return jax.tree.all(jax.tree.map(np.array_equal, a, b))


# ---- Equations (1)-(4), (10) ----


def test_eq01_discounted_return():
    """gamma = 1/2, r = (1, 2, 4), nothing after: J = 1 + 2/2 + 4/4 = 3. GAE with V = 0, gae_lambda = 1 is that sum."""
    ends = np.array([False, False, True])
    assert gae(np.array([1.0, 2.0, 4.0]), 0 * ones, 0 * ones, ends, never, 0.5, 1.0)[0] == 3


def test_eq02_lambda_objective():
    """A_r = (1, 2, -3), A_f = (4, -8, 16), lam = 1/4: A_r - lam A_f = (1 - 1, 2 + 2, -3 - 4) = (0, 4, -7).

    Stream 2 is stored as lam f, so its advantage is lam A_f = (1, -2, 4).
    """
    advantage = np.array([[1.0, 1.0], [2.0, -2.0], [-3.0, 4.0]])
    assert eipo.mix(advantage, alpha=4.0, lam=0.25).tolist() == [0, 4, -7]


def test_eq02_without_energy_is_the_task_alone():
    """lam = 0 is alpha = 1 / lam = infinite: what is left is A_r, and no 0 * inf = nan."""
    assert eipo.mix(np.array([[1.0, 64.0], [2.0, 64.0]]), alpha=np.inf, lam=0.0).tolist() == [1, 2]


def test_eq04_lambda_is_one_over_alpha():
    """D6. At alpha = 1 / lam = 4, Eq. (4)'s 4 A_r - A_f is 4 times Eq. (2)'s A_r - A_f / 4: equal once normalised."""
    A_r, A_f = dyadic(np.random.default_rng(0), 2, 64)
    eq2 = eipo.mix(np.stack([A_r, 0.25 * A_f], -1), alpha=4.0, lam=0.25)
    eq4 = 4 * A_r - A_f
    assert np.array_equal(eq2 * 4, eq4)
    assert np.array_equal((eq2 - eq2.mean()) / eq2.std(), (eq4 - eq4.mean()) / eq4.std())


def test_eq04_alpha_weighs_the_task():
    """alpha = 32 with lam = 1/4: alpha A_r - A_f for A_r = 1, A_f = 4 is 32 - 4 = 28, times lam: 7. Not 32 / 4 - 4."""
    assert eipo.mix(np.array([1.0, 0.25 * 4]), alpha=32.0, lam=0.25) == 7


def test_eq04_gradient_in_alpha():
    """D2. F = 10, J = 3, J' = 5, alpha = 2: L = 10 - 2 (3 - 5) = 14, dL/dalpha = -(3 - 5) = +2: ascent raises alpha.

    With eta_alpha = 1/2, no momentum and a wide clip, line 13 must go to 2 + 2/2 = 3; the printed J - J' goes to 1.
    """

    def lagrangian(alpha, F=10.0, J=3.0, J_prime=5.0):
        return F - alpha * (J - J_prime)

    assert lagrangian(2.0) == 14
    assert jax.grad(lagrangian)(2.0) == 2
    plain = replace(PAPER, lr_alpha=0.5, momentum_alpha=0.0, clip_alpha=4.0)
    assert eipo.step_alpha(Dual(2.0, 0.0), 3.0 - 5.0, plain) == Dual(3.0, 2.0)


SWEEP = (0.0, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2)


@pytest.mark.parametrize("lam", SWEEP)
def test_eq10_ppo_takes_every_lambda(lam):
    eipo.check(Config(algo="ppo", lam=lam))


@pytest.mark.parametrize("lam", SWEEP[1:])
def test_eq10_eipo_starts_from_every_positive_lambda(lam):
    eipo.check(Config(algo="eipo", lam=lam))


# ---- GAE and the estimates of L8, L10, L12 ----


def test_gae_plain():
    """gamma = gae_lambda = 1/2, r = V = 1: every delta is 1 + 1/2 - 1 = 1/2; summed back with 1/4:

    1/2,  1/2 + 1/8 = 0.625,  1/2 + 0.625 / 4 = 0.65625
    """
    assert gae(ones, ones, ones, never, never, 0.5, 0.5).tolist() == [0.65625, 0.625, 0.5]


def test_gae_terminated():
    """Nothing comes after t = 1, whatever V says: delta_1 = 1 + 0 - 1 = 0, and t = 0 gets 1/2 + 0 / 4."""
    assert gae(ones, ones, np.array([1.0, 64.0, 1.0]), at_1, never, 0.5, 0.5).tolist() == [0.5, 0, 0.5]


def test_gae_truncated():
    """Cut at 1, where V(final_obs) = 3: delta_1 = 1 + 3/2 - 1 = 1.5; t = 2 is another episode; t = 0: 1/2 + 1.5/4."""
    assert gae(ones, ones, np.array([1.0, 3.0, 1.0]), never, at_1, 0.5, 0.5).tolist() == [0.875, 1.5, 0.5]


def test_gae_is_linear():
    """alpha gae(r) - gae(f) == gae(alpha r - f), bit by bit: mixing advantages is mixing rewards, and can wait."""
    rng = np.random.default_rng(1)
    r, f = dyadic(rng, 2, 3, 4, 32)  # (reward, value, next value), T, N
    terminated, truncated = rng.random((2, 4, 32)) < 0.2

    def of(streams):
        return gae(*streams, terminated, truncated & ~terminated, 0.5, 0.5)

    assert np.array_equal(8 * of(r) - of(f), of(8 * r - f))


def plain(weights, bias):
    """A layer without odd coordinates: that of a plain MLP."""
    return Layer(weights, jnp.zeros((0, 0)), bias)


def handmade(critic=((1.0,), (0.0,)), estimator=((0.0,),), actor=((0.0,), (0.0,))):
    """Networks without hidden layers and biases, for widths (1, 1, 1): the weights of their inputs, one row each."""
    actor, critic, estimator = (
        [plain(jnp.array(weights), jnp.zeros(len(weights[0])))] for weights in (actor, critic, estimator)
    )
    return dict(actor=dict(layers=actor, log_std=jnp.zeros(1)), critic=critic, estimator=estimator)


def rollout_of(obs, reward, terminated, truncated, final_obs, after):
    """A rollout of one environment: lists of T numbers, one of K streams; final_obs where truncated, in order."""
    obs, zero, reward = (np.reshape(np.float32(x), (-1, 1, 1)) for x in (obs, np.zeros(len(obs)), reward))
    terminated, truncated = np.reshape(terminated, (-1, 1)), np.reshape(truncated, (-1, 1))
    after, final = (np.reshape(np.float32(x), (-1, 1)) for x in (after, final_obs))
    return Rollout(obs, zero, zero, reward, terminated, truncated, (after, 0 * after), (final, 0 * final))


def test_gae_bootstraps_from_the_final_observation():
    """The critic says V(obs) = obs. Observations 1, 1 | 64 (a new episode, after a time limit), then 5.

    t = 2: 1 + 5/2 - 64 = -60.5     the end of the rollout is no end of the episode: V(after) = 5
    t = 1: 1 + 3/2 - 1 = 1.5        V(final_obs) = 3, not the 64 of the reset observation
    t = 0: 1 + 1/2 - 1 + 1.5/4 = 0.875
    Targets add V: 1.875, 2.5, 3.5. J is their mean, 7.875 / 3 = 2.625.
    """
    tau = rollout_of([1, 1, 64], [1, 1, 1], [False] * 3, [False, True, False], [3], after=5)
    estimate = eipo.estimate(handmade(), tau, CONFIG)
    assert estimate.advantage.ravel().tolist() == [0.875, 1.5, -60.5]
    assert estimate.target.ravel().tolist() == [1.875, 2.5, 3.5]
    assert eipo.estimate_J(estimate) == 2.625


def test_gae_ends_where_an_episode_terminated():
    """Fallen at t = 1 and at the last step: only the reward counts there. 1 - 1 = 0, 1 - 64 = -63; t = 0: 1/2 + 0/4."""
    tau = rollout_of([1, 1, 64], [1, 1, 1], [False, True, True], [False] * 3, [], after=5)
    assert eipo.estimate(handmade(), tau, CONFIG).advantage.ravel().tolist() == [0.5, 0, -63]


def test_estimate_J_is_not_of_normalised_advantages():
    """D8. One-step episodes, V = 0: rewards (0, 2, 0, 2) give J = 1, rewards (2, 4, 2, 4) give J = 3: the gap is -2.

    Their normalised advantages are the same (-1, 1, -1, 1), of mean 0: alpha could never tell them apart.
    """
    blind = handmade(critic=((0.0,), (0.0,)))
    ends = dict(obs=[0] * 4, terminated=[True] * 4, truncated=[False] * 4, final_obs=[], after=0)
    low, high = (
        eipo.estimate(blind, rollout_of(reward=reward, **ends), CONFIG) for reward in ([0, 2, 0, 2], [2, 4, 2, 4])
    )
    assert low.advantage.ravel().tolist() == [0, 2, 0, 2]
    assert (eipo.estimate_J(low), eipo.estimate_J(high)) == (1, 3)
    normalised = [(e.advantage - e.advantage.mean()) / e.advantage.std() for e in (low, high)]
    assert trees_equal(*normalised)
    assert normalised[0].mean() == 0


def test_estimate_J_is_the_task_alone():
    """Targets (1, 64) and (3, 64) of the streams (task, cost): J = (1 + 3) / 2 = 2, the cost is not asked."""
    target = np.array([[[1.0, 64.0]], [[3.0, 64.0]]])
    assert eipo.estimate_J(Estimate(None, target, None)) == 2


# ---- networks ----


def test_networks_elu_between_the_layers_only():
    """One unit: ELU(2) = 2, ELU(-1) = 1/e - 1; a lone layer stays linear: 3 (-1) + 1 = -2."""
    unit, none = plain(jnp.ones((1, 1)), jnp.zeros(1)), jnp.zeros((2, 0))
    hidden, _ = networks.mlp([unit, unit], jnp.array([[2.0], [-1.0]]), none)
    assert hidden.ravel().tolist() == pytest.approx([2, -0.63212056])
    assert networks.mlp([plain(3 * unit.even, unit.bias + 1)], jnp.array([-1.0]), none[0])[0].tolist() == [-2]


def test_networks_init_range():
    """Uniform in +- 1 / sqrt(fan-in), which a product has for itself: 16 even inputs, +- 1/4; 4 odd ones, +- 1/2.

    17 * 64 and 4 * 256 draws come within 1 % of both ends.
    """
    first, last = networks.init_mlp(KEY, [(16, 4), (64, 256), (4, 0)])
    assert [x.shape for x in (*first, *last)] == [(16, 64), (4, 256), (64,), (64, 4), (256, 0), (4,)]
    for x, end in ((np.concatenate([first.even, first.bias[None]]), 0.25), (first.odd, 0.5)):
        assert -end <= x.min() < -0.99 * end and 0.99 * end < x.max() <= end and abs(x.mean()) < 0.08 * end
    assert abs(last.even).max() <= 0.125


def test_networks_who_sees_what():
    """The actor sees its estimate 2 obs: obs + 8 (2 obs) = 17 obs. The critic sees the truth: obs + 8 privileged.

    obs = 3, privileged = 5: mean 51, estimate 6, value 3 + 40 = 43.
    """
    params = handmade(critic=((1.0,), (8.0,)), estimator=((2.0,),), actor=((1.0,), (8.0,)))
    mean, std, estimate = networks.policy(params, jnp.array([3.0]))
    assert (mean.tolist(), std.tolist(), estimate.tolist()) == ([51], [1], [6])
    assert networks.value(params, jnp.array([3.0]), jnp.array([5.0])).tolist() == [43]


def test_networks_noise():
    """log_std = -1: the noise is exp(-1), the same for every observation."""
    params = handmade()
    params["actor"]["log_std"] = jnp.array([-1.0])
    assert networks.policy(params, jnp.ones((2, 1)))[1] == pytest.approx(np.full((2, 1), 0.36787944))


def test_networks_log_prob():
    """Two independent normals at z = (0, 1), std = (1, 2): -0 - 1/2 - log 1 - log 2 - log(2 pi) = -3.0310242."""
    mean, std, action = jnp.array([3.0, 1.0]), jnp.array([1.0, 2.0]), jnp.array([3.0, 3.0])
    assert float(networks.log_prob(mean, std, action)) == pytest.approx(-3.0310242)


# ---- PPO: L9, L11 ----


@pytest.mark.parametrize(
    ("ratio", "advantage", "expected"), [(1.5, 1, 1.25), (0.5, 1, 0.5), (1.5, -1, -1.5), (0.5, -1, -0.75)]
)
def test_ppo_clip_four_cases(ratio, advantage, expected):
    """eps = 1/4: the ratio counts up to 1.25 if the action was good, down to 0.75 if it was bad; never for free."""
    assert eipo.clipped_surrogate(ratio, advantage, 0.25) == expected


def test_ppo_loss():
    """The action was likelier by 1.5 than when it was taken, and good: the surrogate counts 1 + 0.2.

    obs = V = 1, target 3: (1 - 3)^2 = 4. The estimate is 0, the truth 1/2: 1/4. Entropy at std 1: 1.4189385.
    Loss -1.2 - 0.01 * 1.4189385 + 4 + 1/4 = 3.0358106; KL 1.5 - 1 - log 1.5 = 0.0945349.
    """
    then = -0.91893853 - np.log(1.5)  # log density of a normal at its mean, less log 1.5
    batch = dict(obs=1.0, privileged=0.5, action=0.0, target=3.0)
    batch = {name: jnp.full((4, 1), x) for name, x in batch.items()} | dict(log_prob=jnp.full(4, then))
    loss, log = eipo.ppo_loss(handmade(), batch | dict(advantage=jnp.ones(4)), CONFIG)
    assert float(loss) == pytest.approx(3.0358106, rel=1e-6)
    assert float(log["kl"]) == pytest.approx(0.0945349, rel=1e-5)


def ppo(**changes):
    """One ppo_update of a new learner, always the same but for `changes`. returns params, log, params before."""
    rng = np.random.default_rng(2)
    cfg = changes.get("cfg", CONFIG)
    learner = eipo.init_learner(KEY, ((2, 0), (1, 0), (1, 0)), 2, CONFIG)
    learner = learner._replace(lr=jnp.float32(changes.get("lr", cfg.lr)))
    learner.params["actor"]["log_std"] += changes.get("log_std", 0.0)
    obs, privileged, action, target = (dyadic(rng, 8, 16, width) for width in (2, 1, 1, 2))
    never = np.zeros((8, 16), bool)
    tau = Rollout(
        obs, privileged, action, target, never, never, (obs[0], privileged[0]), (obs[0, :0], privileged[0, :0])
    )
    estimate = eipo.estimate(learner.params, tau, CONFIG)._replace(target=changes.get("target", target))
    advantage = changes.get("advantage", dyadic(rng, 8, 16))
    before = jax.tree.map(np.array, learner.params)
    learner, log = eipo.ppo_update(learner, tau, estimate, advantage, changes.get("key", KEY), cfg)
    return learner.params, log | dict(next_lr=learner.lr), before


@pytest.mark.parametrize(("log_std", "kept"), [(-10.0, -4.0), (10.0, 1.0)])
def test_ppo_keeps_the_noise_in_its_range(log_std, kept):
    """After the step, not in the forward pass: there it would stop the gradient that leads back."""
    assert ppo(log_std=log_std)[0]["actor"]["log_std"].tolist() == pytest.approx([kept], abs=0.2)
    assert eipo.LOG_STD_RANGE[0] <= ppo(log_std=log_std)[0]["actor"]["log_std"][0] <= eipo.LOG_STD_RANGE[1]


def test_ppo_normalises_the_advantage():
    """4 A + 1 has the mean 4 m + 1 and the deviation 4 s: normalised it is A again, so the update is the same one."""
    advantage = dyadic(np.random.default_rng(3), 8, 16)
    assert trees_equal(ppo(advantage=advantage)[0], ppo(advantage=4 * advantage + 1)[0])
    assert not trees_equal(ppo(advantage=advantage)[0], ppo(advantage=-advantage)[0])


def test_ppo_shuffles_the_minibatches():
    """Another key draws other minibatches from the same data; the same key draws the same ones."""
    assert trees_equal(ppo()[0], ppo()[0])
    assert not trees_equal(ppo()[0], ppo(key=jax.random.key(1))[0])


def test_ppo_trains_the_estimator_by_its_own_error_alone():
    """D19: other advantages train another actor; the estimator, and the critic, do not notice."""
    one, other = (ppo(advantage=dyadic(np.random.default_rng(seed), 8, 16))[0] for seed in (3, 4))
    assert not trees_equal(one["actor"], other["actor"])
    assert trees_equal(one["estimator"], other["estimator"])
    assert trees_equal(one["critic"], other["critic"])


def test_ppo_entropy_bonus_widens_the_noise():
    """Equal advantages normalise to 0, so that the bonus alone moves log_std: up, from 0."""
    assert ppo(advantage=np.ones((8, 16), np.float32))[0]["actor"]["log_std"] > 0


def test_ppo_clips_gradients_per_network():
    """Targets of a million want a huge step of the critic; the other two networks do not notice."""
    usual, huge = ppo()[0], ppo(target=np.full((8, 16, 2), 1e6, np.float32))[0]
    assert trees_equal([usual["actor"], usual["estimator"]], [huge["actor"], huge["estimator"]])
    assert not trees_equal(usual["critic"], huge["critic"])


def test_ppo_clips_the_norm_at_max_grad_norm():
    """Gradients (3, 4) of norm 5 and (3/8, 4/8) of norm 5/8: clipped to (0.6, 0.8), and untouched.

    Adam's mean starts at 1/10 of that, and its first direction is 1 up every slope.
    """
    gradient = dict(actor=jnp.array([3.0, 4.0]), critic=jnp.array([0.375, 0.5]), estimator=jnp.zeros(2))
    state = eipo.optimizer(CONFIG).init(gradient)
    step, state = eipo.optimizer(CONFIG).update(gradient, state)
    mean = optax.tree_utils.tree_get(state, "mu")
    assert mean["actor"].tolist() == pytest.approx([0.06, 0.08])
    assert mean["critic"].tolist() == pytest.approx([0.0375, 0.05])
    assert step["actor"].tolist() == pytest.approx([1.0, 1.0], rel=1e-4)


@pytest.mark.parametrize("kl, lr", [(0.0625, 0.0002), (0.03, 0.0003), (0.015, 0.0003), (0.0078125, 0.00045)])
def test_lr_follows_the_kl_of_an_iteration(kl, lr):
    """Target 1/64: beyond twice that 0.0003 / 1.5 = 0.0002, below half of it 0.0003 * 1.5 = 0.00045, between no change.

    0.0078125 = 1/128 is half the target, not below: a hair less is.
    """
    cfg = replace(CONFIG, target_kl=1 / 64)
    kl = kl - 1e-6 if kl < 0.01 else kl
    assert float(eipo.adapt_lr(jnp.float32(0.0003), kl, cfg)) == pytest.approx(lr)


def test_lr_stays_in_its_range_and_is_fixed_without_a_target():
    """[1e-5, 1e-3]: the lab's floor, the paper's step size."""
    cfg = replace(CONFIG, target_kl=1 / 64)
    assert float(eipo.adapt_lr(jnp.float32(1e-5), 9.0, cfg)) == pytest.approx(1e-5)
    assert float(eipo.adapt_lr(jnp.float32(1e-3), 0.0, cfg)) == pytest.approx(1e-3)
    assert float(eipo.adapt_lr(jnp.float32(0.25), 9.0, CONFIG)) == 0.25


def test_lr_is_the_learner_s_and_adapts_after_the_update():
    """lr = 0 goes nowhere. lr = 1e-5 moves the policy by hardly any KL: the next iteration has 1.5e-5."""
    params, log, before = ppo(lr=0.0)
    assert trees_equal(params, before)
    assert log["next_lr"] == 0
    log = ppo(lr=1e-5, cfg=replace(CONFIG, target_kl=1 / 64))[1]
    assert (float(log["lr"]), float(log["next_lr"])) == pytest.approx((1e-5, 1.5e-5))


def test_ppo_skips_a_minibatch_that_is_not_finite():
    """One nan among the samples is in one of the two minibatches of every epoch: of 4 x 2 steps, 4 are skipped."""
    target = np.zeros((8, 16, 2), np.float32)
    target[1, 2, 0] = np.nan
    params, log, before = ppo(target=target)
    assert log["skipped"] == 4
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(params))
    assert not trees_equal(params["critic"], before["critic"])


def test_ppo_keeps_the_parameters_when_nothing_is_finite():
    """All 4 x 2 steps are skipped: what is left is what was there, bit by bit."""
    params, log, before = ppo(target=np.full((8, 16, 2), np.inf, np.float32))
    assert log["skipped"] == 8
    assert trees_equal(params, before)
    assert ppo()[1]["skipped"] == 0


# ---- L13: the multiplier ----


def test_alpha_momentum():
    """alpha = 200, eta 0.01, clip 1, momentum 0.99; pi lags by 2, lags by 1, leads by 1/2:

    gap -2:  g = clip(2) = 1   v = 1                        alpha = 200.01
    gap -1:  g = 1             v = 0.99 + 1 = 1.99          alpha = 200.01 + 0.0199 = 200.0299
    gap 1/2: g = -1/2          v = 1.9701 - 0.5 = 1.4701    alpha = 200.0299 + 0.014701 = 200.044601
    """
    dual, alphas = Dual(200.0, 0.0), []
    for gap in (-2, -1, 0.5):
        dual = eipo.step_alpha(dual, gap, PAPER)
        alphas.append(dual.alpha)
    assert alphas == pytest.approx([200.01, 200.0299, 200.044601], rel=1e-12)


def test_alpha_gradient_is_clipped_both_ways():
    """However far ahead or behind, the gradient is 1: v = 0.99 * 0 -+ 1."""
    assert eipo.step_alpha(Dual(200.0, 0.0), 64.0, PAPER).velocity == -1
    assert eipo.step_alpha(Dual(200.0, 0.0), -64.0, PAPER).velocity == 1


def test_alpha_stays_above_zero_and_loses_its_momentum_there():
    """0.005 - 0.01 < 0: alpha = 0, v = 0. What follows is a fresh start: 0 + 0.01 * 1, not 0.01 * (1 - 0.99)."""
    dual = eipo.step_alpha(Dual(0.005, 0.0), 1.0, PAPER)
    assert dual == Dual(0.0, 0.0)
    assert eipo.step_alpha(dual, -1.0, PAPER) == Dual(0.01, 1.0)


def test_alpha_stays_where_it_is_when_the_gap_is_not_finite():
    """nan > 0 is false: without care one bad reward would switch the task off."""
    for gap in (np.nan, np.inf, -np.inf):
        assert eipo.step_alpha(Dual(200.0, 1.0), gap, PAPER) == Dual(200.0, 1.0)


def test_alpha_dampening_turns_momentum_into_an_average():
    """dampening 0.99: v = 0.01 * 1, alpha = 200 + 0.01 * 0.01; a constant gradient of 1 never gets v above 1."""
    cfg = replace(PAPER, dampening_alpha=0.99)
    dual = eipo.step_alpha(Dual(200.0, 0.0), -1.0, cfg)
    assert dual == pytest.approx(Dual(200.0001, 0.01), rel=1e-12)
    for _ in range(2000):
        dual = eipo.step_alpha(dual, -1.0, cfg)
    assert dual.velocity == pytest.approx(1)


def test_alpha_moves_by_one_per_iteration_in_the_limit():
    """v -> 1 / (1 - 0.99) = 100, so that alpha gains at most 0.01 * 100 = 1 per iteration, be the gap ever so wide."""
    duals = [Dual(200.0, 0.0)]
    for _ in range(2000):
        duals.append(eipo.step_alpha(duals[-1], -1000.0, PAPER))
    gains = np.diff([dual.alpha for dual in duals])
    assert gains.max() < 1.000001
    assert gains[-1] == pytest.approx(1)


# ---- settings and imports ----


@pytest.mark.parametrize(
    "bad",
    [
        dict(algo="sac"), dict(lam=-0.1), dict(lam=float("nan")), dict(lr=float("inf")), dict(lr=-1.0),
        dict(gamma=1.5), dict(momentum_alpha=2.0), dict(target_kl=-1.0), dict(lr=0.01), dict(clip_eps=-0.2),
        dict(lr_alpha=-1.0), dict(alpha0=-1.0), dict(lam=0.0), dict(num_envs=3), dict(num_envs=0), dict(num_steps=0),
        dict(num_epochs=0), dict(iterations=0), dict(seed=-1), dict(hidden=(8, 0)), dict(hidden_estimator=(-1,)),
        dict(num_envs=2, num_steps=1, num_minibatches=2), dict(hidden=(8, 3)),
    ],
    ids=str,
)  # fmt: skip
def test_settings_that_cannot_train_are_refused_in_one_line(bad):
    with pytest.raises(ValueError, match=r"\A.+\Z"):
        eipo.check(replace(Config(), **bad))


def test_settings_are_those_of_the_paper():
    """Section IV-C: networks, 24 steps a rollout, 5 epochs, 4 minibatches, clipping; alpha's 0.01, 1.0 and 0.99."""
    cfg = Config()
    assert (cfg.hidden, cfg.hidden_estimator) == ((512, 256, 128), (256, 128))
    assert (cfg.num_steps, cfg.num_epochs, cfg.num_minibatches, cfg.max_grad_norm) == (24, 5, 4, 1)
    assert (cfg.lr_alpha, cfg.clip_alpha, cfg.momentum_alpha) == (0.01, 1, 0.99)


def test_settings_of_ppo_are_checked_as_ppo():
    """An odd number of environments, and as few as one sample per minibatch, are enough for one policy."""
    eipo.check(Config())
    eipo.check(Config(algo="ppo", num_envs=3, num_steps=1, num_minibatches=3))
    with pytest.raises(ValueError, match="num_minibatches"):
        eipo.check(Config(algo="ppo", num_envs=3, num_steps=1, num_minibatches=4))


def test_imports_know_nothing_of_robots_and_files():
    root = Path(eipo.__file__).parent
    trees = [ast.parse((root / name).read_text()) for name in ("eipo.py", "networks.py")]
    nodes = [node for tree in trees for node in ast.walk(tree)]
    modules = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    modules |= {node.module for node in nodes if isinstance(node, ast.ImportFrom)}
    ours = {path.stem for path in root.glob("*.py")} - {"networks"}
    assert "jax" in modules
    assert not {name.split(".")[0] for name in modules} & (ours | {"mujoco", "os", "pathlib", "json"})
