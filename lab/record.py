"""What came out of finished runs, in three tables for each task instead of a folder for each run.

    results/TASK/runs.csv          a row per run: scores, command, commit, machine, every setting
    results/TASK/metrics.csv.gz    every tenth row of the metrics.csv of each run
    results/TASK/episodes.csv.gz   every episode that was played, see episodes.py

`python -m lab add RUN...` puts runs in. The figures take them out again, into run folders that
last as long as the command.
"""

import csv
import gzip
import io
import json
from dataclasses import asdict
from fnmatch import fnmatchcase
from itertools import compress, groupby
from operator import itemgetter
from pathlib import Path

import numpy as np

import eipo
import evaluate
import tasks
from lab import episodes
from runtime import metrics, run_folder
from runtime.flags import to_config

RESULTS = Path(__file__).parents[1] / "results"
RUNS, METRICS, EPISODES = "runs.csv", "metrics.csv.gz", "episodes.csv.gz"
SCORES = "performance", "fell", "performance_nominal", "fell_nominal", "v_x", "peak", "power"


# ---- tables: lists of dicts of text ----


def read(path):
    """The rows of a CSV file, compressed or not, as dicts of text; none if there is no file."""
    if not path.exists():
        return []
    try:
        data = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
        rows = list(csv.DictReader(io.StringIO(data.decode())))
        if rows and ("run" not in rows[0] or any(None in {*row, *row.values()} for row in rows)):
            raise ValueError("it has no column run, or a row of another length")
        return rows
    except (OSError, EOFError, ValueError, csv.Error) as error:
        raise ValueError(f"{path} is damaged: {error}") from None


def as_csv(rows):
    """The bytes of a CSV of rows, with the columns of all of them in the order of their coming."""
    text = io.StringIO(newline="")
    columns = dict.fromkeys(name for row in rows for name in row)
    writer = csv.DictWriter(text, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


def write(path, rows):
    """Write rows as a CSV file, compressed if its name says so."""
    data = as_csv(rows)
    data = gzip.compress(data, mtime=0) if path.suffix == ".gz" else data
    run_folder.replace_file(path, lambda file: file.write(data))


# ---- a run folder as rows ----


def described(folder):
    """The row of runs.csv of a run folder. What is JSON there is JSON here, entry by entry."""
    record = json.loads((folder / "config.json").read_text())
    env_cfg, cfg = run_folder.load_config(folder)
    about, *resumed = record.get("starts") or [record]  # the oldest runs have one start alone
    done = last_iteration(folder)
    row = dict(run=folder.name, seed=cfg.seed, iterations=f"{done:.0f}")
    row["steps"] = f"{done * cfg.num_steps * cfg.num_envs:.0f}"
    row |= scores(folder, env_cfg)
    row |= {name: about.get(name, "") for name in ("command", "commit", "machine")}
    row |= dict(versions=json.dumps(about.get("versions", {})))
    row |= dict(resumed=json.dumps(resumed) if resumed else "")
    for part, config in (("env", env_cfg), ("learner", cfg)):
        row |= {f"{part}.{name}": json.dumps(x) for name, x in asdict(config).items()}
    return row


def scores(folder, env_cfg):
    """Means over the kept episodes that are of the task's own evaluation, "" where there is none.

    Those of random starts, and of nominal ones where the name says so.
    """
    table = dict(zip(episodes.COLUMNS, episodes.read(folder / EPISODES).T, strict=True))
    roughness = evaluate.ROUGHNESS.get(env_cfg.task, env_cfg.roughness[1])
    usual = (table["roughness"] == roughness) & (table["torque_clip"] == (env_cfg.clip == "torque"))
    row = dict(episodes=int((usual & (table["start_spread"] > 0)).sum()))
    for name in SCORES:
        nominal = name.endswith("_nominal")
        mine = usual & ((table["start_spread"] == 0) == nominal)
        mean = evaluate.finite_mean(table[name.removesuffix("_nominal")][mine])
        row[name] = f"{mean:.4g}" if np.isfinite(mean) else ""
    return row


def last_iteration(folder):
    """The last iteration in a run's metrics.csv, 0 if there is none."""
    there = (folder / "metrics.csv").exists()
    return metrics.read(folder).get("iteration", [0])[-1] if there else 0


def thinned(folder):
    """Every tenth row and the last one of a run's metrics, with five digits."""
    columns = metrics.read(folder) if (folder / "metrics.csv").exists() else {}
    iterations = columns.get("iteration", [])
    kept = [i % 10 == 0 or i == iterations[-1] for i in iterations]
    for row in compress(zip(*columns.values(), strict=True), kept):
        cells = (f"{x:.0f}" if float(x).is_integer() else f"{x:.5g}" for x in row)
        yield dict(run=folder.name) | dict(zip(columns, cells, strict=True))


# ---- in and out ----


def add(folders, results=None):
    """Put run folders into the tables of their tasks.

    results: the folder of the tables, if not ours. A run of the same name and settings is
    replaced. Raises ValueError, and changes nothing, if one of these names stands for a run of
    other settings.
    """
    results = results or RESULTS
    tables = {}
    for folder in map(Path, folders):
        task = run_folder.load_config(folder)[0].task
        if task not in tables:
            names = RUNS, METRICS, EPISODES
            tables[task] = {name: read(results / task / name) for name in names}
        new = described(folder)
        for row in tables[task][RUNS]:
            if row["run"] == folder.name and (changed := differing(row, new)):
                where = results / task / RUNS
                raise ValueError(f"{where} has a {folder.name} of another {', '.join(changed)}")
        played = episodes.read_text(folder / EPISODES)
        rows = {RUNS: [new], METRICS: [*thinned(folder)]}
        rows[EPISODES] = [dict(run=folder.name) | row for row in played]
        for name, more in rows.items():
            others = [row for row in tables[task][name] if row["run"] != folder.name]
            tables[task][name] = sorted([*others, *more], key=itemgetter("run"))
    for task, by_name in tables.items():
        (results / task).mkdir(parents=True, exist_ok=True)
        for name, rows in by_name.items():
            write(results / task / name, rows)


def differing(row, other):
    """The settings, but for the number of iterations, in which two rows of runs.csv differ."""
    names = [name for name in {**row, **other} if name.startswith(("env.", "learner."))]
    names.remove("learner.iterations")
    return [name for name in names if row.get(name) != other.get(name)]


def configs(row):
    """What config.json had, of a row of runs.csv."""
    parts = {"env": {}, "learner": {}}
    for name, x in row.items():
        part, _, field = name.partition(".")
        if part in parts and x:
            parts[part][field] = json.loads(x)
    about = {name: row[name] for name in ("command", "commit", "machine")}
    about["versions"] = json.loads(row["versions"])
    return parts | dict(starts=[about, *json.loads(row["resumed"] or "[]")])


def settings(row):
    """The tasks.Config and eipo.Config of a row of runs.csv."""
    entries = configs(row)
    return to_config(tasks.Config, entries["env"]), to_config(eipo.Config, entries["learner"])


def take_out(pattern, into):
    """Run folders, made in the folder `into`, of what the tables of results/TASK have.

    pattern: results/TASK for all runs whose names begin with the task's name, as `train.py` names
             them, or results/TASK/NAME, in which NAME may have * ? and [...]
    """
    path = Path(pattern)
    place, name = (path, f"{path.name}-*") if path.is_dir() else (path.parent, path.name)
    runs = [row for row in read(place / RUNS) if fnmatchcase(row["run"], name)]
    tables = {file: groups(place / file) for file in (METRICS, EPISODES)}
    for row in runs:
        folder = Path(into) / place.name / row["run"]
        folder.mkdir(parents=True)
        (folder / "config.json").write_text(json.dumps(configs(row)))
        for file, rows in tables.items():
            if row["run"] in rows:
                mine = [without_run(x) for x in rows[row["run"]]]
                write(folder / (file if file == EPISODES else "metrics.csv"), mine)
        yield folder


def without_run(row):
    """A row of a table without its run, and without columns that only other runs have."""
    return {name: x for name, x in row.items() if name != "run" and x != ""}


def groups(path):
    """The rows of a table by run: {name: [row, ...]}."""
    return {name: list(rows) for name, rows in groupby(read(path), itemgetter("run"))}
