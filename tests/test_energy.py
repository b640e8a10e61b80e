"""Eqs. (9) and (11) by hand, and deviations D3 (what is clipped) and D4 (the gear ratio)."""

import numpy as np
import pytest

import energy


def joints(*values):
    """Twelve joints, of which the first few have the given values and the others 0."""
    return np.array([*values, *[0.0] * (12 - len(values))])


@pytest.mark.parametrize(("clip", "power"), [("torque", 0.0), ("power", 3.0)])
def test_eq09_mechanical(clip, power):
    """tau = (2, -5), qd = (3, 2). D3, as printed: 2*3 + (-3)*2 = 0. Power clipped: 6 + max(-10, -3) = 3."""
    assert energy.mechanical_power(joints(2.0, -5.0), joints(3.0, 2.0), clip) == power


@pytest.mark.parametrize(("clip", "power"), [("torque", 12.0), ("power", 20.0)])
def test_eq09_mechanical_of_a_joint_driven_backwards(clip, power):
    """tau = -5, qd = -4, a motor that works: D3, as printed (-3)(-4) = 12, by power (-5)(-4) = 20."""
    assert energy.mechanical_power(joints(-5.0), joints(-4.0), clip) == power


@pytest.mark.parametrize(("clip", "power"), [("torque", 20000.0), ("power", 10000.0)])
def test_eq09_mechanical_upper_bound(clip, power):
    """tau = 2e4, qd = 2: the torque is cut to 1e4, 1e4*2 = 2e4; the power of 4e4 is cut to 1e4."""
    assert energy.mechanical_power(joints(2e4), joints(2.0), clip) == power


def test_eq09_heating():
    """tau = (1/2, 1), g = (2, 3): tau * g = (1, 3), 0.7 (1 + 9) = 7. (tau / g would give 0.7 (1/16 + 1/9).)"""
    assert energy.heating_power(np.array([0.5, 1.0]), np.array([2.0, 3.0])) == 7.0


@pytest.mark.parametrize("leg", range(4), ids=["FR", "FL", "RR", "RL"])
@pytest.mark.parametrize(("joint", "torque"), [(0, 2.0), (1, -2.0), (2, 3.0)], ids=["hip", "thigh", "calf"])
def test_eq09_gear_ratio(leg, joint, torque):
    """D4, g = (1, 1, 2/3): 2 N m at a hip or thigh and 3 N m at a calf heat alike, 0.7 * 2^2 = 2.8."""
    tau = np.zeros(12)
    tau[3 * leg + joint] = torque
    assert energy.heating_power(tau) == 2.8


@pytest.mark.parametrize(("clip", "power"), [("torque", 56.0), ("power", 59.0)])
def test_eq09_total(clip, power):
    """tau = (2, -4), qd = (3, 2): 0.7 (4 + 16) + 42 = 56, plus mechanical 6 - 6 = 0 or, by power, 6 - 3 = 3."""
    assert energy.total_power(joints(2.0, -4.0), joints(3.0, 2.0), clip) == power


@pytest.mark.parametrize(("clip", "cost"), [("torque", -144.0), ("power", -141.0)])
def test_eq09_survival_bonus(clip, cost):
    """The numbers of the total, 56 W or 59 W, less the bonus of 200."""
    assert energy.energy_cost(joints(2.0, -4.0), joints(3.0, 2.0), clip) == cost


def test_eq09_idle_robot():
    """No torque: the electronics' 42 W are left, and a cost of 42 - 200 = -158, so that living on pays."""
    idle = np.zeros(12), np.full(12, 7.0), "power"
    assert (energy.total_power(*idle), energy.energy_cost(*idle)) == (42.0, -158.0)


@pytest.mark.parametrize("function", [energy.mechanical_power, energy.total_power, energy.energy_cost])
def test_eq09_unknown_clip(function):
    """A misspelt clip is an error, not silently the other reading."""
    with pytest.raises(ValueError, match="not 'velocity'"):
        function(np.ones(12), np.ones(12), clip="velocity")


@pytest.mark.parametrize(
    ("torque", "action", "qdd", "cost"),
    [
        ((2, -3), (), (), 0.0026),
        ((), (1, -0.5), (), 0.0125),
        ((), (), (60, -80), 0.0025),
        ((2, -3), (1, -0.5), (60, -80), 0.0176),
    ],
)
def test_eq11_smoothness(torque, action, qdd, cost):
    """2e-4 (4 + 9) = 0.0026; 1e-2 (1 + 1/4) = 0.0125; 2.5e-7 (3600 + 6400) = 0.0025; all three 0.0176."""
    terms = (joints(*x) for x in (torque, action, qdd))
    assert energy.smoothness_cost(*terms) == pytest.approx(cost, rel=1e-12)


@pytest.mark.parametrize(
    ("function", "arguments", "clip"),
    [(energy.mechanical_power, 2, ["torque"]), (energy.mechanical_power, 2, ["power"]), (energy.heating_power, 1, []),
     (energy.total_power, 2, ["power"]), (energy.energy_cost, 2, ["power"]), (energy.smoothness_cost, 3, [])],
)  # fmt: skip
def test_leading_shape(function, arguments, clip):
    """Rollouts are (T, N, 12): an entry of the result must not depend on the others."""
    x = np.random.default_rng(0).normal(size=(arguments, 2, 3, 12)) * 10
    result = function(*x, *clip)
    assert result.shape == (2, 3)
    assert all(result[i] == function(*(part[i] for part in x), *clip) for i in np.ndindex(2, 3))
