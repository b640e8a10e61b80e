"""go1.xml and go1.py against Unitree's published numbers, and against what the Python side takes
for granted.
"""

import itertools

import mujoco
import numpy as np
import pytest
from support import LEGS

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


def test_contact_sensors(model):
    """Each is of the ground and the part that it is named after. The first nine end every episode,
    then come the calves, which some tasks let touch the ground, and the feet.
    """
    parts = [model.sensor(i).name.removesuffix("_contact") for i in range(17)]
    bodies_or_geoms = zip(model.sensor_objtype, model.sensor_objid, strict=True)
    assert [mujoco.mj_id2name(model, kind, i) for kind, i in bodies_or_geoms] == parts
    assert {model.geom(i).name for i in model.sensor_refid} == {"floor"}
    assert parts[go1.ALL_BUT_FEET] == parts[go1.TRUNK_TO_THIGHS] + of_legs("calf")
    assert set(parts[go1.TRUNK_TO_THIGHS]) == {"trunk", *of_legs("hip", "thigh")}
    assert parts[go1.FEET] == of_legs("foot")
    assert {parts[i] for i in go1.THIGHS_AND_CALVES} == set(of_legs("thigh", "calf"))


# what a step needs of the trunk is in tests/paper/test_3_rewards.py
def test_leg_points_are_those_of_the_model(model):
    """Knees and feet of FR, FL, RR, RL, at random joint angles, of any leading shape."""
    data, q = mujoco.MjData(model), np.random.default_rng(0).uniform(-3, 3, (2, 3, 12))
    for i in np.ndindex(2, 3):
        data.qpos[:] = [0, 0, 0, 1, 0, 0, 0, *q[i]]
        mujoco.mj_kinematics(model, data)
        points = [
            x.xpos for leg in LEGS for x in (data.body(f"{leg}_calf"), data.geom(f"{leg}_foot"))
        ]
        assert go1.leg_points(q)[i] == pytest.approx(np.array(points), abs=1e-12)
