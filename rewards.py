"""What the robot is asked to do: the task rewards of Section IV-A, Eqs. (5) to (8).

Every function takes

    velocity: (..., 3)  v_x, v_y [m/s] and yaw rate omega_z [rad/s] of the robot
    command:  (..., 3)  what was asked for, in the same order and units

and returns (...,) [-]: the reward r of Eq. (1) for one control step. Any leading batch shape will do.

The paper names no frame for the velocity. The environment passes the heading frame, i.e. speed over ground, unless
`tasks.Config.frame` says otherwise (D25). Rewards are not scaled by the length of a step here (the learner does that,
D10).
"""

import numpy as np
from numpy import exp, minimum, square

SIGMA_VXY = 0.25  # m^2/s^2; not in the paper, the lab's value (D5)
SIGMA_WZ = 0.25  # rad^2/s^2; not in the paper, the lab's value (D5)


def unpack(velocity, command):
    """v_x, v_y, w_z and v_x_cmd, v_y_cmd, w_z_cmd: (...,) [m/s, m/s, rad/s] each."""
    return *np.moveaxis(velocity, -1, 0), *np.moveaxis(command, -1, 0)


def flat(velocity, command):
    """Eq. (5), at most 1.5. The min says that to run faster than asked is no error."""
    v_x, v_y, w_z, v_x_cmd, v_y_cmd, w_z_cmd = unpack(velocity, command)
    return (exp(-(square(minimum(v_x - v_x_cmd, 0)) + square(v_y - v_y_cmd)) / SIGMA_VXY)
            + 0.5 * exp(-square(w_z - w_z_cmd) / SIGMA_WZ))  # fmt: skip


def rough(velocity, command):
    """Eq. (6), at most 1.15."""
    v_x, v_y, w_z, v_x_cmd, v_y_cmd, w_z_cmd = unpack(velocity, command)
    return (exp(-square(minimum(v_x - v_x_cmd, 0)) / SIGMA_VXY)
            + 0.05 * exp(-square(v_y - v_y_cmd) / SIGMA_VXY)
            + 0.1 * exp(-square(w_z - w_z_cmd) / SIGMA_WZ))  # fmt: skip


def max_velocity(velocity, command):
    """Eq. (7), unbounded; negative for a robot that runs backwards. v_x has no command."""
    v_x, v_y, w_z, _, v_y_cmd, w_z_cmd = unpack(velocity, command)
    return v_x * exp(-square(v_y - v_y_cmd) / SIGMA_VXY - square(w_z - w_z_cmd) / SIGMA_WZ)


def kernels(velocity, command):
    """The two exponentials of Eq. (8), of linear and of angular velocity: (...,) [-] in [0, 1] each."""
    v_x, v_y, w_z, v_x_cmd, v_y_cmd, w_z_cmd = unpack(velocity, command)
    linear = exp(-(square(v_x - v_x_cmd) + square(v_y - v_y_cmd)) / SIGMA_VXY)
    return linear, exp(-square(w_z - w_z_cmd) / SIGMA_WZ)


def curriculum(velocity, command):
    """Eq. (8), at most 1.5: Eq. (5) without the min, so that to run too fast is an error as well."""
    linear, angular = kernels(velocity, command)
    return linear + 0.5 * angular
