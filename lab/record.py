"""What came out of finished runs: a few tables for each task, from which every figure is drawn.

    results/TASK/runs.csv         a row per run: scores, command, commit, machine, every setting
    results/TASK/metrics.csv.gz   every tenth row of the metrics.csv of each run
    results/TASK/episodes.csv.gz  a row per episode that was played: the policy (pi, or prime for
                                  pi_prime; empty means pi), how it started, what it was asked for,
                                  and what evaluate.Episodes measures
    results/velocity/speed.csv    the mean speed of pi over time, for Figure 6

`python -m lab add RUN...` plays the policies of run folders, and puts them in.
"""

import csv
import gzip
import io
import json
from fnmatch import fnmatchcase
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np

import evaluate
from lab import statistics
from runtime import run_folder

RESULTS = Path(__file__).parents[1] / "results"
RUNS, METRICS, EPISODES, SPEED = "runs.csv", "metrics.csv.gz", "episodes.csv.gz", "speed.csv"
SCORES = "performance", "fell", "performance_nominal", "fell_nominal", "v_x", "peak", "power"
POLICIES = dict(pi="policy.npz", prime="policy_prime.npz")
# to be played of each policy from each kind of start, by results/rules.md and for Figure 5
NUM_EPISODES = dict(flat=330, rough=330, velocity=500, curriculum=968)
# of Figure 5: every v_x [m/s] with every yaw rate [rad/s]
GRID = np.array([(x, 0, yaw) for x in np.linspace(-1, 4, 11) for yaw in np.linspace(-5, 5, 11)])


class Run(NamedTuple):
    """A run that the tables keep."""

    name: str
    settings: dict  # every setting by name, as in config.json
    row: dict  # its row of runs.csv, as text
    metrics: dict  # {column: (rows,)}
    episodes: dict  # {column: (episodes,)}, numbers but for `policy`
    speed: dict  # {column: (times,)}


# ---- tables: lists of dicts of text ----


def read(path):
    """The rows of a CSV file, compressed or not, as dicts of text; none if there is no file."""
    if not path.exists():
        return []
    try:
        data = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
        rows = list(csv.DictReader(io.StringIO(data.decode())))
        if any(None in {*row, *row.values()} for row in rows):
            raise ValueError("a row has another length than the head")
        return rows
    except (OSError, EOFError, ValueError, csv.Error) as error:
        raise ValueError(f"{path} is damaged: {error}") from None


def write(path, rows):
    """Write rows as a CSV file, compressed if its name says so, with the columns of all of them."""
    rows = [{k: f"{x:.5g}" if isinstance(x, float) else x for k, x in r.items()} for r in rows]
    text = io.StringIO(newline="")
    columns = dict.fromkeys(name for row in rows for name in row)
    writer = csv.DictWriter(text, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    data = text.getvalue().encode()
    data = gzip.compress(data, mtime=0) if path.suffix == ".gz" else data
    run_folder.replace_file(path, lambda file: file.write(data))


def by_run(path):
    """A table by run: {run: [row, ...]}."""
    groups = {}
    for row in read(path):
        groups.setdefault(row["run"], []).append(row)
    return groups


def columns(rows):
    """The rows of a run as {column: array}: numbers, but for the name of the policy."""
    if not rows:
        return {}
    names = [name for name, x in rows[0].items() if x and name not in ("run", "policy")]
    table = {name: np.array([row[name] for row in rows], float) for name in names}
    return table | dict(policy=np.array([row.get("policy") or "pi" for row in rows]))


# ---- out of the tables ----


def runs(patterns):
    """The Runs of patterns, each once.

    A pattern is results/TASK, for all runs whose names begin with the task's name, as train.py
    names them, or results/TASK/NAME, in which NAME may have * ? and [...].
    """
    found = {}
    tables = {}
    for path in map(Path, patterns):
        place, name = (path, f"{path.name}-*") if path.is_dir() else (path.parent, path.name)
        if place not in tables:
            tables[place] = [by_run(place / file) for file in (RUNS, METRICS, EPISODES, SPEED)]
        listed, *others = tables[place]
        names = [run for run in listed if fnmatchcase(run, name)]
        if not names:
            raise ValueError(f"{place / RUNS} has no run {name}")
        for run in names:
            (row,) = listed[run]
            parts = (columns(table.get(run)) for table in others)
            found[place, run] = Run(run, settings_of(row), row, *parts)
    return list(found.values())


def settings_of(row):
    """The settings of a row of runs.csv by name, in which `env.` and `learner.` are left out."""
    settings = {name: x for name, x in row.items() if name.startswith(("env.", "learner."))}
    return {name.split(".")[1]: json.loads(x) for name, x in settings.items() if x}


def evaluation(run, policy="pi", nominal=False):
    """The columns of a run's episodes that are of the paper's evaluation.

    policy: "pi" or "prime"; nominal: those from the nominal pose, not those from random poses
    """
    if not (e := run.episodes):
        raise ValueError(f"the tables have no episodes of {run.name}")
    roughness = evaluate.ROUGHNESS.get(run.settings["task"], run.settings["roughness"][1])
    mine = (e["policy"] == policy) & ((e["start_spread"] == 0) == nominal)
    mine &= np.isclose(e["roughness"], roughness)
    mine &= e["torque_clip"] == (run.settings["clip"] == "torque")
    return {name: x[mine] for name, x in e.items()}


# ---- into the tables ----


def add(folders, results=RESULTS, num_episodes=None):
    """Play run folders and put them into the tables of their tasks in the folder `results`.

    num_episodes: of each policy and kind of start, if not NUM_EPISODES. A run of the same name is
    replaced.
    """
    for folder in map(Path, folders):
        row = run_row(folder)
        task = settings_of(row)["task"]
        n = num_episodes or NUM_EPISODES[task]
        played = list(play(folder, task, n))
        row |= scores(Run(folder.name, settings_of(row), row, {}, columns(played), {}))
        parts = {RUNS: [row], METRICS: thinned(folder), EPISODES: played}
        if task == "velocity":
            parts[SPEED] = speed_rows(folder, n)
        (results / task).mkdir(parents=True, exist_ok=True)
        for name, new in parts.items():
            path = results / task / name
            others = [x for x in read(path) if x["run"] != folder.name]
            write(path, sorted([*others, *new], key=itemgetter("run")))


def run_row(folder):
    """The row of runs.csv of a run folder, without scores. What is JSON there is JSON here."""
    path = folder / "config.json"
    try:
        config = json.loads(path.read_text())
        first, *resumed = config["starts"]
        last = config["starts"][-1]
        cfg = config["learner"]
        done = int(read(folder / "metrics.csv")[-1]["iteration"])
        row = dict(run=folder.name, seed=cfg["seed"], iterations=done)
        row |= dict(steps=done * cfg["num_steps"] * cfg["num_envs"])
        row |= dict.fromkeys(("episodes", *SCORES), "")  # `add` fills them in
        row |= {name: first[name] for name in ("command", "commit", "machine")}
        row |= {name: last.get(name, "") for name in ("cpu", "cores")}
        row |= dict(versions=json.dumps(first["versions"]))
        row |= dict(resumed=json.dumps(resumed) if resumed else "")
        for part in ("env", "learner"):
            row |= {f"{part}.{name}": json.dumps(x) for name, x in config[part].items()}
        return row
    except (OSError, KeyError, IndexError, TypeError, ValueError) as error:
        raise ValueError(f"{folder} is not the folder of a run: {error!r}") from None


def thinned(folder):
    """Every tenth row and the last one of a run's metrics, with five digits."""
    rows = read(folder / "metrics.csv")
    for row in rows:
        if int(row["iteration"]) % 10 == 0 or row is rows[-1]:
            cells = {name: f"{float(x):.5g}" for name, x in row.items()}
            whole = {name: f"{float(x):.0f}" for name, x in row.items() if float(x).is_integer()}
            yield dict(run=folder.name) | cells | whole


def play(folder, task, num_episodes):
    """Yields a row per episode of the policies in a folder, from random and from nominal starts.

    Equally many of each command of the evaluation, on curriculum of each command of GRID.
    """
    commands = GRID if task == "curriculum" else evaluate.commands_of(task)
    asked = np.repeat(commands, max(1, num_episodes // len(commands)), 0)
    for policy, file in POLICIES.items():
        for nominal in (False, True) if (folder / file).exists() else ():
            prime = policy == "prime"
            act, env = evaluate.load(folder, len(asked), nominal=nominal, prime=prime)
            played = evaluate.run_episodes(act, env, asked)
            world = env.env_cfg
            table = dict(start_spread=world.start_spread, least_roughness=world.roughness[0])
            table |= dict(roughness=world.roughness[1], torque_clip=world.clip == "torque")
            table |= zip(("asked_v_x", "asked_v_y", "asked_yaw"), asked.T, strict=True)
            table |= played._asdict()
            table = {name: np.broadcast_to(x, len(asked)) for name, x in table.items()}
            for numbers in zip(*table.values(), strict=True):
                cells = (f"{x:.5g}" for x in numbers)
                about = dict(run=folder.name, policy=policy)
                yield about | dict(zip(table, cells, strict=True))


def scores(run):
    """The SCORES of a run for runs.csv: of pi, from random starts unless the name says nominal."""
    row = {}
    for nominal, ending in ((False, ""), (True, "_nominal")):
        e = evaluation(run, nominal=nominal)
        row |= {f"{name}{ending}": f"{of(e):.4g}" for name, of in statistics.NUMBERS.items()}
    return dict(episodes=len(e["fell"])) | {name: row[name] for name in SCORES}


def speed_rows(folder, num_episodes):
    """Yields the mean speed [m/s] of the robots that have not fallen, and the time [s] since the
    start, of each period of the clock, which smooths the strides.
    """
    policy, env = evaluate.load(folder, num_episodes)
    log = [np.where(up, log["v_x"], np.nan) for _, log, up, _ in evaluate.play_episode(policy, env)]
    strides = max(1, int(len(log) * env.period * env.env_cfg.clock_hz))
    for steps in np.array_split(np.arange(len(log)), strides):
        time = env.period * (steps.mean() + 0.5)
        v_x = statistics.finite_mean(np.array(log)[steps])
        yield dict(run=folder.name, time=f"{time:.5g}", v_x=f"{v_x:.5g}")
