"""What the robot is asked to do: the task rewards of Section IV-A, Eqs. (5) to (8).

Every function takes

    velocity: (..., 3)  body-frame v_x, v_y [m/s] and yaw rate omega_z [rad/s]
    command:  (..., 3)  what was asked for, in the same order and units

and returns (...,) [-]: the reward r of Eq. (1) for one control step. Any leading batch shape will do.
Rewards are not scaled by the length of a step here (the learner does that, D10).
"""

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


def curriculum(velocity, command):
    """Eq. (8), at most 1.5: Eq. (5) without the min, so that running too fast is an error as well."""
    error = velocity - command
    return tracking(error[..., 0]) * tracking(error[..., 1]) + 0.5 * tracking(error[..., 2])
