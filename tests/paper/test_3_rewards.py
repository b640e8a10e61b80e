"""Section IV-A: Eqs. (5) to (8) by hand, the velocity that they mean (D25), and the shaped baseline
of Section V-E.

sigma = 1/4, so that an error of 1/2 costs a factor exp(-(1/2)^2 / (1/4)) = 1/e.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support import FROZEN, NOSE_UP, make, place, still

import go1
import rewards

E1, E2, E4 = 0.36787944117144233, 0.1353352832366127, 0.01831563888873418  # e^-1, e^-2, e^-4


def reward(function, velocity, command=(0.0, 0.0, 0.0)):
    """The reward of v_x, v_y and yaw rate, for a command of the same."""
    return function(np.array(velocity, float), np.array(command, float))


@pytest.mark.parametrize(
    ("velocity", "value"),
    [
        ((0.0, 0.25, -1.0), E4 + 0.5),  # v_x short by 1: (1)^2 / (1/4) = 4
        ((1.0, 0.75, -1.0), E1 + 0.5),  # v_y off by 1/2
        ((0.5, -0.25, -1.0), E2 + 0.5),  # both: the squares add up in one exponential
        ((1.0, 0.25, -0.5), 1 + 0.5 * E1),  # yaw rate off by 1/2
        ((0.5, 0.75, -1.5), E2 + 0.5 * E1),  # all three
    ],
)
def test_eq05_flat(velocity, value):
    """Command (1, 1/4, -1). Each error of 1/2 is a factor 1/e of its term, and v_x and v_y share a
    term.
    """
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
    """Command (1, 1/4, -1). The weights are 1, 0.05, 0.1, and an error of 1/2 is a factor 1/e of
    its own term only.
    """
    assert reward(rewards.rough, velocity, (1.0, 0.25, -1.0)) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize(
    ("velocity", "value"),
    [
        ((2.0, 0.5, 0.0), 2 * E1),
        ((2.0, 0.0, -0.5), 2 * E1),
        ((2.0, 0.5, 0.5), 2 * E2),  # 0.270671
        ((-4.0, -0.5, 0.5), -4 * E2),
    ],
)
def test_eq07_max_velocity(velocity, value):
    """v_x itself, times 1/e for each error of 1/2 in v_y and in the yaw rate. Commands are 0."""
    assert reward(rewards.max_velocity, velocity) == pytest.approx(value, rel=1e-14)


def test_eq07_has_no_command_of_v_x():
    """Commands of v_y and yaw rate are met. The reward is v_x, whatever v_x was asked for."""
    velocity = [[-8, 0.5, -0.25], [0, 0.5, -0.25], [8, 0.5, -0.25]]
    assert reward(rewards.max_velocity, velocity, (3.0, 0.5, -0.25)).tolist() == [-8, 0, 8]


@pytest.mark.parametrize(
    ("velocity", "value"),
    [
        ((0.5, 0.25, -1.0), E1 + 0.5),  # v_x short by 1/2
        ((1.5, 0.75, -1.0), E2 + 0.5),  # v_x and v_y share one exponential
        ((1.0, 0.25, -1.5), 1 + 0.5 * E1),
    ],
)
def test_eq08_curriculum(velocity, value):
    """Command (1, 1/4, -1), as Eq. (5), but an error of +1/2 in v_x costs what one of -1/2 does."""
    found = reward(rewards.curriculum, velocity, (1.0, 0.25, -1.0))
    assert found == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize(
    ("function", "value", "best"),
    [(rewards.flat, 1.5, 1.5), (rewards.rough, 1.15, 1.15), (rewards.curriculum, E1 + 0.5, 1.5)],
)
def test_eq05_eq06_one_sided_eq08_two_sided(function, value, best):
    """v_x = 3/2 for a command of 1, and 1, which earns the most, 1 + 0.5 or 1 + 0.05 + 0.1:

    Eqs. (5) and (6):  min(1/2, 0) = 0 is no error
    Eq. (8):           the error of 1/2 costs 1 - 1/e

    An array of robots has an array of rewards.
    """
    found = reward(function, [[[1.5, 0, 0]], [[1, 0, 0]]], (1.0, 0.0, 0.0))
    assert found == pytest.approx(np.array([[value], [best]]), rel=1e-14)


@pytest.mark.parametrize(
    ("function", "value"),
    [
        (rewards.flat, E2 + 0.5 * E2),
        (rewards.rough, E1 + 0.05 * E1 + 0.1 * E2),
        (rewards.max_velocity, 0.5 * E1 * E2),
        (rewards.curriculum, E2 + 0.5 * E2),
    ],
)
def test_eq05_eq06_eq07_eq08_have_two_sigmas(monkeypatch, function, value):
    """sigma_vxy = 1/4 and, here, sigma_wz = 1/2. v_x is short by 1/2 and v_y off by 1/2, a factor
    1/e each. The yaw rate is off by 1, which costs exp(-1^2 / (1/2)) = 1/e^2.
    """
    monkeypatch.setattr(rewards, "SIGMA_WZ", 0.5)
    found = reward(function, (0.5, 0.5, 1.0), (1.0, 0.0, 0.0))
    assert found == pytest.approx(value, rel=1e-14)


# ---- D25: which velocity ----


def test_velocity_over_ground_and_in_the_body_frame():
    """D25. The robot heads along (0.8, 0.6), has its nose up by 30 degrees, and turns by 1/4 rad/s.

    world:    (0.8, 0.6) + (-0.6, 0.8) / 2 = (0.5, 1) m/s
    heading:  1 m/s ahead, 1/2 m/s to the left, 1/4 rad/s
    body:     cos 30 of the speed ahead and of the yaw rate; the rest looks like falling and rolling
    """
    turned = Rotation.from_euler("ZY", [np.arctan2(0.6, 0.8), -np.pi / 6])
    rates = turned.apply([0.0, 0.0, 0.25], inverse=True)
    qpos = np.array([[0, 0, 1, *turned.as_quat(scalar_first=True), *[0] * 12]])
    motion = go1.motion(qpos, np.array([[0.5, 1.0, 0.0, *rates, *[0] * 12]]))
    cos, sin = 0.75**0.5, 0.5
    assert motion.planar[0] == pytest.approx([1.0, 0.5, 0.25])
    assert motion.linear[0] == pytest.approx([cos, 0.5, -sin], abs=1e-6)
    assert motion.rates[0] == pytest.approx([0.25 * sin, 0, 0.25 * cos])


@pytest.mark.parametrize(("frame", "value"), [("heading", 1.5), ("body", 1.5 * E1)])
def test_a_pitched_robot_is_rewarded_for_what_it_covers(frame, value):
    """Nose up by 60 degrees, 1 m/s and 1 rad/s over ground, as asked: Eq. (5) gives 1.5. In the
    body frame v_x and the yaw rate are cos 60 = 1/2 of it, so both kernels are 1/e. The log has the
    speed over ground in either case.
    """
    env = make(1, velocity_frame=frame, **FROZEN)
    place(env, **NOSE_UP)
    env.state.command[:] = 1.0, 0.0, 1.0
    _, reward, _, _, info = still(env)
    assert reward == pytest.approx([value], abs=1e-4)
    assert info["log"]["v_x"] == pytest.approx([1.0], abs=1e-6)


# ---- V-E: the shaped reward of reference [5] ----


def robot(**changes):
    """Velocity, command and Gait of a robot that does exactly what it should, so that only the two
    tracking terms are not 0.
    """
    ideal = dict(
        velocity=np.zeros(3),
        command=np.zeros(3),
        v_z=0.0,
        roll_pitch_rate=np.zeros(2),
        gravity=np.array([0.0, 0.0, -1.0]),
        torque=np.zeros(12),
        qdd=np.zeros(12),
        height=0.34,
        landed=np.zeros(4),
        collisions=0,
        action_change=np.zeros(12),
        q=np.ones(12),
    )
    batch = {name: np.asarray(x)[None] for name, x in (ideal | changes).items()}
    asked = batch.pop("velocity"), batch.pop("command")
    return *asked, rewards.Gait(**batch, joint_range=np.array([[0.0] * 12, [2.0] * 12]))


AHEAD, SIDEWAYS, TURNING = ([1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0])
LANDED = dict(landed=[0.25, 0.0, 0.5, 0.0])  # s: 0.25 - 0.5 and 0.5 - 0.5


@pytest.mark.parametrize(
    ("changes", "lost"),
    [
        (dict(), 0.0),
        (dict(v_z=0.25), 2 * 0.0625),
        (dict(roll_pitch_rate=[1.0, 2.0]), 0.05 * 5),
        (dict(gravity=[0.25, 0.25, -0.9]), 5 * 0.125),
        (dict(torque=[10.0] * 12), 1e-4 * 1200),
        (dict(qdd=[100.0] * 12), 2.5e-7 * 120000),
        (dict(height=0.24), 30 * 0.01),
        (dict(collisions=1), 1.0),
        (dict(action_change=[1.0] * 12), 0.01 * 12),
        (dict(q=[1.95, 0.08] + [1.9] * 10), 10 * (0.05 + 0.02)),
        (dict(command=TURNING, velocity=[0, 0, 0.5]), 0.5 - 0.5 * E1),
        (dict(command=AHEAD, velocity=[0.5, 0, 0]), 1 - E1),
        (dict(command=SIDEWAYS, velocity=SIDEWAYS) | LANDED, 0.25),
        (dict(command=[0.11, 0, 0], velocity=[0.11, 0, 0]) | LANDED, 0.25),
        # nobody asked for more than 0.1 m/s, so that how long feet are up does not count
        (dict(command=[0.1, 0, 0], velocity=[0.1, 0, 0]) | LANDED, 0.0),
        (dict(command=TURNING, velocity=TURNING) | LANDED, 0.0),
        # 0.25 - 0.5 and 1 - 0.5
        (dict(command=AHEAD, velocity=AHEAD, landed=[0.25, 0.0, 1.0, 0.0]), -0.25),
        (dict(collisions=3), 1.5),  # never below 0
    ],
)
def test_shaped_reward_term_by_term(changes, lost):
    """Reference [5], V-E: 1 + 0.5 for perfect tracking, less what each deviation costs by its
    published weight.
    """
    assert rewards.shaped(*robot(**changes)) == pytest.approx([1.5 - lost])


def test_landings_by_hand():
    """0.5 s a step. A foot that was off for 4 steps lands, and one that bounced for 1 does not.
    One stays up, one down.
    """
    off_ground = np.array([[4, 1, 3, 0]])
    touch = np.array([[True, True, False, True]])
    assert rewards.landings(off_ground, touch, 0.5).tolist() == [[2.0, 0.0, 0.0, 0.0]]
