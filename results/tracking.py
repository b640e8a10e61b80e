"""How well policies of the curriculum follow commands: `python results/tracking.py RUN...` prints Markdown tables.

For each run and command, over episodes of 20 s that keep it, under the deterministic policy:

    v_x, yaw rate    [m/s, rad/s] means of the robots that have not fallen
    linear, angular  the two kernels of Eq. (8), means over 1000 steps; 0 for the time after a fall, as in Section V-A
    power            [W], of those that have not fallen
    fell, 800 W      share of the episodes that ended with a part on the ground, or by the power limit

Then the same ends in training, counted over all of it, and the area of the commands [share of the grid].
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import curriculum
import measure
import rewards

COMMANDS = ((0.0, 0.0), (0.5, 0.0), (1.0, 0.0), (1.5, 0.0), (2.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (1.0, 1.0))


def follow(mean, env, v_x, yaw):
    """The columns of one command, by name."""
    command = np.tile([v_x, 0.0, yaw], (env.num_envs, 1))
    kernels, moved, ends = np.zeros(2), [], np.zeros(2)
    for _, log, alive, fell in measure.steps(mean, env, command):
        velocity = env.velocity_over_ground()
        going = alive & ~fell  # who has just fallen stands already where the next episode begins
        kernels += np.array(rewards.kernels(velocity, command))[:, going].sum(1)
        moved.append(np.column_stack([velocity[:, [0, 2]], log["power"]])[going])
        ends += [(alive & log["ended_fall"]).sum(), (alive & log["ended_power"]).sum()]
    speed, turn, power = np.concatenate(moved).mean(0)
    linear, angular = kernels / env.num_envs / env.env_cfg.episode_steps
    fell, overload = ends / env.num_envs
    return {"v_x": f"{speed:.2f}", "yaw rate": f"{turn:.2f}", "linear": f"{linear:.2f}", "angular": f"{angular:.2f}",
            "power": f"{power:.0f}", "fell": f"{fell:.0%}", "800 W": f"{overload:.0%}"}  # fmt: skip


def training(folder):
    """A line on what ended the episodes of training, and on how the commands grew."""
    rows = np.genfromtxt(folder / "metrics.csv", delimiter=",", names=True)
    count = {name: rows[name].sum() for name in rows.dtype.names if "ended" in name}
    ends = ", ".join(f"{name.replace('ended_', '')} {total:.0f}" for name, total in count.items())
    first, last = curriculum.initial_weights().mean(), rows["command_area"][-1]
    area = f"area {first:.4f} -> {last:.4f}, {last / first:.2f} times"
    return f"{len(rows)} rows of metrics.csv, ends in them: {ends}; {area}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="+", type=Path, help="run folders of the curriculum")
    parser.add_argument("--episodes", type=int, default=100, help="per command (default: 100)")
    args = parser.parse_args()
    for folder in args.runs:
        mean, env = measure.load(folder, args.episodes)
        print(f"\n`{folder.name}`: {training(folder)}\n")
        for i, (v_x, yaw) in enumerate(COMMANDS):
            row = {"asked v_x, yaw rate": f"{v_x:g}, {yaw:g}"} | follow(mean, env, v_x, yaw)
            if i == 0:
                print("|", " | ".join(row), "|\n" + "|---" * len(row) + "|")
            print("|", " | ".join(row.values()), "|", flush=True)
