"""Section IV-A: Eqs. (5) to (8) by hand, the velocity that they mean (D25), and the shaped baseline
of Section V-E.

sigma = 1/4, so that an error of 1/2 costs a factor exp(-(1/2)^2 / (1/4)) = 1/e.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support import FROZEN, make, place, still

import rewards
import shaped

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
    """Command (1, 1/4, -1): each error of 1/2 multiplies its term by 1/e, and v_x and v_y share one
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
    """Command (1, 1/4, -1): weights 1, 0.05, 0.1, and an error of 1/2 multiplies its own term by
    1/e only.
    """
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
    """Commands (3, 1/2, -1/4) met in v_y and yaw rate: the reward is v_x, whatever v_x was asked
    for.
    """
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
    assert reward(rewards.curriculum, velocity, (1.0, 0.25, -1.0)) == pytest.approx(
        value, rel=1e-14
    )


@pytest.mark.parametrize(
    ("function", "value"),
    [(rewards.flat, 1.5), (rewards.rough, 1.15), (rewards.curriculum, E1 + 0.5)],
)
def test_eq05_eq06_one_sided_eq08_two_sided(function, value):
    """v_x = 3/2, command 1: min(1/2, 0) = 0 is no error in Eqs. (5) and (6); in Eq. (8) it costs 1
    - 1/e.
    """
    assert reward(function, (1.5, 0.0, 0.0), (1.0, 0.0, 0.0)) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize(
    ("function", "best"),
    [
        (rewards.flat, 1.5),
        (rewards.rough, 1.15),
        (rewards.max_velocity, np.inf),
        (rewards.curriculum, 1.5),
    ],
)
def test_maximum_and_leading_shape(function, best):
    """1 + 0.5 or 1 + 0.05 + 0.1, reached where the command is met and nowhere exceeded: the scale
    of Fig. 2.

    The environments step as one array: an entry of the result must not depend on the others.
    """
    velocity, command = np.random.default_rng(0).normal(size=(2, 200, 5, 3))
    result = function(velocity, command)
    assert result.shape == (200, 5) and result.max() <= best
    for i in np.ndindex(2, 5):
        assert result[i] == pytest.approx(function(velocity[i], command[i]), rel=1e-14)
    if np.isfinite(best):
        assert function(velocity, velocity) == pytest.approx(best, rel=1e-14)


# ---- D25: which velocity ----


@pytest.mark.parametrize(
    ("frame", "expected"),
    [("heading", (1.0, 0.5, 0.25)), ("body", (0.75**0.5, 0.5, 0.25 * 0.75**0.5))],
)
def test_velocity_over_ground(frame, expected):
    """D25. Heading along (0.8, 0.6), nose up by 30 degrees, yaw 1/4 rad/s; (0.8, 0.6) + (-0.6, 0.8)
    / 2 = (0.5, 1) m/s.

    Over ground that is (1, 1/2) m/s and 1/4 rad/s. In the body's frame cos 30 of the speed ahead
    and of the yaw rate
    are left: the rest looks like falling and rolling.
    """
    env, turned = make(1), Rotation.from_euler("ZY", [np.arctan2(0.6, 0.8), -np.pi / 6])
    rates = turned.apply([0.0, 0.0, 0.25], inverse=True)
    place(env, quaternion=turned.as_quat(scalar_first=True), velocity=(0.5, 1.0, 0.0), rates=rates)
    assert env.tracked_velocity(frame)[0] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(("frame", "value"), [("heading", 1.5), ("body", E1 + 0.5)])
def test_a_pitched_robot_is_rewarded_for_what_it_covers(frame, value):
    """Nose up by 60 degrees, 1 m/s over ground, as asked: Eq. (5) gives 1.5. In the body frame v_x
    is cos 60 = 1/2. The log has the speed over ground, whatever the reward is of.
    """
    env = make(1, frame=frame, **FROZEN)
    place(
        env,
        quaternion=Rotation.from_euler("Y", -60, degrees=True).as_quat(scalar_first=True),
        velocity=(1, 0, 0),
    )
    env.state.command[:] = 1.0, 0.0, 0.0
    _, reward, _, _, info = still(env)
    assert reward == pytest.approx([value], abs=1e-4)
    assert info["log"]["v_x"] == pytest.approx([1.0], abs=1e-6)


@pytest.mark.parametrize(
    ("turn", "expected"), [(("Y", -30), (30, 0)), (("X", 20), (0, 20)), (("Z", 50), (0, 0))]
)
def test_attitude(turn, expected):
    """Nose up is a turn about -y, the right side goes down in one about x, and a heading is
    neither. Degrees.
    """
    env = make(1)
    place(env, quaternion=Rotation.from_euler(*turn, degrees=True).as_quat(scalar_first=True))
    assert env.attitude()[:, 0] == pytest.approx(expected, abs=1e-9)


# ---- V-E: the shaped reward of reference [5] ----


def motion(**changes):
    """A robot that does exactly what it should, in a batch of one: only the two tracking terms are
    not zero.
    """
    still = dict(
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
        q=np.zeros(12),
    )
    batch = {name: np.asarray(x)[None] for name, x in (still | changes).items()}
    return shaped.Motion(**batch, joint_range=np.array([[-1.0] * 12, [1.0] * 12]))


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
        (dict(q=[0.95, -0.92] + [0.9] * 10), 10 * (0.05 + 0.02)),
        (dict(landed=[0.25, 0.0, 0.75, 0.0]), 0.0),  # nobody asked the robot to move
        # 0.25 - 0.5, 0.5 - 0.5
        (dict(command=[1.0, 0, 0], velocity=[1.0, 0, 0], landed=[0.25, 0.0, 0.5, 0.0]), 0.25),
        (dict(command=[0, 1.0, 0], velocity=[0, 1.0, 0], landed=[0.25, 0.0, 0.5, 0.0]), 0.25),
        # turning on the spot
        (dict(command=[0, 0, 1.0], velocity=[0, 0, 1.0], landed=[0.25, 0.0, 0.5, 0.0]), 0.0),
        # not more than 0.1 m/s
        (dict(command=[0.1, 0, 0], velocity=[0.1, 0, 0], landed=[0.25, 0.0, 0.5, 0.0]), 0.0),
        (dict(command=[0.11, 0, 0], velocity=[0.11, 0, 0], landed=[0.25, 0.0, 0.5, 0.0]), 0.25),
        (dict(command=[0, 0, 1.0], velocity=[0, 0, 0.5]), 0.5 - 0.5 * E1),  # 0.25 / 0.25
        (dict(collisions=3), 1.5),  # never below 0
    ],
)
def test_shaped_reward_term_by_term(changes, lost):
    """Reference [5], V-E: 1 + 0.5 for perfect tracking, less what each deviation costs by its
    published weight.
    """
    assert shaped.reward(motion(**changes)) == pytest.approx([1.5 - lost])
    assert list(shaped.terms(motion())) == list(shaped.WEIGHTS)


def test_shaped_reward_of_any_leading_shape():
    """The environments step as one array: an entry of the result must not depend on the others."""
    rng = np.random.default_rng(0)
    ranges = np.array([[-0.5] * 12, [1.0] * 12])
    many = shaped.Motion(*(rng.uniform(size=(2, 3, *x.shape[1:])) for x in motion()[:-1]), ranges)
    for i in np.ndindex(2, 3):
        alone = shaped.terms(shaped.Motion(*(x[i] for x in many[:-1]), ranges))
        for name, term in shaped.terms(many).items():
            assert term.shape == (2, 3) and term[i] == pytest.approx(alone[name], rel=1e-14), name


def test_landings_by_hand():
    """0.5 s a step. A foot that was off for 4 steps lands; one that bounced for 1 does not; one
    stays up, one down.
    """
    off_ground = np.array([[4, 1, 3, 0]])
    touch = np.array([[True, True, False, True]])
    assert shaped.landings(off_ground, touch, 0.5).tolist() == [[2.0, 0.0, 0.0, 0.0]]
    assert off_ground.tolist() == [[0, 0, 4, 0]]
