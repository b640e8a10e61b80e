"""How policies move: `python results/gait.py RUN...` prints a row of a Markdown table for each run folder.

Episodes under the deterministic policy, as in measure.py; --command VX is the forward velocity asked for [m/s], by
default what the task draws. From the third second on, of the robots that have not fallen:

    pitch          [deg] of the trunk, nose up is positive
    FR FL RR RL    share of the time that each foot is on the ground
    flight         share of the time that no foot is
    trot pace bound  correlation of the contacts of diagonal feet, of those of one side, and of front and of hind pairs
    fell           share of the robots, in the first two seconds and later
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import evaluate
import go1_env
import measure
import run_folder

PAIRS = dict(trot=((0, 3), (1, 2)), pace=((0, 2), (1, 3)), bound=((0, 1), (2, 3)))  # of FR, FL, RR, RL
SETTLED = 100  # control steps, 2 s


def pitch(quaternion):
    """Angle [deg] of the trunk's x axis above the horizon, (N,); quaternion: (N, 4) w, x, y, z."""
    w, x, y, z = quaternion.T
    return np.degrees(np.arcsin(np.clip(2 * (x * z - w * y), -1, 1)))


def gait(folder, episodes, command, roughness):
    """What the columns of the table are, by name."""
    mean, env = measure.load(folder, episodes, roughness=roughness)
    given = None if command is None else np.tile([command, 0.0, 0.0], (episodes, 1))
    falls, seen = np.zeros(2), []
    for t, (_, log, alive, fell) in enumerate(measure.steps(mean, env, given)):
        falls[int(t >= SETTLED)] += fell.sum()
        if t >= SETTLED:
            touch = env.contacts[:, go1_env.FEET] > 0
            seen.append(np.column_stack([log["v_x"], log["power"], pitch(env.qpos[:, 3:7]), touch])[alive & ~fell])
    v_x, power, angle, *feet = np.concatenate(seen).T
    together = np.corrcoef(feet)
    columns = {
        "v_x [m/s]": f"{v_x.mean():.2f}",
        "power [W]": f"{power.mean():.0f}",
        "pitch [deg]": f"{angle.mean():.0f}",
    }
    columns |= {"FR FL RR RL": " ".join(f"{foot.mean():.2f}" for foot in feet)}
    columns |= {"flight": f"{np.mean(np.sum(feet, 0) == 0):.2f}"}
    columns |= {name: f"{np.mean([together[pair] for pair in pairs]):.2f}" for name, pairs in PAIRS.items()}
    return columns | {"fell": " + ".join(f"{100 * n / episodes:.1f} %" for n in falls)}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="+")
    parser.add_argument("--command", type=float)
    parser.add_argument("--roughness", type=float, help="m, of the ground")
    parser.add_argument("--episodes", type=int, default=200)
    args = parser.parse_args()
    for i, run in enumerate(args.runs):
        task = run_folder.load_config(Path(run))[0].task
        roughness = evaluate.ROUGHNESS.get(task) if args.roughness is None else args.roughness
        row = gait(run, args.episodes, args.command, roughness)
        if i == 0:
            print("|", " | ".join(["run", *row]), "|\n|" + "---|" * (len(row) + 1))
        print("|", " | ".join([Path(run).name, *row.values()]), "|", flush=True)
