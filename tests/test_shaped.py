"""The shaped reward of reference [5], a baseline of Section V-E: each term by hand, and the landings of feet."""

from math import e

import numpy as np
import pytest

import shaped


def motion(**changes):
    """A robot that does exactly what it should, in a batch of one: only the two tracking terms are not zero."""
    still = dict(velocity=np.zeros(3), command=np.zeros(3), v_z=0.0, roll_pitch_rate=np.zeros(2),
                 gravity=np.array([0.0, 0.0, -1.0]), torque=np.zeros(12), qdd=np.zeros(12), height=0.34,
                 landed=np.zeros(4), collisions=0, action_change=np.zeros(12), q=np.zeros(12))  # fmt: skip
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
        (dict(command=[1.0, 0, 0], velocity=[1.0, 0, 0], landed=[0.25, 0.0, 0.5, 0.0]), 0.25),  # 0.25 - 0.5, 0.5 - 0.5
        (dict(command=[0, 0, 1.0], velocity=[0, 0, 0.5]), 0.5 - 0.5 / e),  # 0.25 / 0.25
        (dict(collisions=3), 1.5),  # never below 0
    ],
)
def test_shaped_reward_term_by_term(changes, lost):
    """Reference [5], V-E: 1 + 0.5 for perfect tracking, less what each deviation costs by its published weight."""
    assert shaped.reward(motion(**changes)) == pytest.approx([1.5 - lost])


def test_shaped_terms_have_their_weights():
    assert list(shaped.terms(motion())) == list(shaped.WEIGHTS)


def test_landings_by_hand():
    """0.5 s a step. A foot that was off for 4 steps lands; one that bounced for 1 does not; one stays up, one down."""
    off_ground = np.array([[4, 1, 3, 0]])
    touch = np.array([[True, True, False, True]])
    assert shaped.landings(off_ground, touch, 0.5).tolist() == [[2.0, 0.0, 0.0, 0.0]]
    assert off_ground.tolist() == [[0, 0, 4, 0]]
