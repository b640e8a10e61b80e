"""From a joint target to a joint torque: the PD controller and the limits of the Go1's motors.

Sections IV-C (gains) and V-D (torque-speed limit). Called before every physics step, so that the torque in
Eq. (9) is the torque that was applied. Arrays are (..., 12), joints in the order FR, FL, RR, RL x hip, thigh, calf.
"""

import numpy as np

KP, KD = 20.0, 0.5  # N m / rad and N m s / rad, Section IV-C
TORQUE_LIMIT = np.tile([23.7, 23.7, 35.55], 4)  # N m, "effort" in the Go1's URDF
VELOCITY_LIMIT = np.tile([30.1, 30.1, 20.06], 4)  # rad/s, "velocity" in the Go1's URDF, qd_max of Section V-D
STALL_TORQUE = 33.0  # N m, Section V-D


def pd_torque(target, q, qd):
    """Torque of the PD controller [N m]: kp (target - q) - kd qd. Section IV-C.

    target, q: (..., 12) [rad], qd: (..., 12) [rad/s]; returns (..., 12) [N m], not limited yet.
    """
    return KP * (target - q) - KD * qd


def motor_model(target, q, qd):
    """Torque of the Go1's real motors, which are not ideal PD controllers [N m]. Section IV-A.4.

    target, q: (..., 12) [rad], qd: (..., 12) [rad/s]; returns (..., 12) [N m], not limited yet.
    Deviation D11: the paper's network is not public. This approximates the lab's published one, for errors below about
    0.5 rad: a PD controller with 0.2 more damping, and the torque-speed limit. The network saturates earlier, at 18 N m
    for 1 rad. A network can take the place of this function.
    """
    return KP * (target - q) - (KD + 0.2) * qd


def torque_speed_limit(qd, qd_max=VELOCITY_LIMIT):
    """Largest torque at speed qd [N m]. Section V-D: tau_max = 33 (qd_max - |qd|) / qd_max.

    qd, qd_max: (..., 12) [rad/s]; returns (..., 12) [N m].
    Deviation D7: never below 0. As printed the limit turns negative, i.e. meaningless, beyond qd_max.
    """
    return STALL_TORQUE * np.maximum(qd_max - np.abs(qd), 0.0) / qd_max


def limit_torque(torque, qd, torque_speed=False):
    """Clip a torque to what the motors can give [N m].

    torque:       (..., 12) [N m], qd: (..., 12) [rad/s]
    torque_speed: apply the limit of Section V-D before that of the URDF
    returns       (..., 12) [N m]
    """
    limit = np.minimum(torque_speed_limit(qd), TORQUE_LIMIT) if torque_speed else TORQUE_LIMIT
    return np.clip(torque, -limit, limit)
