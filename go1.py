"""The robot: its model `go1.xml` as MuJoCo gets it, its nominal pose and the kinematics of its legs.

Joints and legs come in the order FR, FL, RR, RL x hip, thigh, calf. The numbers are those of Unitree's URDF.
"""

from pathlib import Path

import mujoco
import numpy as np

import terrain

MODEL = Path(__file__).with_name("go1.xml")
LEGS = ("FR", "FL", "RR", "RL")
Q_NOMINAL = np.array([-0.1, 0.8, -1.5, 0.1, 0.8, -1.5, -0.1, 1.0, -1.5, 0.1, 1.0, -1.5])  # rad, action 0 [lab code]
LINK, HIP_OFFSET, FOOT_RADIUS = 0.213, 0.08, 0.02  # m: thigh and calf length, hip to thigh, sole [URDF]
# Seen in a mirror: right and left legs swap, and a hip angle outwards on one side is inwards on the other (D28)
MIRROR = np.kron(np.kron(np.eye(2), [[0, 1], [1, 0]]), np.diag([-1, 1, 1]))  # (12, 12)
SIDE = np.array([-1.0, 1.0, -1.0, 1.0])  # right legs -1, left legs +1
HIP = np.array([[0.1881, -0.04675, 0], [0.1881, 0.04675, 0], [-0.1881, -0.04675, 0], [-0.1881, 0.04675, 0]])  # m [URDF]


def leg_points(q):
    """Where each leg may touch the ground first: centres of knee and foot in the trunk's frame [m].

    q: (..., 12) [rad] joint angles; returns (..., 8, 3), each the centre of a ball of FOOT_RADIUS. URDF kinematics.
    """
    hip, thigh, calf = np.moveaxis(q.reshape(*q.shape[:-1], 4, 3), -1, 0)
    forward = -LINK * np.stack([np.sin(thigh), np.sin(thigh) + np.sin(thigh + calf)], -1)  # of the hip, knee then foot
    up = -LINK * np.stack([np.cos(thigh), np.cos(thigh) + np.cos(thigh + calf)], -1)
    left = HIP_OFFSET * SIDE[:, None]
    sin, cos = np.sin(hip)[..., None], np.cos(hip)[..., None]
    points = np.stack([forward, left * cos - up * sin, left * sin + up * cos], -1) + HIP[:, None]
    return points.reshape(*q.shape[:-1], 8, 3)


def build_model(timestep, ground):
    """The robot of go1.xml on its plane, or on the height field of a terrain.Ground."""
    spec = mujoco.MjSpec.from_file(str(MODEL))
    spec.option.timestep = timestep
    if ground is not None:
        low, high = ground.heights.min(), ground.heights.max()
        half = (np.array(ground.heights.shape)[::-1] - 1) * terrain.SPACING / 2  # x, y
        spec.add_hfield(name="ground", size=[*half, high - low, 0.1], nrow=ground.heights.shape[0],
                        ncol=ground.heights.shape[1], userdata=ground.heights.ravel())  # fmt: skip
        # A height field is made of prisms. A foot that sinks in too deep is pushed out of one sideways, into the next,
        # and stays stuck: its contacts have to be as stiff as a timestep of 5 ms allows.
        for leg in LEGS:
            spec.geom(f"{leg}_foot").solref = [0.01, 1.0]
        floor = spec.geom("floor")
        floor.type, floor.hfieldname, floor.pos = mujoco.mjtGeom.mjGEOM_HFIELD, "ground", [*half, low]
    return spec.compile()
