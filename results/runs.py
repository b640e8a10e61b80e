"""The runs that are kept, a file for each: results/TASK/NAME.json.

    asked     config.json: every setting; command, commit, machine and versions of each start
    learned   at most 200 rows of its metrics.csv, in the COLUMNS that a reader looks at
    did       what pi and pi' did when they were played, a row for each command and kind of start;
              on velocity also their strides [1/s]
    episodes  on velocity, the peak [m/s] of each episode of pi
    speed     on velocity, the mean speed of pi over time
    reached   on curriculum, the cells that the grid of commands had reached

To keep a run is to write its file, as `python -m results add FOLDER` does, and to drop it is to
delete it. A table is a list of rows, the first of which names the columns.
"""

import json
import math
import os
import shlex
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

import numpy as np

import eipo
import evaluate
import tasks
from runtime import metrics, run_folder
from runtime.cli import Refused, say
from runtime.kinds import Group, Kind

RESULTS = Path(__file__).parent
COLUMNS = "iteration", "steps", "J", "gap", "alpha", "reward", "v_x", "power", "ended_fall"
COLUMNS += "prime_reward", "prime_v_x", "prime_power"
ASKED = "asked_v_x", "asked_v_y", "asked_yaw"
# how many episodes of pi are played from random starts and from the nominal pose, and of pi'
NUM_EPISODES = dict(curriculum=(968, 121, 363), velocity=(1000, 100, 330))
WALKS = 0.25  # m/s, mean speed, the way that was asked for, above which a run walks
# the commands of Figure 5: every v_x [m/s] with every yaw rate [rad/s]
GRID = np.array([(x, 0, yaw) for x in np.linspace(-1, 4, 11) for yaw in np.linspace(-5, 5, 11)])


class Run(NamedTuple):
    """A run that is kept. Tables are {column: (rows,)}, without rows or {} where it has none."""

    name: str
    settings: dict  # every setting by name, and power_formula, what Eq. (9) clipped when it played
    starts: list  # command, commit, machine and versions of each
    learned: dict
    did: dict  # by pi from random starts
    nominal: dict  # by pi from the nominal pose
    prime: dict  # by pi' from random starts
    episodes: dict
    speed: dict
    reached: dict

    @property
    def group(self):
        """Its Group."""
        return Group(self.settings["task"], self.settings["iterations"])

    @property
    def kind(self):
        """The Kind, with words for what is neither usual, nor said by the group or the seed.

        Usual are today's defaults, with alpha's clock for the length of the run (D38). What an
        older run does not say is taken to be usual.
        """
        usual, s = usual_settings(*self.group), self.settings
        said = {"task", "iterations", "seed", "algo", "lam", "aux", "reward"}
        if s["algo"] == "ppo":
            said |= {name for name in s if name.endswith("_alpha")}  # which it does not read
        unknown = sorted(name for name in s.keys() - usual.keys() if s[name])  # to today's code
        names = [name for name in [*usual, *unknown] if name in s and name not in said]
        words = (f"{name} {s[name]}" for name in names if s[name] != usual.get(name))
        return Kind(s["algo"], s["lam"], s["aux"], s["reward"], tuple(words))

    @property
    def lam_end(self):
        """lambda in the end: for EIPO 1 / alpha, of its mean in the last hundred iterations."""
        if self.settings["algo"] == "ppo":
            return self.settings["lam"]
        late = self.learned["iteration"] > self.settings["iterations"] - 100
        alpha = self.learned["alpha"][late].mean()
        return 1 / alpha if alpha > 0 else np.inf

    @property
    def numbers(self):
        """evaluate.numbers of pi from random starts."""
        return evaluate.numbers(self.did)

    @property
    def walks(self):
        """Whether pi walks; where it was asked to go backwards, its speed backwards counts."""
        ahead = np.where(self.did["asked_v_x"] < 0, -1, 1)
        return bool((ahead * self.did["v_x"]).mean() > WALKS)


def usual_settings(task, iterations):
    """Today's settings of a task, as JSON has them, with alpha's clock for runs of this length."""
    settings = asdict(tasks.task_config(task)) | asdict(eipo.Config(**tasks.TASKS[task].learner))
    if task in tasks.ITERATIONS:
        k = tasks.ITERATIONS[task] / max(iterations, settings["iterations"])  # it may be stopped
        settings |= tasks.alpha_clock(k)
    return json.loads(json.dumps(settings | dict(power_formula=evaluate.CLIP)))


# ---- files ----


def read(path):
    """The Run in a file."""
    with run_folder.reading(path):
        kept = json.loads(path.read_text())
        config = kept["asked"]
        tasks.TASKS[config["env"]["task"]]  # which may be of somebody else's code
        settings = config["env"] | config["learner"]
        settings["power_formula"] = config["power_formula"]
        did = columns_of(kept["did"])
        parts = [("pi", 0), ("pi", 1), ("prime", 0)]
        parts = [where((did["policy"] == who) & (did["nominal"] == x), did) for who, x in parts]
        others = [columns_of(kept.get(name)) for name in ("episodes", "speed", "reached")]
        learned = columns_of(kept["learned"])
        return Run(path.stem, settings, config["starts"], learned, *parts, *others)


def read_all(places):
    """The Runs of files, and of all files in folders; one that two places name counts once."""
    found = {}
    for place in map(Path, places):
        with run_folder.reading(place):
            place.stat()  # it is there
        if (place / "config.json").exists():
            raise Refused(f"{place} is a run folder: add it, and name the file that add writes")
        files = sorted(place.glob("*.json")) if place.is_dir() else [place]
        if not files:
            what = "add keeps them in a folder for each task"
            raise Refused(f"{place} holds no run: {what}, {place}/TASK")
        found |= {path.resolve(): path for path in files}
    return [read(path) for path in found.values()]


def text_of(x, indent=""):
    """JSON with a line for each key of a dict, and for each row of a table."""
    deeper = indent + " "
    if isinstance(x, dict) and indent.count(" ") < 3:
        inner = [f"{json.dumps(key)}: {text_of(value, deeper)}" for key, value in x.items()]
        return "{\n" + ",\n".join(deeper + line for line in inner) + f"\n{indent}}}"
    if isinstance(x, list) and x and isinstance(x[0], list | dict):
        return "[\n" + ",\n".join(deeper + json.dumps(row) for row in x) + f"\n{indent}]"
    return json.dumps(x)


def columns_of(table):
    """A table as {column: (rows,)}."""
    if not table:
        return {}
    names, *rows = table
    columns = map(np.array, zip(*rows, strict=True)) if rows else [np.array([])] * len(names)
    return dict(zip(names, columns, strict=True))


def table_of(columns):
    """A table of {column: values}, with five digits of each number that is not whole."""

    def short(x):
        return x if isinstance(x, str) else int(x) if float(x).is_integer() else float(f"{x:.5g}")

    rows = zip(*columns.values(), strict=True)
    return [list(columns), *([short(x) for x in row] for row in rows)]


def where(mine, columns):
    """The columns, of those rows for which `mine` is true."""
    return {name: x[mine] for name, x in columns.items()}


# ---- by kind ----


def by_group(runs, *of):
    """Runs by group and kind, {Group: {Kind: [a Run of each seed, ...]}}.

    of: the tasks to take, if not all. Refused if one of them has no run, or if two runs differ in
    nothing: one of them would count twice.
    """
    groups = {}
    for run in sorted(runs, key=lambda run: (*run.group, run.kind, run.settings["seed"])):
        if not of or run.settings["task"] in of:
            arm = groups.setdefault(run.group, {}).setdefault(run.kind, [])
            if arm and arm[-1].settings["seed"] == run.settings["seed"]:
                what = "differ in nothing, not even the seed: take one of them"
                raise Refused(f"{arm[-1].name} and {run.name} {what}")
            arm.append(run)
    for task in of:
        if task not in (group.task for group in groups):
            raise Refused(f"none of the runs is of the task {task}")
    return groups


def with_primes(kinds):
    """Kinds of runs, as in `by_group`, and after each of EIPO that of its pi', if it was kept."""
    found = {}
    for kind, arm in kinds.items():
        found[kind] = arm
        if kind.algo == "eipo" and all(run.prime["fell"].size for run in arm):
            found[kind._replace(prime=True)] = [
                run._replace(did=run.prime, nominal={}) for run in arm
            ]
    return found


# ---- regions of commands on curriculum: cells of tasks.Grid ----


def cells_of(weights):
    """The cells of tasks.Grid that have a weight: {v_x [m/s] and yaw [rad/s] of their middles}."""
    v_x, yaw = (tasks.Grid.low[[0, 2]] + tasks.Grid.CELL * (np.argwhere(weights) + 0.5)).T
    return dict(v_x=v_x, yaw=yaw)


def inside(v_x, yaw, cells):
    """Which commands lie in any of the cells or on its edge, (n,) bool.

    v_x, yaw: (n,) [m/s], [rad/s]; those of GRID are corners of cells
    """
    pairs = (v_x, cells["v_x"]), (yaw, cells["yaw"])
    near = [np.abs(x[:, None] - middle) <= tasks.Grid.CELL / 2 for x, middle in pairs]
    return np.logical_and(*near).any(1)


# ---- how a run is kept ----


def add(folders, results=RESULTS, num_episodes=None):
    """Play the policies of run folders, and write the file of each into results/TASK.

    num_episodes: of each policy and kind of start, if not NUM_EPISODES. A run of the same name and
    settings is replaced, if it was no longer. What is refused is refused before anything is played.
    """
    found = {}
    for folder in dict.fromkeys(Path(folder).resolve() for folder in folders):
        config, learned, policies = learned_by(folder)
        settings = config["env"] | config["learner"]
        path = results / settings["task"] / f"{folder.name}.json"
        if path in found:
            raise Refused(f"{found[path][0]} and {folder} have one name: rename one of them")
        if path.exists():
            earlier = read(path).settings
            earlier["iterations"] = max(earlier["iterations"], settings["iterations"])  # it went on
            if other := differing(earlier, settings):
                raise Refused(f"{path} has another {other}: rename {folder}")
        kept = dict(asked=config, learned=table_of(thinned(learned)))
        if settings["task"] == "curriculum":  # now, as a run on its way moves on meanwhile
            kept["reached"] = table_of(reached_by(folder, settings["iterations"]))
        found[path] = folder, kept, policies
    for place in {path.parent for path in found}:
        place.mkdir(parents=True, exist_ok=True)
        if not os.access(place, os.W_OK):
            raise Refused(f"{place} cannot be written: give another --results")
    for path, (folder, kept, policies) in found.items():
        kept |= played(policies, kept["asked"]["env"]["task"], num_episodes)
        text = text_of(kept) + "\n"
        run_folder.replace_file(path, lambda file, text=text: file.write(text.encode()))
        say(f"{folder.name}: {len(kept['did']) - 1} commands and starts, now in {path}")


def learned_by(folder):
    """What a run folder says: (config.json, the columns of metrics.csv, and its policies by name).

    Of a run that was stopped, or trains still, all is up to the iteration of its policies.
    """
    names = ["policy"] + ["policy_prime"] * (folder / "policy_prime.npz").exists()
    loaded = {name: run_folder.load_policy(folder / f"{name}.npz") for name in names}
    about, *rivals = (pi.about | pi.config for pi, _ in loaded.values())
    if other := ", ".join(differing(about, x) for x in rivals):
        raise Refused(f"{folder}: pi and pi' have another {other}: --resume the run")
    with run_folder.reading(path := folder / "config.json"):
        config = json.loads(path.read_text())
        run_folder.read_config(config["env"])  # it has all settings
        for start in config["starts"]:
            start["command"] = without_out(start["command"])
        if other := differing(about, config["env"] | config["learner"]):
            raise Refused(f"{folder}: policy.npz and config.json have another {other}")
        log = metrics.read(folder)
        if (last := about["iteration"]) not in log["iteration"]:
            raise Refused(f"{folder}/metrics.csv has no row of iteration {last}, as policy.npz")
        config["learner"]["iterations"] = last  # fewer than asked for, if it was stopped
        config["power_formula"] = evaluate.CLIP
        return config, where(log["iteration"] <= last, log), loaded


def differing(a, b):
    """The names of the settings that both have, and of which they say different things."""
    return ", ".join(sorted(name for name in a.keys() & b.keys() if a[name] != b[name]))


def without_out(command):
    """A command line without --out: where a run was kept is of its machine, and its name stands in
    that of the file.
    """
    words = shlex.split(command)
    out = {i + k for i, word in enumerate(words) if word == "--out" for k in (0, 1)}
    kept = [word for i, word in enumerate(words) if i not in out]
    return shlex.join(word for word in kept if not word.startswith("--out="))


def thinned(log):
    """Every tenth row of a log in COLUMNS, fewer of a run of more than 2000 iterations, and the
    last.
    """
    iteration = log["iteration"]
    every = 10 * math.ceil(iteration[-1] / 2000)
    mine = (iteration % every == 0) | (iteration == iteration[-1])
    return where(mine, {name: log[name] for name in COLUMNS if name in log})


def reached_by(folder, iteration):
    """The `cells_of` what the grid of a run on curriculum had reached, from its checkpoint.

    None of them if the checkpoint is gone, or of another iteration than the policies.
    """
    path = folder / "checkpoint.npz"
    arrays = run_folder.read_npz(path) if path.exists() else {}
    weights = arrays.get("env0.command_weights")
    if weights is None or arrays["state.iteration"] != iteration:
        return dict(v_x=[], yaw=[])
    return cells_of(weights)


def played(policies, task, num_episodes=None):
    """Tables of what the policies did; on velocity of each episode of pi, and its speed over time.

    policies: of `learned_by`; num_episodes: as in `add`
    """
    parts, tables = [], {}
    counts = NUM_EPISODES.get(task, (990, 110, 330))
    cases = [("policy", "pi", False), ("policy", "pi", True), ("policy_prime", "prime", False)]
    for (name, who, nominal), n in zip(cases, counts, strict=True):
        if name in policies:
            pi, env_cfg = policies[name]
            e, v_x = play(pi, env_cfg, nominal, num_episodes or n)
            parts.append(by_command(dict(policy=who, nominal=nominal), e))
            if task == "velocity" and (name, who, nominal) == cases[0]:
                tables["episodes"] = table_of(dict(peak=e["peak"]))
                dt = env_cfg.timestep * env_cfg.physics_steps
                tables["speed"] = table_of(speed_of(v_x, dt))
    did = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return dict(did=table_of(did)) | tables


def play(pi, env_cfg, nominal, n):
    """Columns of at least n episodes of a policy, equally many of each command of the evaluation,
    on curriculum of GRID, and the speed ahead (T, N) [m/s].
    """
    is_grid = env_cfg.task == "curriculum"
    commands = GRID if is_grid else evaluate.commands_of(env_cfg.task)
    commands = np.repeat(commands, math.ceil(n / len(commands)), 0)
    env = evaluate.make_env(evaluate.evaluation_config(env_cfg, nominal=nominal), commands)
    thigh = []  # the angle (N,) [rad] of the right front one in each step

    def watched(obs):
        thigh.append(env.qpos[:, 8].copy())
        return pi.mean(obs)

    episodes, v_x = evaluate.run_episodes(watched, env)
    e = dict(zip(ASKED, commands.T, strict=True)) | episodes._asdict()
    if env_cfg.task == "velocity":
        e["strides"] = strides_of(np.where(np.isnan(v_x), np.nan, thigh), env.dt)
    return e, v_x


def strides_of(angle, dt):
    """How many strides a second robots take, (N,) [1/s]: the strongest frequency of a joint.

    angle:  (T, N) [rad] of the joint, NaN after the end of the episode
    dt: [s] from one row to the next
    """
    swing = np.nan_to_num(angle - np.nanmean(angle, 0))
    strongest = np.abs(np.fft.rfft(swing, axis=0)).argmax(0)
    return np.fft.rfftfreq(len(angle), dt)[strongest]


def by_command(about, e):
    """A row for each command: of the columns e of episodes the means, and of the peak [m/s] and the
    strides the interquartile means.
    """
    commands, which = np.unique(np.stack([e[x] for x in ASKED], 1), axis=0, return_inverse=True)
    which = which.ravel()  # NumPy 2.0.0 has one axis more
    each = [where(which == i, e) for i in range(len(commands))]
    columns = {name: [x] * len(commands) for name, x in about.items()}
    columns |= dict(zip(ASKED, commands.T, strict=True))
    columns["episodes"] = [len(x["fell"]) for x in each]
    columns |= {x: [one[x].mean() for one in each] for x in evaluate.Episodes._fields}
    by_iqm = [x for x in ("peak", "strides") if x in e]
    return columns | {x: [evaluate.iqm(one[x]) for one in each] for x in by_iqm}


def speed_of(v_x, dt):
    """The mean of the speeds (T, N) [m/s] that are not NaN, over time [s], in steps of a third of a
    second, which smooth the strides; dt: [s] from one row to the next
    """
    steps = np.array_split(np.arange(len(v_x)), max(1, int(len(v_x) * dt * 3)))
    time = [dt * (x.mean() + 0.5) for x in steps]
    return dict(time=time, v_x=[np.nanmean(v_x[x]) for x in steps])
