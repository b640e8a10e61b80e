"""Sections II to IV-D: Eqs. (1), (2), (4) and (10), GAE, the estimates of lines 8, 10 and 12, and
line 13's step on alpha.

Where `==` stands the numbers are dyadic, so that floating-point arithmetic is exact. Each docstring
does the sum.
"""

from dataclasses import replace

import jax
import numpy as np
import pytest
from support import EIPO, handmade, learner_of

import eipo
import tasks
from eipo import Dual, Transition
from results import paper

# line 13 as in Section IV-C.c
PAPER = replace(EIPO, lr_alpha=0.01, clip_alpha=1.0, momentum_alpha=0.99)
gae = jax.jit(eipo.gae)
ones, never = np.ones(3), np.zeros(3, bool)
at_1 = np.array([False, True, False])

# ---- Eqs. (1), (2), (4), (10) ----


def test_eq01_discounted_return():
    """gamma = 1/2, r = (1, 2, 4) and nothing after. GAE with V = 0, gae_lambda = 1 is the sum

    J = 1 + 2/2 + 4/4 = 3
    """
    reward, ends = np.array([1.0, 2.0, 4.0]), np.array([False, False, True])
    assert gae(reward, 0 * ones, 0 * ones, ends, never, 0.5, 1.0)[0] == 3


def test_eq02_lambda_objective_and_eq04_at_one_over_lambda():
    """D6. pi minimises L = F - alpha (J - max J'), so it maximises alpha J - F (line 8). With lam =
    1/4, and with alpha = 1 / lam = 4:

    A_r                      =  1,   2,  -3
    A_f                      =  4,  -8,  16
    Eq. (2): A_r - lam A_f   =  0,   4,  -7
    Eq. (4): alpha A_r - A_f =  0,  16, -28

    The last line is 4 times the one before, so normalised they are equal.
    """
    advantage = np.array([[1.0, 4.0], [2.0, -8.0], [-3.0, 16.0]])
    assert eipo.mix(advantage, (1, -0.25)).tolist() == [0, 4, -7]
    assert eipo.mix(advantage, (4, -1)).tolist() == [0, 16, -28]


def test_eq04_gradient_in_alpha():
    """D2. F = 10, J = 3, J' = 5 and alpha = 2, with eta_alpha = 1/2, no momentum and a wide clip:

    L         = F - alpha (J - J') = 10 - 2 (3 - 5) = 14
    dL/dalpha =          -(J - J') = +2
    alpha     = 2 + 2/2 = 3            (the printed J - J' would go to 2 - 2/2 = 1)
    """
    cfg = replace(PAPER, lr_alpha=0.5, momentum_alpha=0.0, clip_alpha=4.0)
    assert eipo.step_alpha(Dual(2.0, 0.0), 3.0 - 5.0, cfg) == Dual(3.0, 2.0)


def test_eq10_the_sweep_has_its_nine_lambdas():
    """Table I has a row for each, and one for EIPO."""
    printed = {"EIPO": 2.86, 0: 2.12, 0.0001: 1.55, 0.0002: 1.49, 0.0005: 1.58, 0.001: 1.64}
    printed |= {0.002: 1.58, 0.005: 1.62, 0.01: 1.45, 0.02: 1.37}
    assert list(printed.items()) == [*zip(("EIPO", *tasks.LAMBDAS), paper.TABLE1, strict=True)]


# ---- GAE and the estimates of L8, L10, L12 ----


def test_algorithm1_line08_gae_plain():
    """gamma = gae_lambda = 1/2 and r = V = 1. Errors are summed backwards, with a factor 1/4:

    delta =  1 + 1/2 - 1       = 0.5
    A_2   =  0.5
    A_1   =  0.5 + 0.5 / 4     = 0.625
    A_0   =  0.5 + 0.625 / 4   = 0.65625
    """
    assert gae(ones, ones, ones, never, never, 0.5, 0.5).tolist() == [0.65625, 0.625, 0.5]


def test_algorithm1_line08_gae_terminated():
    """Nothing comes after t = 1, whatever V says of the next state:

    A_2 =  1 + 1/2 - 1         = 0.5
    A_1 =  1 + 0 - 1           = 0
    A_0 =  1 + 1/2 - 1 + 0 / 4 = 0.5
    """
    next_values = np.array([1.0, 64.0, 1.0])
    assert gae(ones, ones, next_values, at_1, never, 0.5, 0.5).tolist() == [0.5, 0, 0.5]


def estimate_of(obs, reward, terminated, truncated, next_obs, critic=(1.0,), cost=0.0, lam=1.0):
    """What is estimated from T steps of one environment by a critic that says V = critic * obs."""

    def column(x):
        return np.reshape(x, (-1, 1, 1)).astype(np.float32)

    zero = column([0] * len(obs))
    costs = np.zeros(len(obs)) + cost
    scalars = [np.reshape(x, (-1, 1)) for x in (reward, costs, terminated, truncated)]
    reward, costs, terminated, truncated = scalars
    tau = Transition(
        obs=column(obs),
        privileged=zero,
        action=zero,
        log_prob=zero[..., 0],
        reward=reward,
        cost=costs,
        terminated=terminated,
        truncated=truncated,
        next_obs=column(next_obs),
        next_privileged=zero,
    )
    pi = learner_of(handmade(critic=(critic, [0.0] * len(critic))), lam)
    return eipo.estimate(pi, tau, EIPO)


def test_algorithm1_line08_gae_bootstraps_from_where_the_step_led():
    """The critic says V(obs) = obs. Time is up after t = 1, and 64 begins another episode:

    t = 0:  from 1 to 1
    t = 1:  from 1 to 3, the end of the episode
    t = 2:  from 64 to 5, the end of the rollout but not of the episode

    A_2 =  1 + 5/2 - 64          = -60.5
    A_1 =  1 + 3/2 - 1           =   1.5
    A_0 =  1 + 1/2 - 1 + 1.5 / 4 =   0.875

    Targets are A + V, and J is their mean, (1.875 + 2.5 + 3.5) / 3 = 2.625.
    """
    ends = dict(terminated=[False] * 3, truncated=[False, True, False])
    estimate = estimate_of([1, 1, 64], [1, 1, 1], **ends, next_obs=[1, 3, 5])
    assert estimate.advantage.ravel().tolist() == [0.875, 1.5, -60.5]
    assert estimate.target.ravel().tolist() == [1.875, 2.5, 3.5]
    assert eipo.estimate_J(estimate) == 2.625


def test_algorithm1_line12_estimate_J_is_not_of_normalised_advantages():
    """D8. Episodes of one step, V = 0. The gap between these two policies is 1 - 3 = -2:

    rewards 0, 2, 0, 2:  J = 1
    rewards 2, 4, 2, 4:  J = 3

    The normalised advantages of both are -1, 1, -1, 1, of mean 0. So alpha could never tell them
    apart.
    """
    ends = dict(terminated=[True] * 4, truncated=[False] * 4)
    low, high = (
        estimate_of([0] * 4, reward, **ends, next_obs=[0] * 4, critic=(0.0,))
        for reward in ([0, 2, 0, 2], [2, 4, 2, 4])
    )
    assert low.advantage.ravel().tolist() == [0, 2, 0, 2]
    assert high.advantage.ravel().tolist() == [2, 4, 2, 4]
    assert (eipo.estimate_J(low), eipo.estimate_J(high)) == (1, 3)


@pytest.mark.parametrize(("weights", "share"), [((6, -1), 0.75), ((1, -0.25), 2 / 3), ((1,), 1)])
def test_algorithm1_share_of_the_task_in_the_objective(weights, share):
    """A_r = 1, 3 and A_f = 2, -2, with deviations of 1 and 2:

    alpha = 6:   6 / (6 + 2)      = 3/4
    lam = 1/4:   1 / (1 + 2 / 4)  = 2/3
    lam = 0:     1
    """
    advantage = np.array([[[1.0, 2.0]], [[3.0, -2.0]]])[..., : len(weights)]
    assert eipo.task_share(advantage, weights) == pytest.approx(share)


def test_algorithm1_what_each_head_of_the_critic_foresaw():
    """Episodes of one step, so a target is what the step pays, and an advantage what V had missed.

    V of obs 1, 3, 1, 3 is 1, 3, 1, 3 at the head of r and 0 at that of f:

    r: 1, 3, 3, 5  misses 0, 0, 2, 2 of variance 1; the targets have (4 + 0 + 0 + 4) / 4 = 2: 1/2
    f: 2, 2, 6, 6  misses all of it: 0. Times lam = 1/4 both variances change alike.
    """
    steps = dict(terminated=[True] * 4, truncated=[False] * 4, next_obs=[0] * 4, cost=[2, 2, 6, 6])
    est = estimate_of([1, 3, 1, 3], [1, 3, 3, 5], **steps, critic=(1.0, 0.0), lam=0.25)
    assert est.explained_variance.tolist() == [0.5, 0.0]
    log = eipo.summary(est, dict(kl=1.0))
    assert log == dict(J=3, explained_variance=0.5, explained_variance_cost=0.0, kl=1.0)


# ---- L13: the multiplier ----


def test_algorithm1_line13_alpha_momentum():
    """eta 0.01, clip 1, momentum 0.99. pi lags by 2, lags by 1, leads by 1/2, leads by 64:

    gap      gradient         momentum                         alpha
    -2       clip(2) = 1      1                                200 + 0.01            = 200.01
    -1       1                0.99 + 1           = 1.99        200.01 + 0.0199       = 200.0299
    1/2      -1/2             1.9701 - 0.5       = 1.4701      200.0299 + 0.014701   = 200.044601
    64       clip(-64) = -1   1.455399 - 1       = 0.455399    200.044601 + 0.00455399
    """
    dual, alphas = Dual(200.0, 0.0), []
    for gap in (-2, -1, 0.5, 64):
        dual = eipo.step_alpha(dual, gap, PAPER)
        alphas.append(dual.alpha)
    expected = [200.01, 200.0299, 200.044601, 200.04915499]
    assert alphas == pytest.approx(expected, rel=1e-12)


def test_algorithm1_line13_alpha_stays_above_zero_and_loses_its_momentum_there():
    """0.005 - 0.01 < 0, so alpha becomes 0 and its momentum of -1 is forgotten. The next step is
    therefore a whole one, 0 + 0.01 * 1 = 0.01. With what was left of the momentum it would be
    0.01 (1 - 0.99).
    """
    dual = eipo.step_alpha(Dual(0.005, 0.0), 1.0, PAPER)
    assert dual == Dual(0.0, 0.0)
    assert eipo.step_alpha(dual, -1.0, PAPER) == Dual(0.01, 1.0)


@pytest.mark.parametrize("gap", [np.nan, np.inf, -np.inf])
def test_algorithm1_line13_alpha_stays_where_it_is_when_the_gap_is_not_finite(gap):
    """nan > 0 is false: without care one bad reward would switch the task off."""
    assert eipo.step_alpha(Dual(200.0, 1.0), gap, PAPER) == Dual(200.0, 1.0)
