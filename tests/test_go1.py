"""go1.xml and go1.py against Unitree's published numbers, and against what the Python side takes
for granted.
"""

import itertools
from math import pi

import mujoco
import numpy as np
import pytest
from support import LEGS, NOMINAL, soles

import go1

JOINTS = [f"{leg}_{part}" for leg in LEGS for part in ("hip", "thigh", "calf")]


@pytest.fixture
def model():
    """The robot on its floor."""
    return mujoco.MjModel.from_xml_path(str(go1.MODEL))


def names(model, kind, count):
    """What MuJoCo calls its `count` objects of a kind, in order; None for a nameless one."""
    return [mujoco.mj_id2name(model, kind, i) for i in range(count)]


def test_numbers_of_the_urdf(model):
    """5.560 + 4 (0.680 + 1.009 + 0.195862) = 13.099448 kg: its links, their 12 rotors included.
    Limits are in force.

    Armature 1.118e-4 * 6.33^2 = 0.00448 and, calf, 1.118e-4 * (6.33 * 1.5)^2 = 0.01008 kg m^2; no
    other joint losses.
    """
    assert model.body_mass.sum() == pytest.approx(13.1, abs=1e-2)
    assert model.jnt_range[1:].tolist() == [[-0.863, 0.863], [-0.686, 4.501], [-2.818, -0.888]] * 4
    assert model.jnt_limited[1:].all()
    assert model.dof_armature[6:] == pytest.approx([0.00448, 0.00448, 0.01008] * 4, rel=0.01)
    assert not model.dof_damping.any() and not model.dof_frictionloss.any()


def test_order_of_joints_and_motors(model):
    """A free trunk, then FR, FL, RR, RL x hip, thigh, calf: actions and observations are laid out
    so.

    Motor i turns joint i with gear 1, so that ctrl is the joint torque of Eq. (9), unlimited by
    MuJoCo.
    """
    assert names(model, mujoco.mjtObj.mjOBJ_JOINT, model.njnt) == [
        "root",
        *(f"{name}_joint" for name in JOINTS),
    ]
    assert model.jnt_qposadr[1:].tolist() == list(range(7, 19))
    assert model.jnt_dofadr[1:].tolist() == list(range(6, 18))
    assert names(model, mujoco.mjtObj.mjOBJ_ACTUATOR, model.nu) == JOINTS
    assert model.actuator_trnid[:, 0].tolist() == list(range(1, 13))
    assert model.actuator_gear[:, 0].tolist() == [1.0] * 12
    assert not model.actuator_ctrllimited.any() and not model.actuator_forcelimited.any()


def test_collisions(model):
    """The trunk and each leg's hip, thigh, calf and foot, 1 + 4 * 4 = 17, meet the floor, and
    nothing else meets.

    condim 3, one normal and two tangents, and friction 0.6 or more: without it a policy slides on
    its hips.
    """
    ctype, caffinity = model.geom_contype, model.geom_conaffinity
    pairs = itertools.combinations(range(model.ngeom), 2)
    meeting = [(i, j) for i, j in pairs if ctype[i] & caffinity[j] or ctype[j] & caffinity[i]]
    touching = [
        "trunk",
        *(f"{leg}_{part}" for leg in LEGS for part in ("hip", "thigh", "calf", "foot")),
    ]
    assert [(model.geom(i).name, model.geom(j).name) for i, j in meeting] == [
        ("floor", name) for name in touching
    ]
    solid = ctype + caffinity > 0
    assert (model.geom_condim[solid] == 3).all() and (model.geom_friction[solid, 0] >= 0.6).all()


def test_contact_with_the_floor_has_the_friction_of_the_foot(model):
    """The environment randomises the feet's friction: the floor's must not win over it."""
    data = mujoco.MjData(model)
    model.geom_friction[[model.geom(f"{leg}_foot").id for leg in LEGS], 0] = 0.625
    data.qpos[2] = 0.44  # legs straight, soles 6 mm under the floor
    mujoco.mj_forward(model, data)
    feet = [contact for contact in data.contact if model.geom(contact.geom2).name.endswith("_foot")]
    assert [contact.friction[0] for contact in feet] == [0.625] * 4


@pytest.mark.parametrize(
    ("height", "quaternion", "fallen"),
    [
        (0.44, (1, 0, 0, 0), []),
        (0.41, (1, 0, 0, 0), [f"{leg}_calf" for leg in LEGS]),
        (0.21, (1, 0, 0, 0), [f"{leg}_{part}" for leg in LEGS for part in ("thigh", "calf")]),
        (0.056, (0, 1, 0, 0), ["trunk"]),
        (0.145, (0.5**0.5, 0.5**0.5, 0, 0), ["FR_hip", "RR_hip"]),
    ],
    ids=["standing", "shins", "kneeling", "back", "side"],
)
def test_contact_sensors(model, height, quaternion, fallen):
    """D13. Legs straight: soles 0.446 m down, shins 0.413 m, thighs 0.217 m, the trunk 0.057 m;
    hips 0.147 m aside.

    The order: nine that end every episode, the calves, which some tasks let touch the ground, and
        the feet.
    """
    assert [model.sensor(i).name.split("_")[1] for i in range(9, 17)] == ["calf"] * 4 + ["foot"] * 4
    data = mujoco.MjData(model)
    data.qpos[2], data.qpos[3:7] = height, quaternion
    mujoco.mj_forward(model, data)
    found = {model.sensor(i).name: data.sensordata[model.sensor(i).adr[0]] for i in range(13)}
    assert {name.removesuffix("_contact") for name, n in found.items() if n} == set(fallen)


def test_home(model):
    """The keyframe for the viewer: the nominal pose, its front soles on the floor."""
    home = model.key("home").qpos
    assert home[7:].tolist() == NOMINAL.tolist() == go1.Q_NOMINAL.tolist()
    assert soles(home).min() == pytest.approx(0.0, abs=1e-3)


# ---- kinematics ----


def lowest(q):
    """Height of the lowest point of each leg relative to the trunk [m], from the centres of knee
    and foot.
    """
    return go1.leg_points(q)[..., 2].reshape(*q.shape[:-1], 4, 2).min(-1) - 0.02


@pytest.mark.parametrize(
    ("hip", "thigh", "calf", "right", "left"),
    [
        (0, 0, 0, -0.446, -0.446),  # straight: -0.213 - 0.213 - 0.02
        (0, pi / 2, -pi / 2, -0.233, -0.233),  # thigh horizontal, calf down: -0.213 - 0.02
        (0, pi / 3, -2 * pi / 3, -0.233, -0.233),  # -0.213 (1/2 + 1/2) - 0.02
        # legs out to the left: the hip's 0.08 is down on the right, up on the left
        (pi / 2, 0, 0, -0.1, 0.06),
        # thigh straight down, shin straight up: the knee is lowest, 0.213 + 0.02
        (0, 0, -pi, -0.233, -0.233),
    ],
)
def test_leg_heights_by_hand(hip, thigh, calf, right, left):
    """Links of 0.213 m, 0.08 m from hip to thigh, soles of 0.02 m; order FR, FL, RR, RL."""
    heights = lowest(np.tile([hip, thigh, calf], 4).astype(float))
    assert heights == pytest.approx([right, left, right, left], abs=1e-12)


def test_leg_heights_are_those_of_the_model():
    """The formula and go1.xml are the same robot: twelve joint angles at random, shins pointing
    down, any shape.
    """
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (2, 3, 12))
    q[..., 1::3], q[..., 2::3] = abs(q[..., 1::3]), -abs(q[..., 2::3])
    heights = lowest(q)
    assert heights.shape == (2, 3, 4)
    for i in np.ndindex(2, 3):
        assert heights[i] == pytest.approx(soles([0, 0, 0, 1, 0, 0, 0, *q[i]]), abs=1e-12)
