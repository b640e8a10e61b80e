"""adopt.py and robust.py: a policy on another model of the robot, and on robots outside of what it
was trained for.
"""

import csv
import re
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from support import (
    LEGS,
    ON_ITS_BACK,
    error_of,
    make,
    make_run,
    place,
    random_actions,
    run,
    same_bits,
    still,
)

import evaluate
import go1
import play
import tasks
from lab import adopt, robust
from lab.__main__ import main
from runtime import run_folder

# A Go1 written as others write it: names and settings as in MuJoCo Menagerie's, two capsules a
# calf, feet of 2.3 cm, actuators that are servos, a mesh, a keyframe and a sensor. {LEGS} and
# {SERVOS} are filled in below.
HEAD = """<mujoco model="go1">
<compiler angle="radian" autolimits="true"/>
<option cone="elliptic" impratio="100" timestep="0.002"/>
<default> <default class="go1">
  <geom friction="0.6" margin="0.001" condim="1"/>
  <joint axis="0 1 0" damping="2" armature="0.01" frictionloss="0.2"/>
  <position kp="100" forcerange="-23.7 23.7"/>
  <default class="abduction"> <joint axis="1 0 0" range="-0.863 0.863" damping="1"/> </default>
  <default class="hip"> <joint range="-0.686 4.501"/> </default>
  <default class="knee"> <joint range="-2.818 -0.888" actuatorfrcrange="-5 5"/> </default>
  <default class="visual">
    <geom type="mesh" contype="0" conaffinity="0" group="2" mass="0"/> </default>
  <default class="collision"> <geom type="capsule" group="3"/>
    <default class="foot"> <geom type="sphere" size="0.023" pos="0 0 -0.213" priority="1" condim="6"
      solimp="0.015 1 0.031" friction="0.8 0.02 0.01"/> </default> </default>
</default> </default>
<asset> <mesh name="trunk" vertex="0 0 0  0.3 0 0  0 0.1 0  0 0 0.1"/> </asset>
<worldbody> <light pos="0 0 3"/> <geom name="floor" type="plane" size="0 0 1"/>
  <body name="trunk" pos="0 0 0.445" childclass="go1"> <freejoint/>
    <inertial mass="5.204" pos="0.0223 0.002 -0.0005" diaginertia="0.0168 0.063 0.0717"/>
    <geom class="visual" mesh="trunk"/>
    <geom class="collision" type="box" size="0.125 0.04 0.057"/>"""
LEG = """
    <body name="{leg}_hip" pos="{x} {y} 0">
      <inertial mass="0.68" pos="0 0 0" diaginertia="4e-4 7e-4 5e-4"/>
      <joint class="abduction" name="{leg}_hip_joint"/>
      <geom class="collision" size="0.046" fromto="0 {out} 0 0 {far} 0"/>
      <body name="{leg}_thigh" pos="0 {thigh} 0">
        <inertial mass="1.009" pos="0 0 -0.03" diaginertia="5e-3 5e-3 8e-4"/>
        <joint class="hip" name="{leg}_thigh_joint"/>
        <geom class="collision" size="0.015" fromto="0 0 0 0 0 -0.2"/>
        <body name="{leg}_calf" pos="0 0 -0.213">
          <inertial mass="0.195862" pos="0 0 -0.146" diaginertia="1e-3 1e-3 4e-5"/>
          <joint class="knee" name="{leg}_calf_joint"/> <geom class="foot" name="{leg}"/>
          <geom class="collision" size="0.01" fromto="0 0 0 0.02 0 -0.13"/>
          <geom class="collision" size="0.01" fromto="0.02 0 -0.13 0 0 -0.2"/>
    </body> </body> </body>"""
SERVO = '<position class="{kind}" name="{leg}_{kind}" joint="{leg}_{joint}_joint"/>'
TAIL = """</body> </worldbody> <actuator>{servos}</actuator>
<sensor> <gyro name="gyro" site="imu"/> </sensor> <keyframe>
<key name="home" qpos="0 0 0.27 1 0 0 0 0 0.9 -1.8 0 0.9 -1.8 0 0.9 -1.8 0 0.9 -1.8"/> </keyframe>
</mujoco>"""


def mjcf(order=LEGS):
    """The text of that model with its legs in some order."""
    legs = servos = ""
    for leg in order:
        side, end = (1 if leg[1] == "L" else -1), (1 if leg[0] == "F" else -1)
        numbers = dict(
            x=0.1881 * end, y=0.04675 * side, thigh=0.08 * side, out=0.04 * side, far=0.065 * side
        )
        legs += LEG.format(leg=leg, **numbers)
        kinds = dict(abduction="hip", hip="thigh", knee="calf")
        servos += "".join(
            SERVO.format(leg=leg, kind=kind, joint=joint) for kind, joint in kinds.items()
        )
    return HEAD + '<site name="imu"/>' + legs + TAIL.format(servos=servos)


@pytest.fixture
def other(tmp_path):
    """The path of that model."""
    (tmp_path / "other.xml").write_text(mjcf())
    return tmp_path / "other.xml"


@pytest.fixture(autouse=True)
def short_episodes_elsewhere(monkeypatch, tmp_path):
    monkeypatch.setattr(evaluate, "EPISODE_STEPS", 16)
    monkeypatch.chdir(tmp_path)


# ---- another model ----


@pytest.mark.parametrize("task", ["rough", "velocity"])
def test_our_own_model_comes_through_unchanged(task):
    """go1.xml, read as if it were another robot's: the same bits."""
    cfg = tasks.task_config(task, tiles=1)
    robots = None, adopt.read_robot(go1.MODEL)
    envs = [adopt.OtherGo1(3, cfg, 1, robot) for robot in robots]
    for env in envs:
        env.reset(0)
    assert same_bits(*(run(env, random_actions(env, 20)) for env in envs))


def test_what_is_theirs_and_what_is_ours(other):
    """Masses, damping, friction of the joints and shapes are theirs; motors, contacts, ground and
    solver are ours.
    """
    model, ours = (
        go1.build_model(0.005, None, adopt.read_robot(other)),
        go1.build_model(0.005, None),
    )
    assert model.body_mass.sum() == pytest.approx(5.204 + 4 * (0.68 + 1.009 + 0.195862))
    assert (
        model.dof_damping[6:].tolist() == [1, 2, 2] * 4
        and (model.dof_frictionloss[6:] == 0.2).all()
    )
    assert model.geom("FR_foot").size[0] == 0.023
    assert [model.joint(i).name for i in range(1, 13)] == [ours.joint(i).name for i in range(1, 13)]
    assert (model.nq, model.nu, model.nkey) == (19, 12, 0) and not model.jnt_actfrclimited.any()
    for field in (
        "actuator_gainprm",
        "actuator_biastype",
        "actuator_forcelimited",
        "actuator_trnid",
    ):
        assert np.array_equal(getattr(model, field), getattr(ours, field)), field
    assert (model.opt.cone, model.opt.timestep, model.opt.impratio) == (
        ours.opt.cone,
        0.005,
        ours.opt.impratio,
    )
    collide = [model.geom(i) for i in range(model.ngeom) if model.geom_conaffinity[i]]
    assert len(collide) == 1 + 4 * 5 and {int(geom.contype[0]) for geom in collide} == {0}
    assert {int(geom.condim[0]) for geom in collide} == {3} and {
        float(geom.margin[0]) for geom in collide
    } == {0}
    # have no looks, so that they are drawn as they collide
    legs = [geom for geom in collide if geom.bodyid > 1]
    assert (
        len(legs) == 20
        and {int(geom.group[0]) for geom in legs} == {2}
        and model.geom_group.tolist().count(3) == 1
    )
    assert model.nlight == 1 == ours.nlight and model.light_castshadow[0]
    feet = [model.geom(f"{leg}_foot") for leg in LEGS]
    assert all(
        foot.solimp.tolist() == ours.geom("FR_foot").solimp.tolist() and foot.priority == 1
        for foot in feet
    )


def test_contacts_are_sensed_where_ours_are(other):
    """Trunk, hips and thighs (9), the two capsules of each calf (8), and the feet (4), which come
    last.
    """
    world = tasks.task_config(noise=0.0, start_spread=0.0)
    env = adopt.OtherGo1(1, world, 1, adopt.read_robot(other))
    env.reset(0)
    assert env.contacts.shape == (1, 21)
    still(env, 50)
    assert env.contacts[0, -4:].tolist() == [1, 1, 1, 1] and not env.contacts[0, :-4].any()
    place(env, quaternion=ON_ITS_BACK, height=0.055)
    env.batch.step()
    assert env.contacts[0, 0] > 0 and not env.contacts[0, -4:].any()
    assert make(1).contacts.shape == (1, 17)


def test_legs_in_another_order_are_sorted(other, tmp_path):
    """A file with FL before FR: the same robot, to rounding."""
    (tmp_path / "sorted.xml").write_text(mjcf(("RL", "FL", "RR", "FR")))
    ends = []
    for path in (other, tmp_path / "sorted.xml"):
        env = adopt.OtherGo1(2, tasks.task_config(noise=0.0), 1, adopt.read_robot(path))
        env.reset(0)
        run(env, 0.2 * random_actions(env, 10))
        ends.append(env.qpos.copy())
    np.testing.assert_allclose(*ends, atol=1e-6)


def test_a_robot_without_a_free_joint_gets_one(other):
    other.write_text(other.read_text().replace("<freejoint/>", ""))
    assert go1.build_model(0.005, None, adopt.read_robot(other)).nq == 19


def test_other_names_are_accepted(other):
    """Without "_joint", with a base, and with a foot that is called a foot."""
    text = other.read_text().replace("_joint", "").replace('body name="trunk"', 'body name="base"')
    other.write_text(text.replace('class="foot" name="FR"', 'class="foot" name="FR_foot"'))
    assert go1.build_model(0.005, None, adopt.read_robot(other)).nu == 12


SPOILED = {
    "a missing joint": (
        lambda text: text.replace("FL_calf_joint", "FL_shin_joint"),
        ["FL_calf_joint", "lacks"],
    ),
    "missing feet": (
        lambda text: re.sub('class="foot" name="..?"', 'class="foot"', text),
        ["FR_foot", "RL_foot"],
    ),
    "another axis": (
        lambda text: text.replace('axis="1 0 0"', 'axis="-1 0 0"'),
        ["FR_hip_joint", "turns"],
    ),
    "one joint more": (
        lambda text: text.replace(
            '<site name="imu"/>',
            '<body name="x"> <joint name="tail"/> <geom size="1"/> </body><site name="imu"/>',
        ),
        ["14 joints", "tail"],
    ),
    "no robot": (lambda text: "<mujoco/>", ["trunk", "RL_foot"]),
    "no model": (lambda text: "nonsense", ["other.xml"]),
}


@pytest.mark.parametrize("what", ["table", "play"])
@pytest.mark.parametrize("spoil, says", SPOILED.values(), ids=SPOILED)
def test_a_model_that_is_no_go1_is_one_line(other, tmp_path, capsys, what, spoil, says):
    other.write_text(spoil(other.read_text()))
    line = error_of(capsys, main, what, make_run(tmp_path / "run"), "--model", other)
    assert all(word in line for word in says), line


def test_a_model_that_does_not_exist_is_one_line(tmp_path, capsys):
    run_folder = make_run(tmp_path / "run")
    assert "none.xml" in error_of(capsys, main, "table", run_folder, "--model", "none.xml")
    assert "--model" in error_of(capsys, main, "play", run_folder)
    assert "no model" in error_of(capsys, main, "table", run_folder, "--model", "")


def test_the_laboratory_measures_and_plays_it(other, tmp_path, capfd, monkeypatch):
    """The robot of the file is the one that is measured and drawn; its episodes are not kept as if
    it were ours.
    """
    folder, seen = make_run(tmp_path / "run", action=0.0), []
    episodes = evaluate.run_episodes
    monkeypatch.setattr(evaluate, "run_episodes", lambda *x: seen.append(x[1]) or episodes(*x))
    assert main(["table", str(folder), "--model", str(other), "--episodes", "11"]) == 0
    assert capfd.readouterr().err == ""  # nor does MuJoCo complain of their settings of the solver
    assert {round(env.trunk.mass[0], 3) for env in seen} == {5.204} and len(seen) == 2
    assert not (folder / run_folder.EPISODES).exists()
    monkeypatch.setattr(play, "check_drawing", lambda gif: None)
    monkeypatch.setattr(
        play,
        "watch",
        lambda env, steps, *_: seen.append((next(steps), env, play.make_scene(env)[0])),
    )
    assert main(["play", str(folder), "--model", str(other)]) == 0
    _, env, drawn = seen[-1]
    assert env.trunk.mass == drawn.body("trunk").mass == 5.204


# ---- the same robot, changed ----


@pytest.mark.parametrize("parameter, x", [("damping", 0.5), ("armature", 3)])
def test_joints_are_changed_in_the_model(parameter, x):
    """Of the twelve joints and of nothing else, starting from go1.xml or from another robot."""
    mine = mujoco.MjSpec.from_file(str(go1.MODEL))
    mine.joint("FR_hip_joint").armature = 1.0
    for robot, armature in ((None, 0.0045), (mine, 1.0)):
        env = robust.changed(parameter, x, robot)(1, tasks.task_config())
        model = env.build_model(None)
        assert (model.dof_damping[6:] == (x if parameter == "damping" else 0)).all()
        assert model.dof_armature[6] == pytest.approx(
            armature * (x if parameter == "armature" else 1)
        )
        assert not model.dof_armature[:6].any() and not model.dof_damping[:6].any()
    assert mine.joint("FR_hip_joint").armature == 1.0


@pytest.mark.parametrize("parameter", ["payload", "friction", "motor_strength", "latency"])
def test_the_world_is_changed_in_its_config(tmp_path, parameter):
    """What the environment draws, or how late its targets are, is then this number."""
    x = 2 if parameter == "latency" else 0.75
    _, env = evaluate.load(make_run(tmp_path / "run"), 3, world=robust.changed(parameter, x, None))
    env.reset(0)
    found = dict(
        payload=env.state.mass[:, env.trunk.id] - env.trunk.mass,
        friction=env.state.friction[:, env.feet, 0],
        motor_strength=env.state.strength,
        latency=len(env.state.targets) - 1,
    )
    np.testing.assert_allclose(found[parameter], x)


def test_every_parameter_leaves_the_range_of_training():
    """On the task whose world is the most random, too, but for friction, which ends where feet
    would sink in (D24).
    """
    for task in tasks.TASKS:
        for parameter, values in robust.PARAMETERS.items():
            low, high = robust.trained(tasks.task_config(task), parameter)
            assert min(values) < low or max(values) > high, (task, parameter)


def test_rows_of_robust(tmp_path, monkeypatch):
    """Two runs, two parameters with two values each; ten episodes are two of each of five
    commands.
    """
    monkeypatch.setattr(robust, "PARAMETERS", dict(friction=(0.5, 1.5), damping=(0, 1)))
    folders = [make_run(tmp_path / task, task, action=0.0) for task in ("flat", "velocity")]
    args = SimpleNamespace(episodes=10, clip=None, roughness=0.0, robot=None)
    rows, figure = robust.robust(folders, args)
    assert [(row["run"], row["parameter"], row["value"]) for row in rows] == [
        (task, parameter, x)
        for task in ("flat", "velocity")
        for parameter, x in (("friction", 0.5), ("friction", 1.5), ("damping", 0), ("damping", 1))
    ]
    assert [(row["trained_low"], row["trained_high"]) for row in rows[:4:2]] == [
        (0.5, 1.25),
        (0, 0),
    ]
    assert {row["episodes"] for row in rows} == {10}
    assert len(figure.axes) == 4 and all(len(axes.get_lines()) == 2 for axes in figure.axes)


def test_robust_writes_its_files(tmp_path, monkeypatch):
    monkeypatch.setattr(robust, "PARAMETERS", dict(latency=(0, 2)))
    assert main(["robust", str(make_run(tmp_path / "run")), "--episodes", "5"]) == 0
    with open("robust.csv") as file:
        assert [row["value"] for row in csv.DictReader(file)] == ["0", "2"]
