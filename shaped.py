"""The shaped reward of reference [5], a baseline of Section V-E: two terms for tracking, and ten
for a good gait.

Terms and weights are those of the lab's code. `train.py --reward shaped` trains on it instead
of Eqs. (5) to (8).
"""

from typing import NamedTuple

import numpy as np

import rewards
import terrain
from energy import norm2

WEIGHTS = dict(
    linear=1.0,
    angular=0.5,
    v_z=-2.0,
    roll_pitch_rate=-0.05,
    tilt=-5.0,
    torque=-1e-4,
    qdd=-2.5e-7,
    height=-30.0,
    air_time=1.0,
    collisions=-1.0,
    action_change=-0.01,
    joint_limits=-10.0,
)
HEIGHT = 0.34  # m, of the trunk above the ground
SOFT_LIMIT = 0.9  # share of a joint's range, around its middle, beyond which an angle costs
LEG_CONTACTS = [2, 4, 6, 8, 9, 10, 11, 12]  # sensors of go1.xml: those of thighs and calves
FOOT_CONTACTS = slice(13, 17)  # and those of feet


class Motion(NamedTuple):
    """What the shaped reward looks at. Any leading batch shape will do."""

    velocity: np.ndarray  # (..., 3) v_x, v_y [m/s] and yaw rate [rad/s], as for the task reward
    command: np.ndarray  # (..., 3) the velocity that was asked for
    v_z: np.ndarray  # (...,) [m/s] body velocity upwards
    roll_pitch_rate: np.ndarray  # (..., 2) [rad/s]
    gravity: np.ndarray  # (..., 3) [-] unit vector down, in the body frame
    torque: np.ndarray  # (..., 12) [N m]
    qdd: np.ndarray  # (..., 12) [rad/s^2]
    height: np.ndarray  # (...,) [m] of the trunk above the ground
    landed: np.ndarray  # (..., 4) [s] see `landings`
    collisions: np.ndarray  # (...,) [-] number of thighs and calves that touch the ground
    action_change: np.ndarray  # (..., 12) [-] since the last step
    q: np.ndarray  # (..., 12) [rad]
    joint_range: np.ndarray  # (2, 12) [rad] lower and upper limits


def observe(env, velocity, action_before, qd_before):
    """The Motion of a Go1Env's robots; *_before: (N, 12) action, qd [rad/s] of a step ago."""
    ground = 0.0 if env.ground is None else terrain.height(env.ground, env.qpos[:, :2])
    return Motion(
        velocity=velocity,
        command=env.state.command,
        v_z=env.body_velocity()[:, 2],
        roll_pitch_rate=env.qvel[:, 3:5],
        gravity=env.felt_gravity(),
        torque=env.ctrl,
        qdd=(env.qvel[:, 6:] - qd_before) / env.period,
        height=env.qpos[:, 2] - ground,
        landed=landings(env.state.off_ground, env.contacts[:, FOOT_CONTACTS] > 0, env.period),
        collisions=(env.contacts[:, LEG_CONTACTS] > 0).sum(-1),
        action_change=env.state.action - action_before,
        q=env.qpos[:, 7:],
        joint_range=env.joint_range,
    )


def landings(off_ground, touch, period):
    """How long each foot that lands now was in the air, and 0 for the other feet: (N, 4) [s].

    off_ground: (N, 4) int, control steps since each foot touched the ground. It is updated in place
        and begins as 1
    touch:      (N, 4) bool, which feet are on the ground now
    period:     [s] of a control step
    A foot that is off the ground for one step only, as when it bounces, has not left it [lab code].
    """
    landed = np.where(touch & (off_ground > 1), off_ground * period, 0.0)
    off_ground[:] = np.where(touch, 0, off_ground + 1)
    return landed


def terms(m):
    """The terms of the shaped reward, not weighted: a dict of (...,), in the order of WEIGHTS."""
    linear, angular = rewards.kernels(m.velocity, m.command)
    moving = np.linalg.norm(m.command[..., :2], axis=-1) > 0.1
    middle = m.joint_range.mean(0)
    half = SOFT_LIMIT * np.diff(m.joint_range, axis=0)[0] / 2
    return dict(
        linear=linear,
        angular=angular,
        v_z=m.v_z**2,
        roll_pitch_rate=norm2(m.roll_pitch_rate),
        tilt=norm2(m.gravity[..., :2]),
        torque=norm2(m.torque),
        qdd=norm2(m.qdd),
        height=(m.height - HEIGHT) ** 2,
        air_time=np.where(m.landed > 0, m.landed - 0.5, 0.0).sum(-1) * moving,
        collisions=m.collisions,
        action_change=norm2(m.action_change),
        joint_limits=np.maximum(np.abs(m.q - middle) - half, 0.0).sum(-1),
    )


def reward(m):
    """The shaped reward (...,) [-]: the weighted sum of its terms, at least 0. m: Motion."""
    return np.maximum(sum(WEIGHTS[name] * term for name, term in terms(m).items()), 0.0)
