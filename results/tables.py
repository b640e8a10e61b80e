"""What came out of finished runs: a few tables for each task, and the kinds of runs in them.

    TASK/runs.csv              a row per run: scores, command, commit, machine, every setting
    TASK/metrics.csv.gz        every tenth row of the metrics.csv of each run
    TASK/episodes.csv.gz       a row per episode that was played: the policy (pi, or prime for
                               pi_prime), how it started, what it was asked for, and what
                               evaluate.Episodes measures
    velocity/speed.csv         the mean speed of pi over time, for Figure 6
    curriculum/reached.csv.gz  a row per cell that the grid of commands had reached in the end

`python -m results add FOLDER...` plays the policies of run folders, and puts them in.
"""

import csv
import gzip
import io
import json
import math
import shlex
from fnmatch import fnmatchcase
from itertools import product
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np

import evaluate
import tasks
from runtime import run_folder
from runtime.cli import Refused, say

RESULTS = Path(__file__).parent
RUNS, METRICS, EPISODES = "runs.csv", "metrics.csv.gz", "episodes.csv.gz"
SPEED, REACHED = "speed.csv", "reached.csv.gz"
POLICIES = dict(pi="policy.npz", prime="policy_prime.npz")
ASKED = "asked_v_x", "asked_v_y", "asked_yaw"  # columns of episodes
# how many are played of pi from random starts, by section 10 of audit/rules.md and for Figure 5
NUM_EPISODES = dict(flat=990, rough=990, velocity=1000, curriculum=968)
# and of pi from the nominal pose, and of pi' from each kind of start
NUM_OTHERS = NUM_EPISODES | dict(flat=330, rough=330)
LAMBDAS = (0, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2)  # Eq. (10)
LAMBDA_0 = dict(flat=0.005, rough=0.0002, velocity=0.0002, curriculum=0.005)  # of EIPO, Section V
PPO = tuple(f"PPO({lam:g})" for lam in LAMBDAS)
KINDS = ("EIPO", *PPO)
# by audit/rules.md, of a difference or of the logarithm of a ratio
MARGINS = {"performance": 0.03, "peak": 0.37, "power": np.log(1.25), "J/m": np.log(1.25)}
# the commands of Figure 5: every v_x [m/s] with every yaw rate [rad/s]
GRID = np.array([(x, 0, yaw) for x in np.linspace(-1, 4, 11) for yaw in np.linspace(-5, 5, 11)])


class Run(NamedTuple):
    """A run that the tables keep."""

    name: str
    settings: dict  # every setting by name, as in config.json
    row: dict  # its row of runs.csv, as text
    metrics: dict  # {column: (rows,)}, up to the iteration of its policy
    episodes: dict  # {column: (episodes,)}, of pi
    prime: dict  # the same of pi_prime
    speed: dict  # {column: (times,)}
    reached: dict  # {column: (cells,)}, as `cells_of`; {} if the tables do not say it


# ---- tables: lists of dicts ----


def read(path):
    """The rows of a CSV file, compressed or not, as dicts of text; none if there is no file."""
    if not path.exists():
        return []
    with run_folder.reading(path):
        data = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
        return list(csv.DictReader(io.StringIO(data.decode("utf-8-sig"))))


def write(path, rows):
    """Write rows as a CSV file, compressed if its name says so, with the columns of all of them.

    Numbers have five digits, and whole ones all of theirs.
    """

    def text(x):
        if not isinstance(x, float):
            return x
        return f"{x:.0f}" if x.is_integer() else f"{x:.5g}"

    out = io.StringIO(newline="")
    columns = dict.fromkeys(name for row in rows for name in row)
    writer = csv.DictWriter(out, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: text(x) for name, x in row.items()} for row in rows)
    data = out.getvalue().encode()
    data = gzip.compress(data, mtime=0) if path.suffix == ".gz" else data
    run_folder.replace_file(path, lambda file: file.write(data))


def grouped(rows, column):
    """Rows by what they have in a column: {"EIPO": [row, ...], ...}."""
    groups = {}
    for row in rows:
        groups.setdefault(row[column], []).append(row)
    return groups


def columns(rows):
    """The rows of a run as numbers, {column: (rows,)}, without columns that it leaves empty."""
    names = [name for name, x in rows[0].items() if x != ""] if rows else []
    names = [name for name in names if name not in ("run", "policy")]
    return {name: np.array([row[name] for row in rows], float) for name in names}


# ---- out of the tables ----


def runs(patterns):
    """The Runs of patterns that have episodes; `python -m results -h` explains the patterns."""
    found = {}  # a run that two patterns find counts once
    for path in map(Path, patterns):
        place, name = path.parent, path.name
        if path.is_dir():
            place, name = path, f"{path.resolve().name}-*"  # of "." too
        with run_folder.reading(place / RUNS):  # somebody may have edited it
            for run in runs_of(place, path, name):
                found[place.resolve(), run.name] = run
    return list(found.values())


def runs_of(place, path, name):
    """Yields the Runs in a folder of tables that fit a pattern, `name`; path: what was asked for"""
    files = (place / file for file in (RUNS, METRICS, EPISODES, SPEED, REACHED))
    listed, metrics, episodes, *others = (grouped(read(file), "run") for file in files)
    if not listed:
        raise Refused(f"{path} has no runs: there is no {place / RUNS}, or it is empty")
    names = [run for run in listed if run == name or fnmatchcase(run, name)]
    if not any(run in episodes for run in names):
        raise Refused(f"{place / RUNS} has no run {name}" + " with episodes" * bool(names))
    for run in names:
        if run in episodes:
            (row,) = listed[run]
            played = grouped(episodes[run], "policy")
            parts = [metrics.get(run, []), played["pi"], played.get("prime", [])]
            parts += [table.get(run, []) for table in others]
            yield Run(run, settings_of(row), row, *map(columns, parts))


def commits(kinds):
    """The commits of all starts of the Runs of some kinds, {kind: [Run, ...]}."""
    rows = [run.row for arm in kinds.values() for run in arm]
    return {x["commit"] for row in rows for x in (row, *json.loads(row["resumed"] or "[]"))}


def settings_of(row):
    """The settings of a row of runs.csv by name, in which `env.` and `learner.` are left out.

    `power_formula` is what Eq. (9) clipped when the run was evaluated. In older tables, which do
    not say it, that is what it clipped in training.
    """
    parts = "env.", "learner.", "evaluation."
    settings = {name: x for name, x in row.items() if name.startswith(parts) and x}
    settings = {name.split(".")[1]: json.loads(x) for name, x in settings.items()}
    settings.setdefault("power_formula", settings["clip"])
    return settings


def differing(a, b):
    """The names of the settings that both have, and of which they say different things."""
    return ", ".join(sorted(x for x in a.keys() & b.keys() if a[x] != b[x]))


def evaluation(e, nominal=False):
    """Of the columns e of episodes those from random poses, or those from the nominal one."""
    # older tables do not say it. They have no run that was trained from the nominal pose
    mine = e["nominal"] if "nominal" in e else e["start_spread"] == 0
    return where(mine == nominal, e)


def where(mine, e):
    """The columns e of those episodes for which `mine` is true."""
    return {name: x[mine] for name, x in e.items()}


def numbers_of(e):
    """evaluate.numbers of the columns e from random starts, and two of them from nominal ones."""
    random, nominal = (evaluate.numbers(evaluation(e, start)) for start in (False, True))
    return random | {f"{name}_nominal": nominal[name] for name in ("performance", "fell")}


def means(arm):
    """`numbers_of` each run of an arm, {name: (runs,)}, and their means, {name: float}."""
    each = [numbers_of(run.episodes) for run in arm]
    each = {name: np.array([row[name] for row in each]) for name in each[0]}
    return each, {name: x.mean() for name, x in each.items()}


# ---- kinds of runs: EIPO or PPO(lambda), and in what else a run is unlike others in its table ----


def group(settings):
    """What a run is compared within, its task and its length: "flat, 600 iterations"."""
    return f"{settings['task']}, {settings['iterations']} iterations"


def task_of(group):
    """The task of a group."""
    return group.split(",")[0]


def score_of(group):
    """Which of evaluate.numbers says how well the task of a group is done."""
    return "peak" if task_of(group) == "velocity" else "performance"


def unsaid(settings):
    """The settings that a run reads, and that neither its group, its seed nor a plain name says."""
    said = {"task", "iterations", "seed", "algo", "aux", "reward"}
    if settings["algo"] == "ppo":  # whose name has lambda, and which reads no step of alpha
        said |= {"lam", *(name for name in settings if name.endswith("_alpha"))}
    return {name: x for name, x in settings.items() if name not in said}


def kind(settings, usual):
    """What tables and figures call a run with these settings, {name: setting}.

    usual: the settings that need no word in its table; what a run does not say is unknown
    """
    name = f"PPO({settings['lam']:g})" if settings["algo"] == "ppo" else "EIPO"
    other = {x: y for x, y in unsaid(settings).items() if y != usual[x]}
    if "lam" in other:
        name += f" from {other.pop('lam'):g}"
    name += " smooth" * (settings["aux"] == "smooth") + " shaped" * (settings["reward"] == "shaped")
    return name + "".join(f", {x} {y}" for x, y in other.items())


def usual_of(all_settings):
    """The settings that need no word in a table of runs with these settings, as `kind` takes them:
    what most of them have, or the first one where two are as frequent.

    Today's defaults are not asked, so no kept run is renamed when they change. lambda_0 is the
    paper's, and runs from it with the paper's reward and cost decide on the rest, if there are any.
    """
    (task,) = {s["task"] for s in all_settings}
    usual, paper = {}, dict(lam=LAMBDA_0[task]) if task in LAMBDA_0 else {}
    plain = [
        s
        for s in all_settings
        if (s["aux"], s["reward"]) == ("energy", "paper")
        and (s["algo"] == "ppo" or s["lam"] == paper.get("lam", s["lam"]))
    ]
    for some in (all_settings, plain):
        values = {}
        for s in some:
            for name, x in unsaid(s).items():
                values.setdefault(name, []).append(x)
        usual |= {name: max(each, key=each.count) for name, each in values.items()}
    return usual | paper


def by_group(runs, *of):
    """Runs by group and kind, {"flat, 600 iterations": {"EIPO": [a Run of each seed, ...]}, ...}.

    of: the tasks to take, if not all. Refused if one of them has no run.
    """
    groups = {}
    for run in runs:
        if not of or run.settings["task"] in of:
            groups.setdefault(group(run.settings), []).append(run)
    for task in of:
        if task not in map(task_of, groups):
            raise Refused(f"none of the runs is of the task {task}")
    return {name: by_kind(runs) for name, runs in groups.items()}


def by_kind(runs):
    """The runs of one group by kind, whose names say in what they are unlike most of the others.

    Refused if two of one kind have the same seed: one of them would count twice.
    """
    usual = usual_of([run.settings for run in runs])
    kinds = {}
    for run in runs:
        same = kinds.setdefault(kind(run.settings, usual), {})
        other = same.setdefault(run.settings["seed"], run)
        if other is not run:
            raise Refused(f"{other.name} and {run.name} differ in nothing, not even the seed")
    kinds = {name: list(arm.values()) for name, arm in kinds.items()}
    place = {name: i for i, name in enumerate(KINDS)}
    last = len(KINDS)
    return dict(sorted(kinds.items(), key=lambda x: (place.get(x[0].split(",")[0], last), x[0])))


def with_primes(kinds):
    """Kinds of runs, as in `by_group`, and after each kind of EIPO its "pi' of EIPO ..."."""
    found = {}
    for name, arm in kinds.items():
        found[name] = arm
        if primes := [run._replace(episodes=run.prime) for run in arm if run.prime]:
            found[f"pi' of {name}"] = primes
    return found


# ---- regions of commands on curriculum: cells of tasks.Grid ----


def cells_of(weights):
    """The cells of tasks.Grid that have a weight, {column: (cells,)}.

    v_x [m/s] and yaw [rad/s] are of the middle of a cell; weight: [-]
    """
    at = np.nonzero(weights)
    v_x, yaw = (tasks.Grid.low[[0, 2]] + tasks.Grid.CELL * (np.transpose(at) + 0.5)).T
    return dict(v_x=v_x, yaw=yaw, weight=weights[at])


def start_box():
    """The cells of commands with which the grid starts, as `cells_of`."""
    return cells_of(tasks.Grid().weights)


def inside(v_x, yaw, cells):
    """Which commands lie in any of the cells or on its edge, (n,) bool.

    v_x, yaw: (n,) [m/s], [rad/s]; those of GRID are corners of cells
    """
    asked = ((v_x, cells["v_x"]), (yaw, cells["yaw"]))
    near = [np.abs(x[:, None] - middle) <= tasks.Grid.CELL / 2 for x, middle in asked]
    return np.logical_and(*near).any(1)


def within(run, cells):
    """A Run with no more than the episodes that ask for a command inside the cells."""

    def part(e):
        return where(inside(e["asked_v_x"], e["asked_yaw"], cells), e) if e else e

    return run._replace(episodes=part(run.episodes), prime=part(run.prime))


def by_region(groups):
    """Groups of runs, as in `by_group`. After a group on curriculum come two of the same runs with
    fewer commands: those with which the grid starts, and those that it had reached when training
    ended, the latter of the kinds whose runs all say so.
    """
    found = {}
    for group, kinds in groups.items():
        found[group] = kinds
        if task_of(group) == "curriculum":
            box = {name: [within(run, start_box()) for run in arm] for name, arm in kinds.items()}
            reached = {
                name: [within(run, run.reached) for run in arm]
                for name, arm in kinds.items()
                if all(run.reached for run in arm)
            }
            found |= {f"{group}, start box": box, f"{group}, reached": reached}
    return {group: kinds for group, kinds in found.items() if kinds}


# ---- into the tables ----


def add(folders, results=RESULTS, num_episodes=None):
    """Play run folders and put them into the tables of their tasks in the folder `results`.

    num_episodes: of each policy and kind of start, if not NUM_EPISODES and NUM_OTHERS. A run of the
    same name and settings is replaced. What is refused is refused before anything is played, but
    for a run that is trained on meanwhile.
    """
    for folder, about, row, parts in to_add(folders, results):
        task = settings_of(row)["task"]
        (results / task).mkdir(parents=True, exist_ok=True)
        played, speeds = play(folder, task, num_episodes)
        if learned(folder)[0] != about:
            raise Refused(f"{folder} was trained on meanwhile: add it again when it is done")
        mine = columns(grouped(played, "policy")["pi"])
        parts = parts | {EPISODES: played}
        if task == "velocity":
            parts[SPEED] = speeds
        # last: what stops before it leaves no run without episodes
        parts[RUNS] = [dict(run=folder.name) | numbers_of(mine) | row]
        with run_folder.lock(results / task, wait=True):  # two may add at a time
            for file, new in parts.items():
                path = results / task / file
                others = [x for x in read(path) if x["run"] != folder.name]
                write(path, sorted([*others, *new], key=itemgetter("run")))
        say(f"{folder.name}: {len(played)} episodes, now in {results / task}")


def to_add(folders, results):
    """What `add` takes from run folders without playing them: a list of (folder, what its policies
    say of themselves, its row of runs.csv without scores, {table: rows}).

    Refused if one of them is not a run, or not the one that has its name in a table already.
    """
    found = {}
    for folder in dict.fromkeys(Path(folder).resolve() for folder in folders):
        if folder.name in found:
            raise Refused(f"{found[folder.name][0]} and {folder} have one name: rename one of them")
        about, metrics = learned(folder)
        row = run_row(folder, int(metrics[-1]["iteration"]))
        settings = settings_of(row)
        del settings["iterations"]  # a run that goes on has more
        if other := differing(about, settings):
            raise Refused(f"{folder}: policy.npz and config.json have another {other}")
        for kept in read(path := results / settings["task"] / RUNS):
            other = differing(settings_of(kept), settings)
            if kept["run"] == folder.name and other:
                raise Refused(f"{path} has a {folder.name} with another {other}: rename the folder")
        parts = {METRICS: thinned(folder.name, metrics)}
        if settings["task"] == "curriculum":
            parts[REACHED] = reached_rows(folder, row["iterations"])
        found[folder.name] = folder, about, row, parts
    return list(found.values())


def learned(folder):
    """What the policies of a run folder say of themselves and of their world, and the rows of its
    metrics.csv, as numbers, up to their iteration. Later ones are of a policy that was not saved.
    """
    files = [folder / POLICIES["pi"]]
    files += [path for path in [folder / POLICIES["prime"]] if path.exists()]
    loaded = [run_folder.load_policy(path)[0] for path in files]
    about, *prime = (pi.about | pi.config for pi in loaded)
    if prime not in ([], [about]):
        other = differing(about, prime[0]) or "iteration"  # which older ones do not say
        raise Refused(f"{folder}: pi and pi' have another {other}: --resume the run")
    rows = read(path := folder / "metrics.csv")
    with run_folder.reading(path):
        path.stat()  # it is there
        iterations = [int(row["iteration"]) for row in rows]
        last = about.get("iteration", iterations[-1])
    if last not in iterations:
        raise Refused(f"{path} has no row of iteration {last}, of which policy.npz is")
    with run_folder.reading(path):  # a copy may have half a row at its end
        rows = rows[: iterations.index(last) + 1]
        return about, [{name: float(x) for name, x in row.items()} for row in rows]


def run_row(folder, done):
    """The row of runs.csv of a run folder, without scores. What is JSON there is JSON here.

    done: the iterations of its policy, fewer than were asked for if it was stopped
    """
    with run_folder.reading(folder / "config.json"):
        config = json.loads((folder / "config.json").read_text())
        run_folder.read_config(config["env"])  # it has all settings
        for start in config["starts"]:
            start["command"] = without_out(start["command"])
        first, *resumed = config["starts"]
        cfg = config["learner"]
        cfg["iterations"] = done
        row = dict(seed=cfg["seed"], iterations=done)
        row |= dict(steps=done * cfg["num_steps"] * cfg["num_envs"])
        row |= {name: x if isinstance(x, str | int) else json.dumps(x) for name, x in first.items()}
        row |= dict(resumed=json.dumps(resumed) if resumed else "")
        for part in ("env", "learner"):
            row |= {f"{part}.{name}": json.dumps(x) for name, x in config[part].items()}
        return row | {"evaluation.power_formula": json.dumps(evaluate.CLIP)}


def without_out(command):
    """A command line without --out: where a run was kept is of its machine, and its name stands in
    the table anyway.
    """
    words = shlex.split(command)
    out = {i + k for i, word in enumerate(words) if word == "--out" for k in (0, 1)}
    kept = [word for i, word in enumerate(words) if i not in out]
    return shlex.join(word for word in kept if not word.startswith("--out="))


def thinned(name, rows):
    """Yields every tenth row and the last one of the metrics of a run."""
    for row in rows:
        if row["iteration"] % 10 == 0 or row is rows[-1]:
            yield dict(run=name) | row


def reached_rows(folder, iteration):
    """Rows of the `cells_of` what the grid of a run on curriculum had reached, from its checkpoint.

    None of them if the checkpoint is gone, of an older version, or of another iteration than the
    policies.
    """
    path = folder / "checkpoint.npz"
    arrays = run_folder.read_npz(path) if path.exists() else {}
    weights = arrays.get("env0.command_weights")
    if weights is None or arrays["state.iteration"] != iteration:
        return []
    cells = cells_of(weights)
    rows = zip(*cells.values(), strict=True)
    return [dict(run=folder.name) | dict(zip(cells, row, strict=True)) for row in rows]


def play(folder, task, num_episodes=None):
    """Rows of the episodes of the policies in a folder, from random and from nominal starts, and
    those of pi's speed from random ones; num_episodes: as in `add`.

    Equally many of each command of the evaluation, on curriculum of each command of GRID.
    """
    commands = GRID if task == "curriculum" else evaluate.commands_of(task)
    policies = [name for name, file in POLICIES.items() if (folder / file).exists()]
    rows, speeds = [], []
    for policy, nominal in product(policies, (False, True)):
        is_main = policy == "pi" and not nominal  # of which there are most episodes
        n = num_episodes or (NUM_EPISODES if is_main else NUM_OTHERS).get(task, 330)
        asked = np.repeat(commands, math.ceil(n / len(commands)), 0)
        pi, env_cfg = evaluate.load(folder, nominal=nominal, prime=policy == "prime")
        env = evaluate.make_env(env_cfg, asked)
        episodes, v_x = evaluate.run_episodes(pi.mean, env)
        if is_main:
            speeds = [dict(run=folder.name) | row for row in speed_rows(v_x, env)]
        table = dict(zip(ASKED, asked.T, strict=True)) | episodes._asdict()
        row = dict(run=folder.name, policy=policy, nominal=int(nominal))
        for numbers in zip(*table.values(), strict=True):
            rows.append(row | dict(zip(table, map(float, numbers), strict=True)))
    return rows, speeds


def speed_rows(v_x, env):
    """Yields the mean of the speeds (T, N) [m/s] that are not NaN, and the time [s], of each period
    of the clock, which smooths the strides.
    """
    strides = max(1, int(len(v_x) * env.period * env.env_cfg.clock_hz))
    for steps in np.array_split(np.arange(len(v_x)), strides):
        yield dict(time=env.period * (steps.mean() + 0.5), v_x=np.nanmean(v_x[steps]))
