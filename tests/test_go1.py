"""go1.xml and go1.py against Unitree's published numbers, and against what the Python side takes
for granted.
"""

import itertools
import re

import mujoco
import numpy as np
import pytest
from support import LEGS, error_of, make_run

import eipo
import evaluate
import go1
import play
import tasks
import train
from runtime import checkpoint, robot
from runtime.cli import Refused


def of_legs(*parts):
    """The names of these parts of each leg."""
    return [f"{leg}_{part}" for leg in LEGS for part in parts]


@pytest.fixture
def model():
    """The robot on its floor."""
    return mujoco.MjModel.from_xml_path(str(go1.MODEL))


@pytest.mark.go1
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


@pytest.mark.go1
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


# ---- another robot ----


def edited(old, new=""):
    """A change of go1.xml at every place where old is, which must be there."""

    def edit(xml):
        assert old in xml
        return xml.replace(old, new)

    return edit


def left_first(xml):
    """As in MuJoCo Menagerie: right and left exchange their names and their places."""
    return re.sub("(?<=[FR])[LR](?=_)", lambda side: dict(L="R", R="L")[side[0]], xml)


FR_HIP = '<motor name="FR_hip" joint="FR_hip_joint"/>'
FR_THIGH = '<motor name="FR_thigh" joint="FR_thigh_joint"/>'
CALF = '<contact name="FR_calf_contact" geom1="FR_calf" geom2="floor" data="found" num="1"/>'

OTHERS = [  # a case for each check of robot.py: what is done to go1.xml, and what is said of it
    (left_first, "joint 1 is FL_hip_joint in go1.xml and FR_hip_joint in our code"),
    (
        edited(' <geom name="RL_foot"', ' <joint name="toe" class="hip"/> <geom name="RL_foot"'),
        "joint 13 is toe in go1.xml and missing in our code",
    ),
    (
        edited(f"{FR_HIP} {FR_THIGH}", f"{FR_THIGH} {FR_HIP}"),
        "the joint of motor 0 is FR_thigh_joint in go1.xml",
    ),
    (
        edited(FR_HIP, FR_HIP.replace("motor", "position").replace("/>", ' kp="20"/>')),
        "gain, gear, biastype and dyntype of the motor of FR_hip_joint is [20.0, 1.0, 1.0, 0.0]",
    ),
    (
        edited(FR_HIP, FR_HIP.replace("/>", ' forcerange="-20 20"/>')),
        "TORQUE_LIMIT [N m] of FR_hip_joint is [-20.0, 20.0] in go1.xml and [-23.7, 23.7] in",
    ),
    (
        edited('damping="0"', 'damping="0.5"'),
        "damping, frictionloss and stiffness of FR_hip_joint is [0.5, 0.0, 0.0] in go1.xml",
    ),
    (
        edited("-2.818 -0.888", "-1.4 -0.888"),
        "limited, and Q_NOMINAL in the range, of FR_calf_joint is [1.0, -1.4] in go1.xml",
    ),
    (
        edited(CALF, CALF.replace('"FR_calf"', '"FL_calf"')),
        "sensor 9 is FR_calf_contact of FL_calf and floor in go1.xml",
    ),
    (  # it would feel the foot, too
        edited(CALF, CALF.replace("geom1", "body1")),
        "type, objtype, reftype, data (found: 1) and num of sensor FR_calf is [42, 1, 5, 1, 1]",
    ),
    (
        edited('size="0.02"', 'size="0.023"'),
        "FOOT_RADIUS [m] of FR_foot is 0.023",
    ),
    (edited('axis="1 0 0"', 'axs="1 0 0"'), "go1.xml: XML Error"),
    (edited('axis="1 0 0"', 'axis="-1 0 0"'), "at 1 * Q_NOMINAL the place [m] of FR_knee is"),
]


@pytest.fixture
def rewrite(tmp_path, monkeypatch):
    """A function that gives go1.py another go1.xml: ours, changed by a function."""
    xml, numbers = go1.MODEL.read_text(), itertools.count()

    def rewrite(edit):
        folder = tmp_path / f"robot{next(numbers)}"
        folder.mkdir()
        monkeypatch.setattr(go1, "MODEL", folder / "go1.xml")
        go1.MODEL.write_text(edit(xml))

    return rewrite


@pytest.mark.go1  # as their go1.xml has other words
@pytest.mark.parametrize(("edit", "says"), OTHERS)
def test_another_robot_is_refused(rewrite, edit, says):
    """By the first part that is not that of go1.py."""
    rewrite(edit)
    with pytest.raises(Refused, match=f"^{re.escape(says)}"):
        robot.refuse_other_model()


@pytest.mark.go1
def test_another_robot_is_one_line_and_nothing_is_written(rewrite, tmp_path, capsys):
    """Before it trains, and not after all of its robots fell."""
    run = make_run(tmp_path / "kept")
    rewrite(edited('damping="0"', 'damping="0.5"'))
    said = error_of(capsys, train.main, "--out", tmp_path / "run", "--num-envs", 4)
    assert "damping" in said and not (tmp_path / "run").exists()
    for main in (evaluate.main, play.main):
        assert "damping" in error_of(capsys, main, run)


def test_a_process_reads_go1_xml_once(rewrite):
    """A run on its way saves under the digest of the robot that it trains."""
    rewrite(lambda xml: xml)
    before = robot.digest()
    go1.MODEL.write_text("edited meanwhile")
    assert robot.digest() == before


# ---- the digest ----


@pytest.mark.go1
def test_digest_of_the_same_robot(rewrite):
    """Neither looks nor names make a robot another one, nor what versions of MuJoCo round."""
    changes = {
        "<worldbody>": "<!-- The world. --> <worldbody>",
        'model="go1"': 'model="mine"',
        'rgba="0.24 0.25 0.27 1"': 'rgba="1 0 0 1"',
        'mass="5.560"': 'mass="5.5600000000001"',
    }

    def edit(xml):
        for change in changes.items():
            xml = edited(*change)(xml)
        return xml

    ours = robot.digest()
    assert re.fullmatch("[0-9a-f]{12}", ours)
    rewrite(edit)
    assert robot.digest() == ours


DIFFERENT = {  # what is done to go1.xml, and numbers of go1.py
    "mass": (edited('mass="5.560"', 'mass="5.561"'), {}),
    "inertia": (edited('fullinertia="0.0180397 ', 'fullinertia="0.0180407 '), {}),
    "range": (edited("-2.818 -0.888", "-2.818 -0.887"), {}),
    "length": (edited('FR_hip" pos="0.1881', 'FR_hip" pos="0.1886'), {}),
    "armature": (edited('armature="', 'armature="1'), {}),
}
NUMBERS = "Q_NOMINAL ACTION_SCALE KP KD FOOT_RADIUS TORQUE_LIMIT VELOCITY_LIMIT STALL_TORQUE"
DIFFERENT |= {x: (lambda xml: xml, {x: getattr(go1, x) + 1}) for x in NUMBERS.split()}


@pytest.mark.go1
@pytest.mark.parametrize(("edit", "numbers"), DIFFERENT.values(), ids=DIFFERENT)
def test_digest_of_another_robot(rewrite, monkeypatch, edit, numbers):
    ours = robot.digest()
    rewrite(edit)
    for name, x in numbers.items():
        monkeypatch.setattr(go1, name, x)
    assert robot.digest() != ours


def test_what_another_robot_trained_is_refused(tmp_path, capsys, monkeypatch):
    """Its policy and its checkpoint."""
    run, cfg = make_run(tmp_path / "run"), eipo.Config(num_envs=2)
    envs = train.make_envs(tasks.Config(), cfg, 1)
    checkpoint.save(run / "checkpoint.npz", eipo.init_state(envs, cfg), envs, cfg)
    monkeypatch.setattr(go1, "STALL_TORQUE", go1.STALL_TORQUE + 1)
    for main in (evaluate.main, play.main):
        said = error_of(capsys, main, run)
        assert f"{run / 'policy.npz'} is of another robot" in said and robot.digest() in said
    said = error_of(capsys, train.main, "--out", run, "--resume")
    assert f"{run / 'checkpoint.npz'} is of another robot" in said
