"""What the robot is asked to do: the task rewards of Section IV-A, Eqs. (5) to (8).

Every function takes

    velocity: (..., 3)  body-frame v_x, v_y [m/s] and yaw rate omega_z [rad/s]
    command:  (..., 3)  what was asked for, in the same order and units

and returns (...,) [-]: the reward r of Eq. (1) for one control step. Any leading batch shape will do.
Rewards are not scaled by the length of a step here (the learner does that, D10).
"""

from typing import NamedTuple

import numpy as np

SIGMA = 0.25  # sigma_vxy [m^2/s^2] and sigma_wz [rad^2/s^2]; not in the paper, the lab's value (D5)


def tracking(error, sigma=SIGMA):
    """The kernel that Eqs. (5) to (8) share: exp(-|error|^2 / sigma), 1 at no error. error: any shape."""
    return np.exp(-np.square(error) / sigma)


def shortfall(velocity, command):
    """min(v_x - v_x_cmd, 0) [m/s] of Eqs. (5) and (6): running faster than asked is no error. Shape (...,)."""
    return np.minimum(velocity[..., 0] - command[..., 0], 0.0)


def flat(velocity, command):
    """Eq. (5), at most 1.5: exp{-(|min(v_x-v_x*,0)|^2 + |v_y-v_y*|^2)/sigma} + 0.5 exp{-|w-w*|^2/sigma}."""
    error = velocity - command
    # exp(-(a + b)) = exp(-a) exp(-b): the two linear errors share one exponential
    return tracking(shortfall(velocity, command)) * tracking(error[..., 1]) + 0.5 * tracking(error[..., 2])


def rough(velocity, command):
    """Eq. (6), at most 1.15: the three errors of Eq. (5) in three terms, weighted 1, 0.05 and 0.1."""
    error = velocity - command
    return tracking(shortfall(velocity, command)) + 0.05 * tracking(error[..., 1]) + 0.1 * tracking(error[..., 2])


def max_velocity(velocity, command):
    """Eq. (7), unbounded: v_x exp{-|v_y-v_y*|^2/sigma - |w-w*|^2/sigma}. Negative when running backwards."""
    error = velocity - command
    return velocity[..., 0] * tracking(error[..., 1]) * tracking(error[..., 2])


def kernels(velocity, command):
    """The two parts of Eq. (8): of linear and of angular velocity, (...,) in [0, 1] each."""
    error = velocity - command
    return tracking(error[..., 0]) * tracking(error[..., 1]), tracking(error[..., 2])


def curriculum(velocity, command):
    """Eq. (8), at most 1.5: Eq. (5) without the min, so that running too fast is an error as well."""
    linear, angular = kernels(velocity, command)
    return linear + 0.5 * angular


# ---- the shaped reward of reference [5], a baseline of Section V-E [lab code] ----

SHAPED = dict(linear=1.0, angular=0.5, v_z=-2.0, roll_pitch_rate=-0.05, tilt=-5.0, torque=-1e-4, qdd=-2.5e-7,
              height=-30.0, air_time=1.0, collisions=-1.0, action_change=-0.01, joint_limits=-10.0)  # fmt: skip
HEIGHT = 0.34  # m, of the trunk above the ground
SOFT_LIMIT = 0.9  # of a joint's range; going beyond costs


class Motion(NamedTuple):
    """What the shaped reward looks at, any leading batch shape."""

    velocity: np.ndarray  # (..., 3) body v_x, v_y [m/s] and yaw rate [rad/s]
    command: np.ndarray  # (..., 3) the same, as asked for
    v_z: np.ndarray  # (...,) [m/s] body velocity upwards
    roll_pitch_rate: np.ndarray  # (..., 2) [rad/s]
    gravity: np.ndarray  # (..., 3) [-] unit vector down, in the body frame
    torque: np.ndarray  # (..., 12) [N m]
    qdd: np.ndarray  # (..., 12) [rad/s^2]
    height: np.ndarray  # (...,) [m] of the trunk above the ground
    landed: np.ndarray  # (..., 4) [s] how long a foot that lands now was in the air, 0 for the others
    collisions: np.ndarray  # (...,) [-] parts of the legs on the ground, feet apart
    action_change: np.ndarray  # (..., 12) [-] since the last step
    q: np.ndarray  # (..., 12) [rad]
    joint_range: np.ndarray  # (2, 12) [rad] lower and upper limits


def shaped_terms(m):
    """The terms of the shaped reward before their weights, (...,) each, as a dict in the order of SHAPED. m: Motion."""
    norm2 = lambda x: np.square(x).sum(-1)  # noqa: E731
    linear, angular = kernels(m.velocity, m.command)
    moving = np.linalg.norm(m.command[..., :2], axis=-1) > 0.1
    middle, half = m.joint_range.mean(0), SOFT_LIMIT * np.diff(m.joint_range, axis=0)[0] / 2
    return dict(
        linear=linear, angular=angular, v_z=m.v_z**2, roll_pitch_rate=norm2(m.roll_pitch_rate),
        tilt=norm2(m.gravity[..., :2]), torque=norm2(m.torque), qdd=norm2(m.qdd), height=(m.height - HEIGHT) ** 2,
        air_time=np.where(m.landed > 0, m.landed - 0.5, 0.0).sum(-1) * moving, collisions=m.collisions,
        action_change=norm2(m.action_change),
        joint_limits=np.maximum(np.abs(m.q - middle) - half, 0.0).sum(-1))  # fmt: skip


def shaped(m):
    """The shaped reward (...,) [-]: the weighted sum of its terms, at least 0. m: Motion."""
    return np.maximum(sum(SHAPED[name] * term for name, term in shaped_terms(m).items()), 0.0)
