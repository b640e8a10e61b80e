"""go1.xml and go1.py against Unitree's published numbers, and against what the Python side takes
for granted.
"""

import itertools
from math import pi

import mujoco
import numpy as np
import pytest
from support import LEGS, NOMINAL, ON_ITS_BACK, ON_ITS_SIDE, UPRIGHT, soles

import go1

JOINTS = [f"{leg}_{part}" for leg in LEGS for part in ("hip", "thigh", "calf")]


def of_legs(*parts):
    """The names of these parts of each leg."""
    return [f"{leg}_{part}" for leg in LEGS for part in parts]


@pytest.fixture
def model():
    """The robot on its floor."""
    return mujoco.MjModel.from_xml_path(str(go1.MODEL))


def test_numbers_of_the_urdf(model):
    """Links with their 12 rotors, limits that are in force, and armature but no other joint losses:

    5.560 + 4 (0.680 + 1.009 + 0.195862)  = 13.099448 kg
    hip, thigh   1.118e-4 * 6.33^2        = 0.00448 kg m^2
    calf         1.118e-4 (6.33 * 1.5)^2  = 0.01008 kg m^2
    """
    assert model.body_mass.sum() == pytest.approx(13.1, abs=1e-2)
    assert model.jnt_range[1:].tolist() == [[-0.863, 0.863], [-0.686, 4.501], [-2.818, -0.888]] * 4
    assert model.jnt_limited[1:].all()
    assert model.dof_armature[6:] == pytest.approx([0.00448, 0.00448, 0.01008] * 4, rel=0.01)
    assert not model.dof_damping.any() and not model.dof_frictionloss.any()


def test_order_of_joints_and_motors(model):
    """A free trunk, then FR, FL, RR, RL x hip, thigh, calf, as in actions and observations.

    Motor i turns joint i with gear 1, so that ctrl is the joint torque of Eq. (9), and MuJoCo does
    not limit it.
    """
    joints = [model.joint(i).name for i in range(model.njnt)]
    assert joints == ["root", *(f"{name}_joint" for name in JOINTS)]
    assert model.jnt_qposadr[1:].tolist() == list(range(7, 19))
    assert model.jnt_dofadr[1:].tolist() == list(range(6, 18))
    assert [model.actuator(i).name for i in range(model.nu)] == JOINTS
    assert model.actuator_trnid[:, 0].tolist() == list(range(1, 13))
    assert model.actuator_gear[:, 0].tolist() == [1.0] * 12
    assert not model.actuator_ctrllimited.any() and not model.actuator_forcelimited.any()


def test_collisions(model):
    """The trunk and each leg's hip, thigh, calf and foot meet the floor, and nothing else meets.

    condim 3, one normal and two tangents, and friction 0.6 or more: without it a policy slides on
    its hips.
    """
    ctype, caffinity = model.geom_contype, model.geom_conaffinity
    pairs = itertools.combinations(range(model.ngeom), 2)
    meeting = [(i, j) for i, j in pairs if ctype[i] & caffinity[j] or ctype[j] & caffinity[i]]
    touching = ["trunk", *of_legs("hip", "thigh", "calf", "foot")]
    names = [(model.geom(i).name, model.geom(j).name) for i, j in meeting]
    assert names == [("floor", name) for name in touching]
    solid = ctype + caffinity > 0
    assert (model.geom_condim[solid] == 3).all() and (model.geom_friction[solid, 0] >= 0.6).all()


def test_contact_with_the_floor_has_the_friction_of_the_foot(model):
    """The environment draws the friction of the feet, over which the floor's must not win."""
    data = mujoco.MjData(model)
    model.geom_friction[[model.geom(name).id for name in of_legs("foot")], 0] = 0.625
    data.qpos[2] = 0.44  # legs straight, soles 6 mm under the floor
    mujoco.mj_forward(model, data)
    feet = [contact for contact in data.contact if model.geom(contact.geom2).name.endswith("_foot")]
    assert [contact.friction[0] for contact in feet] == [0.625] * 4


@pytest.mark.parametrize(
    ("height", "quaternion", "fallen"),
    [
        (0.44, UPRIGHT, []),
        (0.41, UPRIGHT, of_legs("calf")),
        (0.21, UPRIGHT, of_legs("thigh", "calf")),
        (0.056, ON_ITS_BACK, ["trunk"]),
        (0.145, ON_ITS_SIDE, ["FR_hip", "RR_hip"]),
    ],
    ids=["standing", "shins", "kneeling", "back", "side"],
)
def test_contact_sensors(model, height, quaternion, fallen):
    """D13. Legs straight: soles 0.446 m down, shins 0.413, thighs 0.217, trunk 0.057, and hips
    0.147 m aside.

    Nine sensors end every episode, then come the calves, which some tasks let touch the ground, and
    the feet.
    """
    parts = [model.sensor(i).name.removesuffix("_contact") for i in range(17)]
    assert parts[go1.ALL_BUT_FEET] == parts[go1.TRUNK_TO_THIGHS] + of_legs("calf")
    assert set(parts[go1.TRUNK_TO_THIGHS]) == {"trunk", *of_legs("hip", "thigh")}
    assert parts[go1.FEET] == of_legs("foot")
    assert {parts[i] for i in go1.THIGHS_AND_CALVES} == set(of_legs("thigh", "calf"))
    data = mujoco.MjData(model)
    data.qpos[2], data.qpos[3:7] = height, quaternion
    mujoco.mj_forward(model, data)
    touched = {name for name, x in zip(parts, data.sensordata, strict=True) if x}
    assert touched - set(of_legs("foot")) == set(fallen)


def test_home(model):
    """The keyframe for the viewer: the nominal pose, its front soles on the floor."""
    home = model.key("home").qpos
    assert home[7:].tolist() == NOMINAL.tolist() == go1.Q_NOMINAL.tolist()
    assert soles(home).min() == pytest.approx(0.0, abs=1e-3)


# ---- kinematics; what a step needs of the trunk is in tests/paper/test_3_rewards.py ----


def lowest(q):
    """Height (..., 4) [m] of the lowest point of each leg relative to the trunk."""
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
    """Links of 0.213 m, 0.08 m from hip to thigh, soles of 0.02 m, in the order FR, FL, RR, RL."""
    heights = lowest(np.tile([hip, thigh, calf], 4).astype(float))
    assert heights == pytest.approx([right, left, right, left], abs=1e-12)


def test_leg_heights_are_those_of_the_model():
    """The formula and go1.xml are the same robot, at random joint angles with shins that point
    down, of any leading shape.
    """
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (2, 3, 12))
    q[..., 1::3], q[..., 2::3] = abs(q[..., 1::3]), -abs(q[..., 2::3])
    heights = lowest(q)
    assert heights.shape == (2, 3, 4)
    for i in np.ndindex(2, 3):
        assert heights[i] == pytest.approx(soles([0, 0, 0, 1, 0, 0, 0, *q[i]]), abs=1e-12)
