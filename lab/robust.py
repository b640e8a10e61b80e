"""What a policy loses outside of what it was trained for: `python -m lab robust RUN...` changes
the robot and its world.

One parameter at a time is changed for all episodes, while the others are drawn as in training. Look
at it before you put a policy on a robot, whose masses, friction, damping and delays nobody knows
exactly.
"""

from pathlib import Path

import mujoco
import numpy as np
from matplotlib.figure import Figure

import evaluate
import go1
import tasks
from lab import adopt
from runtime import run_folder

# those that are fields of tasks.Config, and then those of the joints of the model
PARAMETERS = dict(
    payload=(-3, -2, -1, 0, 1, 2, 3, 5),  # kg on the trunk
    friction=(0.1, 0.2, 0.3, 0.5, 0.8, 1.25, 1.5),  # of the feet
    motor_strength=(0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.2),  # factor on every torque
    # physics steps of 5 ms by which a joint target reaches the motors late
    latency=(0, 1, 2, 3, 4, 6, 8),
    damping=(0, 0.1, 0.2, 0.5, 1, 2),  # N m s/rad of every joint, beside that of the PD controller
    armature=(0.5, 1, 2, 3, 5),  # factor on the inertia of the rotors
)
UNITS = dict(
    payload="kg",
    friction="-",
    motor_strength="-",
    latency="steps of 5 ms",
    damping="N m s/rad",
    armature="-",
)
# commands of flat and rough
FORWARD = np.array([(x, 0.0, 0.0) for x in (0.0, 0.25, 0.5, 0.75, 1.0)])


def trained(env_cfg, parameter):
    """The least and the greatest value of a parameter in training."""
    if parameter in ("damping", "armature"):
        return (0, 0) if parameter == "damping" else (1, 1)
    x = getattr(env_cfg, parameter)
    return x if isinstance(x, tuple) else (x, x)


def changed(parameter, x, robot):
    """The world for `evaluate.load` in which a parameter is x; robot: MjSpec, None: go1.xml."""
    if parameter == "latency":
        return adopt.world(robot, latency=x)
    if parameter not in ("damping", "armature"):
        return adopt.world(robot, **{parameter: (x, x)})
    robot = mujoco.MjSpec.from_file(str(go1.MODEL)) if robot is None else robot.copy()
    for joint in robot.joints:
        if joint.type == mujoco.mjtJoint.mjJNT_HINGE and parameter == "damping":
            joint.damping[0] = x
        elif joint.type == mujoco.mjtJoint.mjJNT_HINGE:
            joint.armature *= x
    return adopt.world(robot)


def robust(folders, args):
    """Task performance and falls where a parameter leaves its range in training, the gray one."""
    rows = []
    for folder in map(Path, folders):
        env_cfg = run_folder.load_config(folder)[0]
        commands = FORWARD if tasks.asks_speed(env_cfg.task) else FORWARD[:1]
        each = max(1, args.episodes // len(commands))
        for parameter, values in PARAMETERS.items():
            low, high = trained(env_cfg, parameter)
            for x in values:
                settings = each * len(commands), args.clip, args.roughness
                world = changed(parameter, x, args.robot)
                loaded = evaluate.load(folder, *settings, world=world)
                e = evaluate.run_episodes(*loaded, np.repeat(commands, each, 0))
                row = dict(run=folder.name, parameter=parameter, value=x)
                row |= dict(trained_low=low, trained_high=high)
                row |= dict(episodes=len(e.fell), fell=np.mean(e.fell))
                for name in ("performance", "v_x", "power"):
                    row[name] = evaluate.finite_mean(getattr(e, name))
                rows.append(row)
    return rows, draw(rows)


def draw(rows):
    """A column for each parameter: task performance above, falls below, and a line for each run."""
    figure = Figure(figsize=(3 * len(PARAMETERS), 5), layout="constrained")
    axes = figure.subplots(2, len(PARAMETERS), sharex="col", sharey="row", squeeze=False)
    for column, parameter in zip(axes.T, PARAMETERS, strict=True):
        for name in dict.fromkeys(row["run"] for row in rows):
            mine = [row for row in rows if (row["run"], row["parameter"]) == (name, parameter)]
            x = [row["value"] for row in mine]
            for panel, y in zip(column, ("performance", "fell"), strict=True):
                panel.plot(x, [row[y] for row in mine], marker="o", markersize=3, label=name)
                panel.grid(alpha=0.3)
        for panel in column:  # a line where training had one value
            trained_in = mine[0]["trained_low"], mine[0]["trained_high"]
            panel.axvspan(*trained_in, alpha=0.25, color="gray", label="in training")
        column[1].set(xlabel=f"{parameter.replace('_', ' ')} [{UNITS[parameter]}]")
    axes[0, 0].set(ylabel="task performance")
    axes[1, 0].set(ylabel="share that fell", ylim=(-0.05, 1.05))
    axes[0, 0].legend(fontsize=7)
    return figure
