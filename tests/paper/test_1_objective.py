"""Sections II and III: Eqs. (1) to (4) and (10), GAE, the estimates of lines 8, 10 and 12, and line
13's step on alpha.

The numbers are dyadic, so that floating-point arithmetic is exact and `==` is meant. Each docstring
does the sum.
"""

from dataclasses import replace

import jax
import numpy as np
import pytest
from support import EIPO, LAMBDAS, dyadic, handmade, trees_equal

import eipo
from eipo import Config, Dual, Estimate, Rollout
from lab import sweep
from runtime import flags

# line 13 as in Section IV-C.c
PAPER = replace(EIPO, lr_alpha=0.01, clip_alpha=1.0, momentum_alpha=0.99)
gae = jax.jit(eipo.gae)
ones, never = np.ones(3), np.zeros(3, bool)
at_1 = np.array([False, True, False])

# ---- Eqs. (1) to (4), (10) ----


def test_eq01_discounted_return():
    """gamma = 1/2, r = (1, 2, 4), nothing after: J = 1 + 2/2 + 4/4 = 3. GAE with V = 0, gae_lambda
    = 1 is that sum.
    """
    ends = np.array([False, False, True])
    assert gae(np.array([1.0, 2.0, 4.0]), 0 * ones, 0 * ones, ends, never, 0.5, 1.0)[0] == 3


def test_eq02_lambda_objective():
    """A_r = (1, 2, -3), A_f = (4, -8, 16), lam = 1/4: A_r - lam A_f = (1 - 1, 2 + 2, -3 - 4) = (0,
    4, -7).

    Stream 2 is stored as lam f, so its advantage is lam A_f = (1, -2, 4).
    """
    advantage = np.array([[1.0, 1.0], [2.0, -2.0], [-3.0, 4.0]])
    assert eipo.mix(advantage, alpha=4.0, lam=0.25).tolist() == [0, 4, -7]


def test_eq02_without_energy_is_the_task_alone():
    """lam = 0 is alpha = 1 / lam = infinite: what is left is A_r, and no 0 * inf = nan."""
    assert eipo.mix(np.array([[1.0, 64.0], [2.0, 64.0]]), alpha=np.inf, lam=0.0).tolist() == [1, 2]


def test_eq04_lambda_is_one_over_alpha():
    """D6. At alpha = 1 / lam = 4, Eq. (4)'s 4 A_r - A_f is 4 times Eq. (2)'s A_r - A_f / 4: equal
    once normalised.
    """
    A_r, A_f = dyadic(np.random.default_rng(0), 2, 64)
    eq2 = eipo.mix(np.stack([A_r, 0.25 * A_f], -1), alpha=4.0, lam=0.25)
    eq4 = 4 * A_r - A_f
    assert np.array_equal(eq2 * 4, eq4)
    assert np.array_equal((eq2 - eq2.mean()) / eq2.std(), (eq4 - eq4.mean()) / eq4.std())


def test_eq04_alpha_weighs_the_task():
    """alpha = 32 with lam = 1/4: alpha A_r - A_f for A_r = 1, A_f = 4 is 32 - 4 = 28, times lam: 7.
    Not 32 / 4 - 4.

    At alpha = 0 the task counts for nothing: -4, times lam: -1. With the arguments swapped it would
    be A_r.
    """
    advantage = np.array([1.0, 0.25 * 4])
    assert eipo.mix(advantage, alpha=32.0, lam=0.25) == 7
    assert eipo.mix(advantage, 0.0, 0.25) == -1


def test_eq04_gradient_in_alpha():
    """D2. F = 10, J = 3, J' = 5, alpha = 2: L = 10 - 2 (3 - 5) = 14, dL/dalpha = -(3 - 5) = +2:
    ascent raises alpha.

    With eta_alpha = 1/2, no momentum and a wide clip, line 13 must go to 2 + 2/2 = 3; the printed J
    - J' goes to 1.
    """

    def lagrangian(alpha, F=10.0, J=3.0, J_prime=5.0):
        return F - alpha * (J - J_prime)

    assert lagrangian(2.0) == 14
    assert jax.grad(lagrangian)(2.0) == 2
    plain = replace(PAPER, lr_alpha=0.5, momentum_alpha=0.0, clip_alpha=4.0)
    assert eipo.step_alpha(Dual(2.0, 0.0), 3.0 - 5.0, plain) == Dual(3.0, 2.0)


def test_eq10_the_sweep_has_its_nine_lambdas():
    """Eq. (10), read off the paper, with the 0 of PPO without energy: Table I has a row for each,
    and one for EIPO.
    """
    printed = (0, 0.0001, 0.0002, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.02)
    assert printed == sweep.LAMBDAS and len(sweep.KINDS) == 1 + 9


@pytest.mark.parametrize("algo, lambdas", [("ppo", LAMBDAS), ("eipo", LAMBDAS[1:])])
def test_eq10_every_lambda_can_be_trained(algo, lambdas):
    """PPO takes all nine; EIPO starts from every positive one."""
    for lam in lambdas:
        flags.check_learner(Config(algo=algo, lam=lam))


# ---- GAE and the estimates of L8, L10, L12 ----


def test_algorithm1_line08_gae_plain():
    """gamma = gae_lambda = 1/2, r = V = 1: every delta is 1 + 1/2 - 1 = 1/2; summed back with 1/4:

    1/2,  1/2 + 1/8 = 0.625,  1/2 + 0.625 / 4 = 0.65625
    """
    assert gae(ones, ones, ones, never, never, 0.5, 0.5).tolist() == [0.65625, 0.625, 0.5]


def test_algorithm1_line08_gae_terminated():
    """Nothing comes after t = 1, whatever V says: delta_1 = 1 + 0 - 1 = 0, and t = 0 gets 1/2 + 0 /
    4.
    """
    assert gae(ones, ones, np.array([1.0, 64.0, 1.0]), at_1, never, 0.5, 0.5).tolist() == [
        0.5,
        0,
        0.5,
    ]


def test_algorithm1_line08_gae_truncated():
    """Cut at 1, where V(final_obs) = 3: delta_1 = 1 + 3/2 - 1 = 1.5; t = 2 is another episode; t =
    0: 1/2 + 1.5/4.
    """
    cut = gae(ones, ones, np.array([1.0, 3.0, 1.0]), never, at_1, 0.5, 0.5)
    assert cut.tolist() == [0.875, 1.5, 0.5]


def test_algorithm1_line08_gae_is_linear():
    """alpha gae(r) - gae(f) == gae(alpha r - f), bit by bit: mixing advantages is mixing rewards,
    and can wait.
    """
    rng = np.random.default_rng(1)
    r, f = dyadic(rng, 2, 3, 4, 32)  # (reward, value, next value), T, N
    terminated, truncated = rng.random((2, 4, 32)) < 0.2

    def of(streams):
        return gae(*streams, terminated, truncated & ~terminated, 0.5, 0.5)

    assert np.array_equal(8 * of(r) - of(f), of(8 * r - f))


def estimate_of(obs, reward, terminated, truncated, final_obs, after, critic=1.0):
    """What is estimated from a rollout of one environment by a critic that says V(obs) = critic *
    obs.

    Lists of T numbers; final_obs where truncated, in order
    """
    obs, zero, reward = (
        np.reshape(np.float32(x), (-1, 1, 1)) for x in (obs, np.zeros(len(obs)), reward)
    )
    terminated, truncated = np.reshape(terminated, (-1, 1)), np.reshape(truncated, (-1, 1))
    after, final = (np.reshape(np.float32(x), (-1, 1)) for x in (after, final_obs))
    tau = Rollout(
        obs, zero, zero, reward, terminated, truncated, (after, 0 * after), (final, 0 * final)
    )
    return eipo.estimate(handmade(critic=((critic,), (0.0,))), tau, EIPO)


def test_algorithm1_line08_gae_bootstraps_from_the_final_observation():
    """The critic says V(obs) = obs. Observations 1, 1 | 64 (a new episode, after a time limit),
    then 5.

    t = 2: 1 + 5/2 - 64 = -60.5     the end of the rollout is no end of the episode: V(after) = 5
    t = 1: 1 + 3/2 - 1 = 1.5        V(final_obs) = 3, not the 64 of the reset observation
    t = 0: 1 + 1/2 - 1 + 1.5/4 = 0.875
    Targets add V: 1.875, 2.5, 3.5. J is their mean, 7.875 / 3 = 2.625.
    """
    estimate = estimate_of([1, 1, 64], [1, 1, 1], [False] * 3, [False, True, False], [3], after=5)
    assert estimate.advantage.ravel().tolist() == [0.875, 1.5, -60.5]
    assert estimate.target.ravel().tolist() == [1.875, 2.5, 3.5]
    assert eipo.estimate_J(estimate) == 2.625


def test_algorithm1_line08_gae_ends_where_an_episode_terminated():
    """Fallen at t = 1 and at the last step: only the reward counts there. 1 - 1 = 0, 1 - 64 = -63;
    t = 0: 1/2 + 0/4.
    """
    estimate = estimate_of([1, 1, 64], [1, 1, 1], [False, True, True], [False] * 3, [], after=5)
    assert estimate.advantage.ravel().tolist() == [0.5, 0, -63]


def test_algorithm1_line12_estimate_J_is_not_of_normalised_advantages():
    """D8. One-step episodes, V = 0: rewards (0, 2, 0, 2) give J = 1, rewards (2, 4, 2, 4) give J =
    3: the gap is -2.

    Their normalised advantages are the same (-1, 1, -1, 1), of mean 0: alpha could never tell them
    apart.
    """
    ends = dict(
        obs=[0] * 4, terminated=[True] * 4, truncated=[False] * 4, final_obs=[], after=0, critic=0.0
    )
    low, high = (estimate_of(reward=reward, **ends) for reward in ([0, 2, 0, 2], [2, 4, 2, 4]))
    assert low.advantage.ravel().tolist() == [0, 2, 0, 2]
    assert (eipo.estimate_J(low), eipo.estimate_J(high)) == (1, 3)
    normalised = [(e.advantage - e.advantage.mean()) / e.advantage.std() for e in (low, high)]
    assert trees_equal(*normalised)
    assert normalised[0].mean() == 0


def test_algorithm1_line12_estimate_J_is_the_task_alone():
    """Targets (1, 64) and (3, 64) of the streams (task, cost): J = (1 + 3) / 2 = 2, the cost is not
    asked.
    """
    target = np.array([[[1.0, 64.0]], [[3.0, 64.0]]])
    assert eipo.estimate_J(Estimate(None, target, None)) == 2


@pytest.mark.parametrize(
    ("alpha", "lam", "share"), [(6.0, 0.25, 0.75), (4.0, 0.25, 2 / 3), (np.inf, 0.0, 1.0)]
)
def test_algorithm1_share_of_the_task_in_the_objective(alpha, lam, share):
    """A_r = +-1 and lam A_f = +-1/2 with lam = 1/4, so A_f = +-2: 6 / (6 + 2) at alpha = 6, 4 / (4
    + 2) at 1 / lam.

    Without energy the share is all. J is the mean of 1 and 3.
    """
    estimate = Estimate(
        np.array([[[1.0, 0.5]], [[-1.0, -0.5]]]), np.array([[[1.0, 64.0]], [[3.0, 64.0]]]), None
    )
    log = eipo.summary(estimate, Dual(alpha, 0.0), replace(EIPO, lam=lam))
    assert log == dict(J=2, alpha=alpha, task_share=pytest.approx(share))


# ---- L13: the multiplier ----


def alphas(gaps, cfg=PAPER, start=200.0):
    """alpha after each step of line 13, and the last Dual."""
    duals = [Dual(start, 0.0)]
    for gap in gaps:
        duals.append(eipo.step_alpha(duals[-1], gap, cfg))
    return np.array([dual.alpha for dual in duals]), duals[-1]


def test_algorithm1_line13_alpha_momentum():
    """alpha = 200, eta 0.01, clip 1, momentum 0.99; pi lags by 2, lags by 1, leads by 1/2:

    gap -2:  g = clip(2) = 1   v = 1                        alpha = 200.01
    gap -1:  g = 1             v = 0.99 + 1 = 1.99          alpha = 200.01 + 0.0199 = 200.0299
    gap 1/2: g = -1/2          v = 1.9701 - 0.5 = 1.4701    alpha = 200.0299 + 0.014701 = 200.044601
    """
    assert alphas((-2, -1, 0.5))[0] == pytest.approx([200, 200.01, 200.0299, 200.044601], rel=1e-12)


def test_algorithm1_line13_alpha_gradient_is_clipped_both_ways():
    """However far ahead or behind, the gradient is 1: v = 0.99 * 0 -+ 1."""
    assert eipo.step_alpha(Dual(200.0, 0.0), 64.0, PAPER).momentum == -1
    assert eipo.step_alpha(Dual(200.0, 0.0), -64.0, PAPER).momentum == 1


def test_algorithm1_line13_alpha_stays_above_zero_and_loses_its_momentum_there():
    """0.005 - 0.01 < 0: alpha = 0, v = 0. What follows is a fresh start: 0 + 0.01 * 1, not 0.01 *
    (1 - 0.99).
    """
    dual = eipo.step_alpha(Dual(0.005, 0.0), 1.0, PAPER)
    assert dual == Dual(0.0, 0.0)
    assert eipo.step_alpha(dual, -1.0, PAPER) == Dual(0.01, 1.0)


@pytest.mark.parametrize("gap", [np.nan, np.inf, -np.inf])
def test_algorithm1_line13_alpha_stays_where_it_is_when_the_gap_is_not_finite(gap):
    """nan > 0 is false: without care one bad reward would switch the task off."""
    assert eipo.step_alpha(Dual(200.0, 1.0), gap, PAPER) == Dual(200.0, 1.0)


def test_algorithm1_line13_alpha_dampening_turns_momentum_into_an_average():
    """dampening 0.99: v = 0.01 * 1, alpha = 200 + 0.01 * 0.01; a constant gradient of 1 never gets
    v above 1.
    """
    cfg = replace(PAPER, dampening_alpha=0.99)
    assert eipo.step_alpha(Dual(200.0, 0.0), -1.0, cfg) == pytest.approx(
        Dual(200.0001, 0.01), rel=1e-12
    )
    assert alphas([-1.0] * 2000, cfg)[1].momentum == pytest.approx(1)


def test_algorithm1_line13_alpha_moves_by_one_per_iteration_in_the_limit():
    """v -> 1 / (1 - 0.99) = 100, so that alpha gains at most 0.01 * 100 = 1 per iteration, be the
    gap ever so wide.
    """
    gains = np.diff(alphas([-1000.0] * 2000)[0])
    assert gains.max() < 1.000001
    assert gains[-1] == pytest.approx(1)
