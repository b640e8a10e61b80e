"""The robot: its model `go1.xml` as MuJoCo gets it, nominal pose, kinematics, motors.

Legs come in the order front right, front left, rear right, rear left (FR, FL, RR, RL) and the
joints of each as hip, thigh, calf, so arrays over the joints are (..., 12). Each number has its
source beside it: Unitree's URDF, a section of the paper, or the lab's code. `go1_env.py` calls the
functions of the motors before every physics step, so that the torque in Eq. (9) is the torque that
was applied.
"""

import functools
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

import terrain

MODEL = Path(__file__).with_name("go1.xml")
LEGS = ("FR", "FL", "RR", "RL")
# which of go1.xml's 17 contact sensors, of trunk, hips and thighs (9), calves (4) and feet (4)
TRUNK_TO_THIGHS, ALL_BUT_FEET, FEET = slice(9), slice(13), slice(13, 17)
THIGHS_AND_CALVES = [2, 4, 6, 8, 9, 10, 11, 12]
# rad, the joint angles of action 0, in which the robot stands [lab code]
Q_NOMINAL = np.array([-0.1, 0.8, -1.5, 0.1, 0.8, -1.5, -0.1, 1.0, -1.5, 0.1, 1.0, -1.5])
LINK = 0.213  # m, length of the thigh and of the calf [URDF]
HIP_OFFSET = 0.08  # m, from the hip joint sideways to the thigh [URDF]
FOOT_RADIUS = 0.02  # m [URDF]
# (index, sign): angle i of the mirrored robot's joints is sign[i] q[index[i]]. Right and left legs
# swap, hip angles change their sign
MIRROR = np.array([3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]), np.tile([-1, 1, 1], 4)
SIDE = np.array([-1.0, 1.0, -1.0, 1.0])  # right legs -1, left legs +1
# m, where the hip joints are in the trunk's frame [URDF]
HIP = np.array(
    [[0.1881, -0.04675, 0], [0.1881, 0.04675, 0], [-0.1881, -0.04675, 0], [-0.1881, 0.04675, 0]]
)
ACTION_SCALE = 0.25 * np.tile([0.5, 1.0, 1.0], 4)  # rad per unit of action [lab code]
KP = 20.0  # N m / rad, Section IV-C
KD = 0.5  # N m s / rad, Section IV-C
TORQUE_LIMIT = np.tile([23.7, 23.7, 35.55], 4)  # N m, "effort" in the Go1's URDF
# rad/s, "velocity" in the Go1's URDF, qd_max of Section V-D
VELOCITY_LIMIT = np.tile([30.1, 30.1, 20.06], 4)
STALL_TORQUE = 33.0  # N m, Section V-D


# ---- the model ----


@functools.cache
def _read(path):
    # A process reads go1.xml once, as it does this file: an edit does not reach a run on its way.
    return mujoco.MjSpec.from_file(str(path))


def build_model(timestep, ground, looks=True):
    """The MuJoCo model of the robot in go1.xml on a ground; timestep: [s] of the physics.

    ground: heights (ny, nx) [m] as terrain.make_ground returns them, or None for a plane
    looks: keep the geoms that touch nothing and are only drawn. Physics without them is the same to
        the bit, and 10 % faster.
    """
    spec = _read(MODEL).copy()
    spec.option.timestep = timestep
    spec.compiler.discardvisual = not looks
    if ground is None:
        return spec.compile()
    low, high = ground.min(), ground.max()
    half = (np.array(ground.shape)[::-1] - 1) * terrain.SPACING / 2  # x, y
    spec.add_hfield(
        name="ground",
        size=[*half, high - low, 0.1],
        nrow=ground.shape[0],
        ncol=ground.shape[1],
        userdata=ground.ravel(),
    )
    # A height field is made of prisms. A foot that sinks in too deep is pushed out of one prism
    # sideways into the next and stays stuck. So the feet's contacts are as stiff as a timestep of
    # 5 ms allows (D12).
    for leg in LEGS:
        spec.geom(f"{leg}_foot").solref = [0.01, 1.0]
    floor = spec.geom("floor")
    floor.type = mujoco.mjtGeom.mjGEOM_HFIELD
    floor.hfieldname = "ground"
    floor.pos = [*half, low]
    return spec.compile()


# ---- kinematics ----


class Motion(NamedTuple):
    """How N trunks lie and move, computed once in a control step."""

    to_world: np.ndarray  # (N, 3, 3) rotation from the trunk's frame to the world's
    linear: np.ndarray  # (N, 3) [m/s] velocity in the trunk's frame
    planar: np.ndarray  # (N, 3) v_x, v_y [m/s], yaw rate [rad/s], level, turned with the robot
    rates: np.ndarray  # (N, 3) [rad/s] angular velocity in the trunk's frame


def motion(qpos, qvel):
    """The Motion of robots with qpos (N, 19) and qvel (N, 18), as MuJoCo has them."""
    to_world = Rotation.from_quat(qpos[:, 3:7], scalar_first=True).as_matrix()
    rates = qvel[:, 3:6].copy()
    linear = np.einsum("nij,ni->nj", to_world, qvel[:, :3])
    yaw = np.arctan2(to_world[:, 1, 0], to_world[:, 0, 0])
    sin, cos = np.sin(yaw), np.cos(yaw)
    x, y = qvel[:, :2].T
    yaw_rate = (to_world[:, 2] * rates).sum(1)
    planar = np.column_stack([cos * x + sin * y, cos * y - sin * x, yaw_rate])
    return Motion(to_world, linear.astype(np.float32), planar, rates)


def felt_gravity(to_world, gravity):
    """Unit vectors (N, 3) along gravity (N, 3) in the frames of trunks with to_world (N, 3, 3)."""
    down = gravity / np.linalg.norm(gravity, axis=-1, keepdims=True)
    return np.einsum("nij,ni->nj", to_world, down)


def leg_points(q):
    """The centres (..., 8, 3) [m] of each leg's knee and foot, where it may touch the ground first.

    q: (..., 12) [rad] joint angles. The points are in the trunk's frame. A foot is a ball of
        FOOT_RADIUS; a knee is thinner, by 3 to 16 mm. MuJoCo's `Batch.forward` finds the same
        points, four times more slowly.
    """
    hip, thigh, calf = np.moveaxis(q.reshape(*q.shape[:-1], 4, 3), -1, 0)
    # from the hip, in its frame: of the knee, then of the foot
    forward = -LINK * np.stack([np.sin(thigh), np.sin(thigh) + np.sin(thigh + calf)], -1)
    up = -LINK * np.stack([np.cos(thigh), np.cos(thigh) + np.cos(thigh + calf)], -1)
    left = HIP_OFFSET * SIDE[:, None]
    sin, cos = np.sin(hip)[..., None], np.cos(hip)[..., None]
    points = np.stack([forward, left * cos - up * sin, left * sin + up * cos], -1) + HIP[:, None]
    return points.reshape(*q.shape[:-1], 8, 3)


# ---- the motors, from joint targets to joint torques, (..., 12) each: [rad], [rad/s], [N m] ----


def pd_torque(target, q, qd):
    """Torque of the PD controller [N m]: kp (target - q) - kd qd, not limited yet. IV-C."""
    return KP * (target - q) - KD * qd


def motor_model(target, q, qd):
    """Torque of the Go1's real motors, which are not ideal PD controllers [N m]. Section IV-A.4.

    Deviation D11: the paper does not say which network it is. This function and the torque-speed
    limit after it approximate the lab's published one for position errors below about 0.5 rad. It
    is a PD controller with 0.2 N m s / rad more damping. That network saturates earlier, at 18 N m
    for 1 rad. A network can take the place of this function.
    """
    return KP * (target - q) - (KD + 0.2) * qd


def torque_speed_limit(qd):
    """Largest torque at speed qd [N m]. Section V-D: tau_max = 33 (qd_max - |qd|) / qd_max.

    Deviation D7: the limit is never below 0. As printed it turns negative beyond qd_max.
    """
    return STALL_TORQUE * np.maximum(VELOCITY_LIMIT - np.abs(qd), 0.0) / VELOCITY_LIMIT


def limit_torque(torque, qd, torque_speed=False):
    """Clip a torque to what the motors can give [N m].

    torque_speed: apply the limit of Section V-D, too
    """
    limit = np.minimum(torque_speed_limit(qd), TORQUE_LIMIT) if torque_speed else TORQUE_LIMIT
    return np.clip(torque, -limit, limit)
