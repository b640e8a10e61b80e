"""Episodes are played once: `episodes.csv.gz` in a run folder keeps them for the next figure."""

import csv
import gzip
import io
import zlib
from contextlib import suppress
from pathlib import Path

import numpy as np

import evaluate
import go1_env
from evaluate import Episodes
from runtime import run_folder

ASKED = (
    "start_spread",
    "least_roughness",
    "roughness",
    "torque_clip",
    "asked_v_x",
    "asked_v_y",
    "asked_yaw",
)
COLUMNS = *ASKED, *Episodes._fields


def of_run(folder, commands, each, args, roughness=None, nominal=False):
    """The Episodes of a run's policy: `each` of every command (n, 3), one command after the other.

    They are played once. `episodes.csv.gz` in the run folder keeps them, with five digits, for the
    next figure and for whoever has the folder without its policy. Training deletes it with the next
    policy. Those of another robot are not kept, and fewer episodes do not replace more.

    args: the command line, of which clip and world are as for `evaluate.load`
    """
    folder = Path(folder)
    commands = np.round(commands, 3)
    settings = args.clip, roughness, nominal, args.world
    if args.world is not go1_env.Go1Env:
        return play(folder, commands, each, settings)
    asked = description(folder, commands, *settings[:3])
    table = read(folder / run_folder.EPISODES)
    mine = [(table[:, : len(ASKED)] == row).all(1) for row in asked]
    if all(rows.sum() == each for rows in mine):
        kept = np.concatenate([table[rows] for rows in mine])
        return Episodes(*kept[:, len(ASKED) :].T)
    stamp = stamp_of(folder)
    known = [int(rows.sum()) for rows in mine]
    if min(known) and not stamp:
        raise ValueError(
            f"{folder} has no policy.npz, and its {run_folder.EPISODES} has {min(known)} episodes "
            f"of each command: give --episodes {min(known) * len(asked)}, not {each * len(asked)}"
        )
    new = np.column_stack([np.repeat(asked, each, 0), *play(folder, commands, each, settings)])
    data = packed(np.concatenate([table[~np.any(mine, 0)], new]))
    # a training that saves meanwhile makes these void
    if stamp == stamp_of(folder) and max(known) <= each:
        with suppress(OSError):  # who may not write there plays again the next time
            run_folder.replace_file(folder / run_folder.EPISODES, lambda file: file.write(data))
    return Episodes(*read(io.BytesIO(data))[-len(new) :, len(ASKED) :].T)


def stamp_of(folder):
    """Tells one policy of a run folder from a later one: time and size of policy.npz, or None."""
    policy = folder / "policy.npz"
    return (policy.stat().st_mtime_ns, policy.stat().st_size) if policy.exists() else None


def play(folder, commands, each, settings):
    """The Episodes of a run's policy; settings: what follows the number in `evaluate.load`."""
    policy, env = evaluate.load(folder, each * len(commands), *settings)
    return evaluate.run_episodes(policy, env, np.repeat(commands, each, 0))


def description(folder, commands, clip, roughness, nominal):
    """The columns ASKED (n, 7) of episodes with these commands (n, 3), as the file has them."""
    env_cfg = run_folder.load_config(folder)[0]
    world = evaluate.evaluated(env_cfg, clip, roughness, nominal)
    same = world.start_spread, *world.roughness, world.clip == "torque"
    return np.array([[float(f"{x:.5g}") for x in (*same, *row)] for row in commands])


def both_starts(folder, task, commands, each, args):
    """Two Episodes of a run, from random starts and from the nominal pose: `each` of every command.

    args: the command line, in which a roughness of None is that of the paper's evaluation
    """
    roughness = evaluate.ROUGHNESS.get(task) if args.roughness is None else args.roughness
    return [of_run(folder, commands, each, args, roughness, nominal) for nominal in (False, True)]


def overview(folder, args):
    """A run as a row of `evaluate.summary`, from kept episodes."""
    env_cfg, cfg = run_folder.load_config(folder)
    commands = evaluate.commands_of(env_cfg.task)
    each = max(1, args.episodes // len(commands))
    played, nominal = both_starts(folder, env_cfg.task, commands, each, args)
    return dict(run=folder.name, seed=cfg.seed) | evaluate.summary(played, nominal, commands)


def packed(table):
    """A table (n, COLUMNS) as the bytes of a compressed CSV."""
    text = io.BytesIO()
    np.savetxt(text, table, "%.5g", ",", header=",".join(COLUMNS), comments="")
    return gzip.compress(text.getvalue(), mtime=0)


def read(file):
    """The table in a file that `packed` made, empty if it is missing, damaged or another one."""
    with suppress(OSError, EOFError, ValueError, zlib.error), gzip.open(file, "rt") as text:
        if text.readline().strip() == ",".join(COLUMNS):
            return np.loadtxt(text, delimiter=",", ndmin=2).reshape(-1, len(COLUMNS))
    return np.empty((0, len(COLUMNS)))


def read_text(file):
    """The rows of such a file as dicts of text, to be copied without rounding."""
    if not len(read(file)):
        return []
    with gzip.open(file, "rt") as text:
        return list(csv.DictReader(text))
