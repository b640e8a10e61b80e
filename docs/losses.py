"""What joint losses, soft feet and physics steps of 2 ms do to a walk: `python -m docs.losses RUN`
prints a table like that of deploy.md. RUN is a run of `flat`.

The episodes are those of `evaluate.py RUN` with as many --episodes, whose score and falls are those
of the first row. Speed and power leave out the episodes that end in a fall, which is fast and
costly.
"""

import math
import os
import sys
from dataclasses import replace
from unittest import mock

if __name__ == "__main__":
    os.environ["MUJOCO_GL"] = "off"  # no robot is drawn

import numpy as np

import evaluate
import go1
from runtime.cli import COUNT, Parser, Refused, a_path, misfit, program

CASES = {
    "nothing": {},
    "joint friction 0.2 N m": dict(friction=0.2),
    "joint friction 0.5": dict(friction=0.5),
    "joint friction 1": dict(friction=1.0),
    "joint damping 0.1 N m s / rad": dict(damping=0.1),
    "joint damping 0.5": dict(damping=0.5),
    "joint damping 1": dict(damping=1.0),
    "joint damping 2": dict(damping=2.0),
    "joint damping 0.5, and kd 0": dict(damping=0.5, kd=0.0),
    "soft feet": dict(solimp=(0.015, 1.0, 0.031)),
    "2 ms, 10 steps a target": dict(steps=10),
}


def measure(pi, env_cfg, asked, friction=0.0, damping=0.0, kd=go1.KD, solimp=None, steps=None):
    """Score [-], speeds ahead asked for 0.5 and 1 m/s [m/s], power [W] and share of falls.

    asked:    (N, 3) [m/s, m/s, rad/s] commands, a robot for each
    friction: [N m] and damping [N m s / rad] of the joints; kd: [N m s / rad] of their controllers
    solimp:   of the feet, the first three numbers; None: MuJoCo's own
    steps:    of physics in a control step, each with new torques; None: as many as in training
    """
    steps = steps or env_cfg.physics_steps
    step = env_cfg.timestep * env_cfg.physics_steps / steps
    env = evaluate.make_env(replace(env_cfg, timestep=step, physics_steps=steps), asked)
    env.batch.expand("dof_frictionloss")[:, 6:] = friction  # the first six are the trunk's
    env.batch.expand("dof_damping")[:, 6:] = damping
    if solimp:
        env.batch.expand("geom_solimp")[:, env.feet, :3] = solimp
    with mock.patch.object(go1, "KD", kd):
        played, _ = evaluate.run_episodes(pi.mean, env)
    lasted = ~played.fell
    parts = [played.v_x[lasted & (asked[:, 0] == v_x)] for v_x in (0.5, 1.0)]
    parts.append(played.power[lasted])
    means = [x.mean() if x.size else np.nan for x in parts]  # nan: all of these fell
    return played.performance.mean(), *means, played.fell.mean()


@program("docs.losses")
def main(argv):
    """Print the table of a RUN, from --episodes of each row; returns the exit status."""
    parser = Parser("docs.losses", __doc__)
    add = parser.add_argument
    add("run", metavar="RUN", type=a_path, help="run folder with a policy.npz")
    add("--episodes", type=int, default=330, help="of each row (default: 330)")
    args = parser.parse_args(argv)
    if line := misfit(vars(args), dict(episodes=COUNT)):
        parser.error(line)
    pi, env_cfg = evaluate.load(args.run)
    if env_cfg.task != "flat":
        raise Refused(f"{args.run} is of {env_cfg.task}: this is about walking on flat ground")
    commands = evaluate.commands_of(env_cfg.task)
    asked = np.tile(commands, (math.ceil(args.episodes / len(commands)), 1))
    print("| changed | score | at 0.5 m/s | at 1 m/s | power | fell |\n" + "|---" * 6 + "|")
    for name, changes in CASES.items():
        row = "{:.2f} | {:.2f} m/s | {:.2f} m/s | {:.0f} W | {:.1%}"
        print(f"| {name} |", row.format(*measure(pi, env_cfg, asked, **changes)), "|", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
