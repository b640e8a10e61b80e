"""Another model of the robot: any MJCF of a Go1, so that a policy can be tried on it before it
meets a real one.

Its bodies, masses, joints and shapes take the place of those of go1.xml, with their damping,
armature and friction. Its actuators, sensors, ground and solver settings do not. Torques come from
our motors, and what collides in it touches our ground and nothing else, with the contacts of our
tasks.
"""

import argparse
from dataclasses import replace

import mujoco
import numpy as np

import go1
import go1_env

TRUNK = ("trunk", "base", "base_link", "torso")  # names that this body may have
JOINTS = dict(  # names that a leg's joints may have, after "FR_"
    hip=("hip_joint", "hip", "abduction", "hip_abduction"),
    thigh=("thigh_joint", "thigh", "hip_pitch"),
    calf=("calf_joint", "calf", "knee", "knee_joint"),
)
# that the geom of a foot may have, after "FR"
FEET = ("_foot", "", "_foot_collision", "_foot_geom")
AXES = dict(hip=(1, 0, 0), thigh=(0, 1, 0), calf=(0, 1, 0))
FRICTION = (0.6, 0.02, 0.01)  # as in go1.xml
FOOT_FRICTION = (0.8, 0.02, 0.01)  # as there, and episodes draw the first number


class OtherGo1(go1_env.Go1Env):
    """A Go1Env of another robot: an MjSpec, or None for that of go1.xml."""

    def __init__(self, num_envs, env_cfg, threads=None, robot=None):
        self.robot = robot
        super().__init__(num_envs, env_cfg, threads)

    def build_model(self, ground):
        """As Go1Env.build_model."""
        return go1.build_model(self.env_cfg.timestep, ground, self.robot)


def world(robot, **changes):
    """What makes an OtherGo1, as `evaluate.load` wants it; changes: of its Config."""
    return lambda num_envs, env_cfg: OtherGo1(num_envs, replace(env_cfg, **changes), robot=robot)


def find(spec, path):
    """The parts of a model by our names: {"trunk": a body, "FR_hip_joint": a joint, ...}.

    Raises ValueError, in one line, for what is missing and for a joint that turns about another
    axis than ours.
    """
    bodies, joints, geoms = (
        {x.name: x for x in kind} for kind in (spec.bodies, spec.joints, spec.geoms)
    )
    wanted = {"trunk": (bodies, TRUNK)}
    for leg in go1.LEGS:
        wanted |= {
            f"{leg}_{kind}_joint": (joints, [f"{leg}_{x}" for x in names])
            for kind, names in JOINTS.items()
        }
        wanted[f"{leg}_foot"] = geoms, [leg + x for x in FEET]
    missing = [
        f"{ours} ({' or '.join(names)})"
        for ours, (among, names) in wanted.items()
        if not among.keys() & names
    ]
    if missing:
        raise ValueError(f"{path} is not a Go1 that we can read: it lacks {', '.join(missing)}")
    parts = {
        ours: next(among[x] for x in names if x in among) for ours, (among, names) in wanted.items()
    }
    for ours, joint in parts.items():
        axis = AXES.get(ours[3:-6])
        if axis and not np.allclose(joint.axis / np.linalg.norm(joint.axis), axis, atol=0.05):
            raise ValueError(
                f"{path}: {joint.name} turns about {joint.axis}, and a Go1's {ours[3:-6]} "
                f"about {axis}"
            )
    return parts


def rename(parts):
    """Give the parts of `find`, the bodies that they move and the calves' other geoms our names."""
    for ours, part in parts.items():
        part.name = ours
        if ours.endswith("_joint"):
            part.parent.name = ours.removesuffix("_joint")
    for leg in go1.LEGS:
        calf = parts[f"{leg}_calf_joint"].parent
        shells = [
            geom
            for geom in calf.geoms
            if (geom.contype or geom.conaffinity) and geom.name != f"{leg}_foot"
        ]
        for i, geom in enumerate(shells):
            geom.name = f"{leg}_calf{i}"


def put_in_order(world, trunk):
    """Sort the legs of an attached trunk FR, FL, RR, RL, the order of our arrays."""
    world.copy_during_attach = True
    for leg in go1.LEGS:
        hip = trunk.find_child(f"their/{leg}_hip")
        trunk.add_frame().attach_body(hip, "leg/", "")
        world.delete(hip)
    for part in (*world.bodies, *world.joints, *world.geoms):
        part.name = part.name.removeprefix("leg/").removeprefix("their/")


def set_contacts(world):
    """Let all that collides touch the ground alone, as in go1.xml, sensed in the same order."""
    visible = {geom.parent.name for geom in world.geoms if geom.group < 3}
    for geom in world.geoms:
        if geom.parent.name != "world" and (geom.contype or geom.conaffinity):
            foot = geom.name in [f"{leg}_foot" for leg in go1.LEGS]
            geom.contype = 0
            geom.conaffinity = 1
            geom.condim = 3
            geom.margin = 0.0
            geom.gap = 0.0
            geom.priority = int(foot)
            geom.friction = FOOT_FRICTION if foot else FRICTION
            # a leg without looks is drawn as it collides
            geom.group = geom.group if geom.parent.name in visible else 2
            geom.solref = world.geom("floor").solref
            geom.solimp = world.geom("floor").solimp
    parts = [f"{leg}_{part}" for leg in go1.LEGS for part in ("hip", "thigh")]
    body = mujoco.mjtObj.mjOBJ_BODY
    geom = mujoco.mjtObj.mjOBJ_GEOM
    calves = [x.name for leg in go1.LEGS for x in world.geoms if x.name.startswith(f"{leg}_calf")]
    sensed = [(body, name) for name in ("trunk", *parts)] + [(geom, name) for name in calves]
    for kind, name in sensed + [(geom, f"{leg}_foot") for leg in go1.LEGS]:
        world.add_sensor(
            name=f"{name}_contact",
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=kind,
            objname=name,
            # number of contacts, 1 at most
            reftype=geom,
            refname="floor",
            intprm=[1, 0, 1],
        )


def read_robot(path):
    """The robot of an MJCF file in our world, with our names: an MjSpec for `go1.build_model`.

    Raises ValueError, in one line, for a file that is no model and for a model that is no Go1.
    """
    try:
        their = mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise ValueError(f"{path} is no model that MuJoCo can read: {error}") from None
    rename(find(their, path))
    for part in (*their.actuators, *their.sensors, *their.keys):
        their.delete(part)
    world = mujoco.MjSpec.from_file(str(go1.MODEL))
    sun = {
        name: getattr(world.light("sun"), name)
        for name in ("mode", "type", "pos", "dir", "diffuse", "castshadow")
    }
    world.delete(world.body("trunk"))  # and all that refers to it
    world.delete(world.keys[0])
    their.option = world.option
    trunk = world.worldbody.add_frame().attach_body(their.body("trunk"), "their/", "")
    put_in_order(world, trunk)
    trunk.add_light(**sun)  # of go1.xml, so that play.py shows something
    if not any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in trunk.joints):
        trunk.add_freejoint()
    names = [f"{leg}_{kind}" for leg in go1.LEGS for kind in JOINTS]
    if len(world.joints) != 13:
        others = {joint.name for joint in world.joints} - {f"{name}_joint" for name in names}
        raise ValueError(
            f"{path} has {len(world.joints)} joints, not 13 as a Go1: {', '.join(sorted(others))}"
        )
    for name in names:
        # our limits hold
        world.joint(f"{name}_joint").actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
        world.add_actuator(name=name, target=f"{name}_joint", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    set_contacts(world)
    return world


def play(argv):
    """`play.py` with the robot of --model; returns the exit status."""
    import play  # here, because it decides how MuJoCo draws

    parser = argparse.ArgumentParser(prog="lab play", add_help=False)
    parser.add_argument("--model")
    args, others = parser.parse_known_args(argv)
    if args.model is None:
        raise ValueError("play needs --model FILE.xml; without one it is play.py")
    return play.main(others, world(read_robot(args.model)))
