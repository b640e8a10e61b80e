"""What the robot is asked to do: the task rewards of Section IV-A, Eqs. (5) to (8).

Every function takes

    velocity: (..., 3)  v_x, v_y [m/s] and yaw rate omega_z [rad/s] of the robot
    command:  (..., 3)  v_x, v_y [m/s] and yaw rate [rad/s] that were asked for

with any leading batch shape. `flat`, `rough`, `max_velocity` and `curriculum` return (...,): the
reward r of Eq. (1) for one control step. It has no unit, but that of Eq. (7) is in m/s. The learner
scales it by 0.02 (`eipo.Config.reward_scale`). The paper names no frame of reference for the
velocity. The environment passes the velocity over ground, in the horizontal frame that is turned
with the robot's heading, unless `tasks.Config.frame` says otherwise.
"""

import numpy as np
from numpy import exp, minimum, square

SIGMA_VXY = 0.25  # m^2/s^2, the lab's value; the paper prints none
SIGMA_WZ = 0.25  # rad^2/s^2, the lab's value; the paper prints none


def unpack(velocity, command):
    """v_x, v_y, w_z and v_x_cmd, v_y_cmd, w_z_cmd: (...,) [m/s, m/s, rad/s] each."""
    return *np.moveaxis(velocity, -1, 0), *np.moveaxis(command, -1, 0)


def flat(velocity, command):
    """Eq. (5), at most 1.5. Because of the min it is no error to run faster than asked."""
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
