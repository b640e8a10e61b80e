"""Sections IV-B and V-E: Eqs. (9) and (11) by hand, what is clipped (D3), and gear ratios (D4)."""

import numpy as np
import pytest
from support import FROZEN, QUARTER, make, place, still

import energy


def joints(*values):
    """Twelve joints, of which the first few have the given values and the others 0."""
    return np.array([*values, *[0.0] * (12 - len(values))])


@pytest.mark.parametrize(
    ("torque", "qd", "by_torque", "by_power"),
    [
        ((2.0, -5.0), (3.0, 2.0), 6 - 3 * 2, 6 - 3),
        ((-5.0,), (-4.0,), 3 * 4, 5 * 4),
        ((2e4,), (2.0,), 1e4 * 2, 1e4),
    ],
    ids=["brakes", "is driven backwards", "is beyond the upper bound"],
)
def test_eq09_mechanical(torque, qd, by_torque, by_power):
    """D3. A torque below -3 N m is cut to -3 as printed, or a power below -3 W, and at 1e4 both."""
    torque, qd = joints(*torque), joints(*qd)
    assert energy.mechanical_power(torque, qd, "torque") == by_torque
    assert energy.mechanical_power(torque, qd, "power") == by_power


@pytest.mark.parametrize("leg", range(4), ids=["FR", "FL", "RR", "RL"])
@pytest.mark.parametrize(
    ("joint", "torque"),
    [(0, 2.0), (1, -2.0), pytest.param(2, 3.0, marks=pytest.mark.go1)],
    ids=["hip", "thigh", "calf"],
)
def test_eq09_gear_ratio(leg, joint, torque):
    """D4, g = (1, 1, 2/3). 2 N m at a hip or thigh and 3 N m at a calf heat alike, 0.7 * 2^2."""
    tau = np.zeros(12)
    tau[3 * leg + joint] = torque
    assert energy.heating_power(tau) == 2.8


@pytest.mark.parametrize(("clip", "cost"), [("torque", -144.0), ("power", -141.0)])
def test_eq09_survival_bonus(clip, cost):
    """tau = (2, -4) and qd = (3, 2):

    heat and electronics:   0.7 (4 + 16) + 42 = 56
    mechanical:             6 - 6 = 0, or by power 6 - 3 = 3
    56 or 59 less the bonus of 200

    Without torque 42 W are left, and the cost of 42 - 200 = -158 makes living on pay.
    """
    power = energy.total_power(joints(2.0, -4.0), joints(3.0, 2.0), clip)
    assert energy.energy_cost(power) == cost
    idle = energy.total_power(np.zeros(12), np.full(12, 7.0), clip)
    assert (idle, energy.energy_cost(idle)) == (42.0, -158.0)


@pytest.mark.go1
@pytest.mark.parametrize(
    ("clip", "expected", "ends"), [("torque", -170.8, False), ("power", -149.8, True)]
)
def test_eq09_cost_of_a_step(clip, expected, ends):
    """A hip on target at 8 rad/s has tau = -0.5 * 8 = -4:

    as printed:     (-3) 8 + 0.7 * 16 + 42 - 200 = -170.8
    power clipped:      -3 + 0.7 * 16 + 42 - 200 = -149.8

    D41. So it draws 29.2 or 50.2 W, and a limit of 40 W ends the episode by the second.
    """
    env = make(1, clip=clip, max_power=40.0, **FROZEN)
    place(env, qd=[8.0] + [0.0] * 11)
    _, _, terminated, _, info = still(env)
    assert terminated.tolist() == [ends]
    assert info["cost"] == pytest.approx([expected], abs=1e-3)
    assert info["log"]["power"] == pytest.approx([expected + 200], abs=1e-3)


@pytest.mark.go1
def test_eq09_cost_at_the_torque_limit():
    """The torque of Eq. (9) is the one that is applied, not the one that was asked for.

    Action 10 asks hips for 20 * 1.25 = 25 N m, the others for 50. They get 23.7, calves 35.55, of
    which 2/3 is 23.7 again:

    12 * 0.7 * 23.7^2 + 42 - 200 = 4560.196
    """
    env = make(1, **FROZEN)
    place(env)
    assert env.step(np.full((1, 12), 10.0))[4]["cost"] == pytest.approx([4560.196], abs=0.01)


def test_eq11_smoothness():
    """tau = (2, -3), a = (1, -1/2) and qdd = (60, -80):

    2e-4   (4 + 9)         = 0.0026
    1e-2   (1 + 1/4)       = 0.0125
    2.5e-7 (3600 + 6400)   = 0.0025, together 0.0176
    """
    cost = energy.smoothness_cost(joints(2, -3), joints(1, -0.5), joints(60, -80))
    assert cost == pytest.approx(0.0176, rel=1e-12)


@pytest.mark.go1
def test_eq11_takes_the_mean_of_the_physics_steps():
    """D17. Every joint is asked for 1/4 rad more. Its speeds are 0, 2, 4, 6 and 10 rad/s, so its
    torques 5 - qd / 2 are 5, 4, 3 and 2 N m, with a mean square of 13.5:

    Eq. (11):  2e-4 * 12 * 13.5 + 1e-2 (4 * 4 + 8 * 1) + 2.5e-7 * 12 (10 / 0.02)^2
               = 0.0324 + 0.24 + 0.75 = 1.0224
    Eq. (9):   12 (5 * 1 + 4 * 3 + 3 * 5 + 2 * 8) / 4 + 0.7 * 13.5 (8 + 4 * 4/9) + 42
               = 144 + 92.4 + 42 = 278.4 W, which is logged, without a bonus

    D15. The acceleration is that of the whole step, and the action counts, not its change: the
    action before was the same.
    """
    env = make(aux="smooth")
    place(env)
    env.state.action[:] = QUARTER
    gains = iter((2.0, 2.0, 2.0, 4.0))

    def faster():
        env.qvel[:, 6:] += next(gains)

    env.batch.step = faster
    info = env.step(QUARTER)[4]
    assert info["cost"] == pytest.approx([1.0224] * 2)
    assert info["log"]["power"] == pytest.approx([278.4] * 2)
