"""Episodes are played once: `episodes.csv.gz` in a run folder keeps what was measured, for the next figure or table."""

import gzip
import io
import zlib
from contextlib import suppress
from pathlib import Path

import numpy as np

import measure
from measure import Episodes
from runtime import policy_file, run_folder
from studies import sweep

ASKED = ("start_spread", "least_roughness", "roughness", "torque_clip", "asked_v_x", "asked_v_y", "asked_yaw")
ROUGHNESS = {"rough": 0.15}  # m, of the ground on which a task is evaluated, where it is not that of training [V-B]


def of_run(folder, commands, each, clip=None, roughness=None, nominal=False, robot=None):
    """The Episodes of a run's policy, each of commands (n, 3) `each` times, one command after the other.

    They are played once. `episodes.csv.gz` in the run folder keeps them, with five digits, for the next figure and for
    whoever has the folder without its policy. Training deletes it with the next policy. Those of another robot are not
    kept, and fewer episodes do not replace more. What stands in results/ is a record and stays as it is.
    Other arguments: as for `measure.load`.
    """
    folder, commands = Path(folder), np.round(commands, 3)
    if robot is not None:
        loaded = measure.load(folder, each * len(commands), clip, roughness, nominal, robot=robot)
        return measure.run_episodes(*loaded, np.repeat(commands, each, 0))
    world = measure.evaluated(run_folder.load_config(folder)[0], clip, roughness, nominal)
    asked = [(world.start_spread, *world.roughness, world.clip == "torque", *row) for row in commands]
    asked = np.array([[float(f"{x:.5g}") for x in row] for row in asked])  # as the file has them
    table = unpack(folder / run_folder.EPISODES)
    mine = [(table[:, : len(ASKED)] == row).all(1) for row in asked]
    if any(rows.sum() != each for rows in mine):
        stamp, least = policy_file.stamp(folder), min(rows.sum() for rows in mine)
        if least and not stamp:
            raise ValueError(f"{folder} has no policy.npz, and its {run_folder.EPISODES} has {least} episodes of each "
                             f"command: give --episodes {least * len(asked)}, not {each * len(asked)}")  # fmt: skip
        loaded = measure.load(folder, each * len(asked), clip, roughness, nominal)
        played = measure.run_episodes(*loaded, np.repeat(commands, each, 0))
        new = np.column_stack([np.repeat(asked, each, 0), *played])
        data = pack(np.concatenate([table[~np.any(mine, 0)], new]))
        record = sweep.RESULTS.resolve() in folder.resolve().parents or max(rows.sum() for rows in mine) > each
        if stamp == policy_file.stamp(folder) and not record:  # a training that saves meanwhile makes these void
            with suppress(OSError):  # who may not write there plays again the next time
                run_folder.replace_file(folder / run_folder.EPISODES, lambda file: file.write(data))
        return Episodes(*unpack(io.BytesIO(data))[-len(new) :, len(ASKED) :].T)
    for watch in measure.watchers:
        watch(False)
    return Episodes(*np.concatenate([table[rows] for rows in mine])[:, len(ASKED) :].T)


def both_starts(folder, task, commands, each, args):
    """Two Episodes of a run, each command (n, 3) `each` times: with random starts, then with nominal ones (D35).

    args: clip, roughness and robot as for `measure.load`, where a roughness of None is that of the paper's evaluation
    """
    roughness = ROUGHNESS.get(task) if args.roughness is None else args.roughness
    return [of_run(folder, commands, each, args.clip, roughness, nominal, args.robot) for nominal in (False, True)]


def pack(table):
    """A table (n, columns of ASKED and of Episodes) as the bytes of a compressed CSV."""
    np.savetxt(text := io.BytesIO(), table, "%.5g", ",", header=",".join((*ASKED, *Episodes._fields)), comments="")
    return gzip.compress(text.getvalue(), mtime=0)


def unpack(file):
    """The table in a file that `pack` made, empty if the file is missing, damaged or of other columns."""
    columns = *ASKED, *Episodes._fields
    with suppress(OSError, EOFError, ValueError, zlib.error), gzip.open(file, "rt") as text:
        if text.readline().strip() == ",".join(columns):
            return np.loadtxt(text, delimiter=",", ndmin=2).reshape(-1, len(columns))
    return np.empty((0, len(columns)))
