"""What the robot is asked to do: the task rewards of Section IV-A, Eqs. (5) to (8), and the shaped
reward of Section V-E.

The functions of the equations take

    velocity: (..., 3)  v_x, v_y [m/s] and yaw rate omega_z [rad/s] of the robot
    command:  (..., 3)  v_x, v_y [m/s] and yaw rate [rad/s] that were asked for

with any leading batch shape. `flat`, `rough`, `max_velocity` and `curriculum` return (...,): the
reward r of Eq. (1) for one control step. It has no unit, except that of Eq. (7), in m/s. The
learner scales it by 0.02 (`eipo.Config.reward_scale`). The environment passes the velocity over
ground, in the horizontal frame that is turned with the robot's heading, unless
`tasks.Config.velocity_frame` says otherwise (D25).
"""

from typing import NamedTuple

import numpy as np
from numpy import exp, minimum, square

from energy import norm2

SIGMA_VXY = 0.25  # m^2/s^2 (D5)
SIGMA_WZ = 0.25  # rad^2/s^2 (D5)


def unpack(velocity, command):
    """v_x, v_y, w_z and v_x_cmd, v_y_cmd, w_z_cmd: (...,) [m/s, m/s, rad/s] each."""
    return *np.moveaxis(velocity, -1, 0), *np.moveaxis(command, -1, 0)


def flat(velocity, command):
    """Eq. (5), at most 1.5. Because of the min, running faster than asked costs nothing."""
    v_x, v_y, w_z, v_x_cmd, v_y_cmd, w_z_cmd = unpack(velocity, command)
    linear = exp(-(square(minimum(v_x - v_x_cmd, 0)) + square(v_y - v_y_cmd)) / SIGMA_VXY)
    return linear + 0.5 * exp(-square(w_z - w_z_cmd) / SIGMA_WZ)


def rough(velocity, command):
    """Eq. (6), at most 1.15."""
    v_x, v_y, w_z, v_x_cmd, v_y_cmd, w_z_cmd = unpack(velocity, command)
    return (
        exp(-square(minimum(v_x - v_x_cmd, 0)) / SIGMA_VXY)
        + 0.05 * exp(-square(v_y - v_y_cmd) / SIGMA_VXY)
        + 0.1 * exp(-square(w_z - w_z_cmd) / SIGMA_WZ)
    )


def max_velocity(velocity, command):
    """Eq. (7) [m/s]. It has no bound, is negative backwards, and takes no command of v_x."""
    v_x, v_y, w_z, _, v_y_cmd, w_z_cmd = unpack(velocity, command)
    return v_x * exp(-square(v_y - v_y_cmd) / SIGMA_VXY - square(w_z - w_z_cmd) / SIGMA_WZ)


def kernels(velocity, command):
    """The exponentials of Eq. (8), of linear and of angular velocity: (...,) in [0, 1] each."""
    v_x, v_y, w_z, v_x_cmd, v_y_cmd, w_z_cmd = unpack(velocity, command)
    linear = exp(-(square(v_x - v_x_cmd) + square(v_y - v_y_cmd)) / SIGMA_VXY)
    return linear, exp(-square(w_z - w_z_cmd) / SIGMA_WZ)


def curriculum(velocity, command):
    """Eq. (8), at most 1.5: Eq. (5) without the min, so it is an error to run too fast as well."""
    linear, angular = kernels(velocity, command)
    return linear + 0.5 * angular


# ---- the baseline of Section V-E ----

# Weights of the shaped reward of [5], two terms for tracking and ten for a good gait (D5).
# `train.py --task curriculum --algo ppo --lam 0 --reward shaped` is this baseline.
SHAPED = dict(
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


class Gait(NamedTuple):
    """What the shaped reward looks at, beside velocity and command, at the end of a step."""

    v_z: np.ndarray  # (...,) [m/s] of the trunk, along its own z axis
    roll_pitch_rate: np.ndarray  # (..., 2) [rad/s]
    gravity: np.ndarray  # (..., 3) [-] unit vector along gravity, in the trunk's frame
    height: np.ndarray  # (...,) [m] of the trunk above the ground
    q: np.ndarray  # (..., 12) [rad] of the joints
    joint_range: np.ndarray  # (2, 12) [rad] lower and upper limits of the joints
    qdd: np.ndarray  # (..., 12) [rad/s^2] of the joints, mean over the step
    torque: np.ndarray  # (..., 12) [N m] of the joints, in the last physics step
    action_change: np.ndarray  # (..., 12) [-] since the last step
    landed: np.ndarray  # (..., 4) [s] how long feet that land now were in the air, see `landings`
    collisions: np.ndarray  # (...,) [-] number of thighs and calves that touch the ground


def shaped(velocity, command, gait):
    """The shaped reward (...,) [-]: the sum of its terms, weighted by SHAPED, at least 0.

    gait: a Gait
    """

    linear, angular = kernels(velocity, command)
    moving = np.linalg.norm(command[..., :2], axis=-1) > 0.1  # m/s
    middle = gait.joint_range.mean(0)
    half = SOFT_LIMIT * np.diff(gait.joint_range, axis=0)[0] / 2
    terms = dict(
        linear=linear,
        angular=angular,
        v_z=gait.v_z**2,
        roll_pitch_rate=norm2(gait.roll_pitch_rate),
        tilt=norm2(gait.gravity[..., :2]),
        torque=norm2(gait.torque),
        qdd=norm2(gait.qdd),
        height=(gait.height - HEIGHT) ** 2,
        air_time=np.where(gait.landed > 0, gait.landed - 0.5, 0.0).sum(-1) * moving,
        collisions=gait.collisions,
        action_change=norm2(gait.action_change),
        joint_limits=np.maximum(np.abs(gait.q - middle) - half, 0.0).sum(-1),
    )
    return np.maximum(sum(weight * terms[name] for name, weight in SHAPED.items()), 0.0)


def landings(off_ground, touch, dt):
    """How long each foot that lands now was in the air, and 0 for the other feet: (N, 4) [s].

    off_ground: (N, 4) int, control steps since each foot touched the ground, before this step
    touch:      (N, 4) bool, which feet are on the ground now
    dt:         [s] of a control step
    A foot that is off the ground for one step only, as when it bounces, has not left it [lab code].
    """
    return np.where(touch & (off_ground > 1), off_ground * dt, 0.0)
