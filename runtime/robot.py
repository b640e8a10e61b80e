"""Which robot it is: go1.xml must hold the one of go1.py, and a digest tells robots apart."""

import hashlib
from itertools import zip_longest

import mujoco
import numpy as np

import go1
from runtime.cli import Refused

OBJ = mujoco.mjtObj
PARTS = [f"{leg}_{part}" for leg in go1.LEGS for part in ("hip", "thigh", "calf")]
JOINTS = [f"{part}_joint" for part in PARTS]
# what the contact sensors feel, of which bodies and geoms: a foot is fixed to the body of its calf
FELT_BODIES = ["trunk", *(part for part in PARTS if "calf" not in part)]
FELT_GEOMS = [f"{leg}_{part}" for part in ("calf", "foot") for leg in go1.LEGS]


def refuse_other_model():
    """Raise Refused, with the first difference, if go1.xml and go1.py are not of one robot."""
    try:
        model = go1.build_model(timestep=0.005, ground=None)
    except ValueError as error:
        raise Refused(f"go1.xml: {' '.join(str(error).split())}") from None
    for what, found, wanted in names(model):
        for i, (x, y) in enumerate(zip_longest(found, wanted, fillvalue="missing")):
            if x != y:
                raise Refused(f"{what} {i} is {x} in go1.xml and {y} in our code")
    for what, parts, found, wanted in (*sensors(model), *motors(model), *legs(model)):
        for part, x, y in zip(parts, found, wanted, strict=True):
            if np.abs(x - y).max() > 1e-3:
                x, y = np.round(x, 4).tolist(), np.round(y, 4).tolist()
                raise Refused(f"{what} {part} is {x} in go1.xml and {y} in our code")


def names(model):
    """(what, names in go1.xml, our names) of joints, motors and sensors, in their order.

    Whatever follows them relies on that order.
    """

    def name(kind, i):
        return mujoco.mj_id2name(model, kind, i)

    joints = [name(OBJ.mjOBJ_JOINT, i) for i in range(model.njnt)]
    driven = [name(OBJ.mjOBJ_JOINT, i) for i in model.actuator_trnid[:, 0]]
    pairs = zip(model.sensor_objtype, model.sensor_objid, model.sensor_refid, strict=True)
    pairs = [f"{name(kind, i)} and {name(OBJ.mjOBJ_GEOM, j)}" for kind, i, j in pairs]
    sensors = [f"{name(OBJ.mjOBJ_SENSOR, i)} of {pair}" for i, pair in enumerate(pairs)]
    felt = [f"{part}_contact of {part} and floor" for part in FELT_BODIES + FELT_GEOMS]
    return [
        ("joint", joints, ["root", *JOINTS]),
        ("the joint of motor", driven, JOINTS),
        ("sensor", sensors, felt),
    ]


def sensors(model):
    """(what, of which parts, numbers there, numbers here) of the contact sensors."""
    found = [model.sensor_type, model.sensor_objtype, model.sensor_reftype]
    kinds = [OBJ.mjOBJ_BODY] * len(FELT_BODIES) + [OBJ.mjOBJ_GEOM] * len(FELT_GEOMS)
    wanted = [[mujoco.mjtSensor.mjSENS_CONTACT, kind, OBJ.mjOBJ_GEOM, 1, 1] for kind in kinds]
    what = "type, objtype, reftype, data (found: 1) and num of sensor"
    found = np.c_[*found, model.sensor_intprm[:, [0, 2]]]
    return [(what, FELT_BODIES + FELT_GEOMS, found, np.array(wanted, int))]


def motors(model):
    """The same of joints and motors: a motor's ctrl is the joint's torque, and nothing brakes."""
    passive = np.c_[model.dof_damping[6:], model.dof_frictionloss[6:], model.jnt_stiffness[1:]]
    drive = np.c_[
        model.actuator_gainprm[:, 0],
        model.actuator_gear[:, 0],
        model.actuator_biastype,
        model.actuator_dyntype,
    ]
    limits = np.c_[-go1.TORQUE_LIMIT, go1.TORQUE_LIMIT]
    limited_by = [  # our go1.xml has none of these, but they would be in force, too
        (model.actuator_ctrllimited, model.actuator_ctrlrange),
        (model.actuator_forcelimited, model.actuator_forcerange),
        (model.jnt_actfrclimited[1:], model.jnt_actfrcrange[1:]),
    ]
    reached = np.c_[model.jnt_limited[1:], go1.Q_NOMINAL.clip(*model.jnt_range[1:].T)]
    what = "gain, gear, biastype and dyntype of the motor of"
    return [
        ("damping, frictionloss and stiffness of", JOINTS, passive, np.zeros((12, 3))),
        (what, JOINTS, drive, np.tile([1, 1, 0, 0], (12, 1))),
        *(
            ("TORQUE_LIMIT [N m] of", JOINTS, np.where(on[:, None], found, limits), limits)
            for on, found in limited_by
        ),
        (
            "limited, and Q_NOMINAL in the range, of",
            JOINTS,
            reached,
            np.c_[np.ones(12), go1.Q_NOMINAL],
        ),
    ]


def legs(model):
    """The same of the feet's radius, and of knees and feet in three poses."""
    feet = model.sensor_objid[go1.FEET]
    feet_and_knees = [f"{leg}_{part}" for leg in go1.LEGS for part in ("knee", "foot")]
    # of a ball the radius, of another geom that of a ball around it
    radii = model.geom_rbound[feet], np.full(4, go1.FOOT_RADIUS)
    compared = [("FOOT_RADIUS [m] of", [f"{leg}_foot" for leg in go1.LEGS], *radii)]
    data = mujoco.MjData(model)
    for scale in (0, 1, -1):
        data.qpos[:] = [0, 0, 0, 1, 0, 0, 0, *scale * go1.Q_NOMINAL]
        mujoco.mj_kinematics(model, data)
        found = np.stack([data.xanchor[3::3], data.geom_xpos[feet]], 1).reshape(8, 3)
        what = f"at {scale} * Q_NOMINAL the place [m] of"
        compared.append((what, feet_and_knees, found, go1.leg_points(scale * go1.Q_NOMINAL)))
    return compared


def digest():
    """Twelve hexadecimal digits that tell this robot from others, by lengths, masses, inertias,
    limits and gains.
    """
    model = go1.build_model(timestep=0.005, ground=None)
    numbers = [model.body_pos[2:], model.body_mass, model.body_ipos, model.body_inertia]
    numbers += [model.jnt_range, model.dof_armature, go1.FOOT_RADIUS, go1.Q_NOMINAL]
    numbers += [go1.ACTION_SCALE, go1.KP, go1.KD]
    numbers += [go1.TORQUE_LIMIT, go1.VELOCITY_LIMIT, go1.STALL_TORQUE]
    # MuJoCo computes some, and its versions may differ in the last digits; + 0 makes -0 a 0
    rounded = np.concatenate([np.ravel(x) for x in numbers]).round(9) + 0.0
    return hashlib.sha256(rounded.tobytes()).hexdigest()[:12]


def refuse_other_digest(path, found):
    """Raise Refused if a file is of another robot; found: its digest."""
    if found != (ours := digest()):
        what = "train anew, or restore the go1.xml and go1.py of its time"
        raise Refused(f"{path} is of another robot, {found} and not {ours}: {what}")
