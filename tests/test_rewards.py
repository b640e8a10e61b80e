"""Eqs. (5) to (8) by hand. sigma = 1/4, so that an error of 1/2 costs a factor exp(-(1/2)^2 / (1/4)) = 1/e."""

import numpy as np
import pytest

import rewards

E1, E2, E4 = 0.36787944117144233, 0.1353352832366127, 0.01831563888873418  # e^-1, e^-2, e^-4


def reward(function, velocity, command=(0.0, 0.0, 0.0)):
    """The reward for v_x, v_y, yaw rate."""
    return function(np.array(velocity, float), np.array(command, float))


@pytest.mark.parametrize(
    ("velocity", "value"),
    [
        ((0.5, 0.25, -1.0), E1 + 0.5),  # v_x short by 1/2
        ((0.0, 0.25, -1.0), E4 + 0.5),  # by 1: (1)^2 / (1/4) = 4
        ((1.0, 0.75, -1.0), E1 + 0.5),  # v_y off by 1/2
        ((0.5, -0.25, -1.0), E2 + 0.5),  # both: the squares add up in one exponential
        ((1.0, 0.25, -0.5), 1 + 0.5 * E1),  # yaw rate off by 1/2
        ((0.5, 0.75, -1.5), E2 + 0.5 * E1),  # all three
    ],
)
def test_eq05_flat(velocity, value):
    """Command (1, 1/4, -1): each error of 1/2 multiplies its term by 1/e, and v_x and v_y share one term."""
    assert reward(rewards.flat, velocity, (1.0, 0.25, -1.0)) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize(
    ("velocity", "value"),
    [
        ((0.5, 0.25, -1.0), E1 + 0.15),  # v_x short by 1/2
        ((1.0, 0.75, -1.0), 1.1 + 0.05 * E1),  # v_y off by 1/2
        ((1.0, 0.25, -0.5), 1.05 + 0.1 * E1),  # yaw rate off by 1/2
        ((0.5, -0.25, -1.5), 1.15 * E1),  # all three, 0.423061
    ],
)
def test_eq06_rough(velocity, value):
    """Command (1, 1/4, -1): weights 1, 0.05, 0.1, and an error of 1/2 multiplies its own term by 1/e only."""
    assert reward(rewards.rough, velocity, (1.0, 0.25, -1.0)) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize(
    ("velocity", "value"),
    [
        ((2.0, 0.0, 0.0), 2.0),
        ((-2.0, 0.0, 0.0), -2.0),  # running backwards costs
        ((2.0, 0.5, 0.0), 2 * E1),
        ((2.0, 0.0, -0.5), 2 * E1),
        ((2.0, 0.5, 0.5), 2 * E2),  # 0.270671
        ((-4.0, -0.5, 0.5), -4 * E2),
    ],
)
def test_eq07_max_velocity(velocity, value):
    """v_x itself, times 1/e for each error of 1/2 in v_y and in the yaw rate; commands are 0."""
    assert reward(rewards.max_velocity, velocity) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize("v_x", [-8.0, 0.0, 8.0])
def test_eq07_has_no_command_of_v_x(v_x):
    """Commands (3, 1/2, -1/4) met in v_y and yaw rate: the reward is v_x, whatever v_x was asked for."""
    assert reward(rewards.max_velocity, (v_x, 0.5, -0.25), (3.0, 0.5, -0.25)) == v_x


@pytest.mark.parametrize(
    ("velocity", "value"),
    [
        ((0.5, 0.25, -1.0), E1 + 0.5),  # v_x short by 1/2
        ((1.5, 0.25, -1.0), E1 + 0.5),  # v_x over by 1/2
        ((1.5, 0.75, -1.0), E2 + 0.5),  # v_x and v_y share one exponential
        ((1.0, 0.25, -1.5), 1 + 0.5 * E1),
    ],
)
def test_eq08_curriculum(velocity, value):
    """Command (1, 1/4, -1), as Eq. (5), but an error of +1/2 in v_x costs what one of -1/2 does."""
    assert reward(rewards.curriculum, velocity, (1.0, 0.25, -1.0)) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize(
    ("function", "value"), [(rewards.flat, 1.5), (rewards.rough, 1.15), (rewards.curriculum, E1 + 0.5)]
)
def test_eq05_eq06_one_sided_eq08_two_sided(function, value):
    """v_x = 3/2, command 1: min(1/2, 0) = 0 is no error in Eqs. (5) and (6); in Eq. (8) it costs 1 - 1/e."""
    assert reward(function, (1.5, 0.0, 0.0), (1.0, 0.0, 0.0)) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize(("function", "best"), [(rewards.flat, 1.5), (rewards.rough, 1.15), (rewards.curriculum, 1.5)])
def test_maximum(function, best):
    """1 + 0.5 or 1 + 0.05 + 0.1, reached where the command is met and nowhere exceeded: the scale of Fig. 2."""
    velocity = np.random.default_rng(0).normal(size=(1000, 3))
    assert function(velocity, velocity) == pytest.approx(best, rel=1e-14)
    assert function(velocity, np.zeros(3)).max() <= best


@pytest.mark.parametrize("function", [rewards.flat, rewards.rough, rewards.max_velocity, rewards.curriculum])
def test_leading_shape(function):
    """The environments step as one array: an entry of the result must not depend on the others."""
    velocity, command = np.random.default_rng(0).normal(size=(2, 2, 5, 3))
    result = function(velocity, command)
    assert result.shape == (2, 5)
    assert all(result[i] == pytest.approx(function(velocity[i], command[i]), rel=1e-14) for i in np.ndindex(2, 5))
