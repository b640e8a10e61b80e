"""Which runs the figures and Table I need: `python -m lab missing table1` prints what is left.

A run's kind is EIPO or PPO(lambda), with its other cost or reward.
"""

import shlex
from contextlib import nullcontext
from dataclasses import asdict, fields, replace
from pathlib import Path

from matplotlib import colormaps

import eipo
import tasks
import train
from lab import record
from runtime import run_folder
from runtime.flags import Options, parse, settle

LAMBDAS = (0, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2)  # Eq. (10)
KINDS = ("EIPO", *(f"PPO({lam:g})" for lam in LAMBDAS))
EIPO = ("--algo", "eipo")
PPO = {lam: ("--algo", "ppo", "--lam", f"{lam:g}") for lam in LAMBDAS}
# the runs behind each figure and Table I: (task, flags of train.py). Table I has EIPO twice: with
# as many robots in all as PPO, and with as many per policy
SWEEPS = dict(
    fig2=[("flat", flags) for flags in (EIPO, PPO[0.005], PPO[0])],
    fig3=[("rough", flags) for flags in (EIPO, PPO[0.005], PPO[0])],
    fig4=[(task, flags) for task in ("flat", "rough") for flags in (EIPO, *PPO.values())],
    fig5=[
        ("curriculum", flags)
        for flags in (EIPO, (*EIPO, "--aux", "smooth"), PPO[0.005], (*PPO[0], "--reward", "shaped"))
    ],
    fig6=[("velocity", flags) for flags in (EIPO, PPO[0.01])],
    table1=[("velocity", flags) for flags in (EIPO, (*EIPO, "--num-envs", "256"), *PPO.values())],
)
# 3 as in V-D, 1 where runs are many or long
SEEDS = dict(fig2=3, fig3=3, fig4=1, fig5=1, fig6=3, table1=3)


def by_label(folders, task):
    """The run folders of one task by kind: {"EIPO": [folder of a seed, ...], "PPO(0)": ...}.

    One kind with two numbers of robots is two kinds. Raises ValueError if there are no runs, and
    for two runs of one kind that differ in more than the seed, or not in it.
    """
    configs = {folder: run_folder.load_config(folder) for folder in map(Path, folders)}
    configs = {folder: both for folder, both in configs.items() if both[0].task == task}
    if not configs:
        raise ValueError(f"none of the run folders is of the task {task}")
    sizes = {}
    for env_cfg, cfg in configs.values():
        sizes.setdefault(kind(env_cfg, cfg), set()).add(cfg.num_envs)
    groups = {}
    for folder, (env_cfg, cfg) in configs.items():
        name = kind(env_cfg, cfg)
        name += f", {cfg.num_envs} robots" if len(sizes[name]) > 1 else ""
        groups.setdefault(name, {})[folder] = asdict(env_cfg) | asdict(read_by(cfg))
    for name, runs in groups.items():
        (first, settings), *others = runs.items()
        for folder, other in others:
            differing = [field for field in settings if settings[field] != other[field]]
            if differing != ["seed"]:
                what = f"differ in {', '.join(differing)}" if differing else "have the same seed"
                raise ValueError(
                    f"{first} and {folder} are both {name} but {what}: give one of them"
                )
    order = {name: i for i, name in enumerate(KINDS)}
    return {
        name: list(groups[name])
        for name in sorted(groups, key=lambda x: (order.get(x.split(",")[0], 99), x))
    }


def kind(env_cfg, cfg):
    """What the figures call a run: EIPO or PPO(lambda), with another lambda_0, cost or reward."""
    usual = eipo.Config(**tasks.TASKS[env_cfg.task].learner)
    if cfg.algo == "ppo":
        name = f"PPO({cfg.lam:g})"
    else:
        name = "EIPO" + f" from {cfg.lam:g}" * (cfg.lam != usual.lam)
        name += f" at eta_alpha {cfg.lr_alpha:g}" * (cfg.lr_alpha != usual.lr_alpha)
    return name + " smooth" * (env_cfg.aux == "smooth") + " shaped" * (env_cfg.reward == "shaped")


def read_by(cfg):
    """cfg as PPO reads it. Runs of PPO that differ only in the steps of alpha are the same."""
    steps = {f.name: f.default for f in fields(cfg) if f.name.endswith("_alpha")}
    return replace(cfg, **steps) if cfg.algo == "ppo" else cfg


def color(name):
    """The color of a kind of run in every figure: EIPO is blue, PPO yellow to brown by lambda.

    There are five for PPO, which one can tell apart: of 0, up to 0.0005, 0.002, 0.005 and more.
    """
    if name.startswith("EIPO"):
        return "#0072B2"
    lam = float(name[len("PPO(") : name.index(")")])
    group = sum(x < lam for x in (0, 5e-4, 2e-3, 5e-3))
    return colormaps["YlOrBr"]((0.3, 0.45, 0.6, 0.78, 1.0)[group])


def missing_runs(what, flags):
    """Yields the train.py commands that a figure or the table still lacks; flags: added to each."""
    if what not in SWEEPS:
        raise ValueError(f"missing takes one of {', '.join(SWEEPS)}, and flags of train.py")
    own = {"--task", "--algo", "--lam", "--seed", "--out", "--resume"}
    own |= {flag for _, setting in SWEEPS[what] for flag in setting if flag[:2] == "--"}
    taken = [flag for flag in flags if flag.split("=")[0] in own]
    if taken:
        raise ValueError(f"missing sets {taken[0]} itself")
    for task, setting in SWEEPS[what]:
        for seed in range(SEEDS[what]):
            argv = ["--task", task, *setting, "--seed", str(seed), *flags]
            if (so_far := progress(argv)) not in ("running", "done"):
                yield shlex.join(["python", "train.py", *argv, *(["--resume"] if so_far else [])])


def progress(argv):
    """How far the run of these arguments of train.py is: "", "running", "started" or "done".

    A run is also done if `python -m lab add` has put it into results/.
    """
    options, given_env, given_learner = parse(argv)
    env_cfg, cfg = settle(given_env, given_learner)
    folder = train.run_path(Options(**options), env_cfg, cfg)
    if running(folder):
        return "running"
    if in_results(folder.name, env_cfg, cfg):
        return "done"
    if not (folder / "checkpoint.npz").exists():
        return ""
    # raises if it is a run of other settings
    train.settle_resumed(folder, asdict(env_cfg), asdict(cfg))
    return "done" if record.last_iteration(folder) >= cfg.iterations else "started"


def running(folder):
    """Whether a process is training in the folder."""
    try:
        with run_folder.lock(folder) if (folder / "lock").exists() else nullcontext():
            return False
    except (ValueError, OSError) as error:
        return isinstance(error, ValueError)


def in_results(name, env_cfg, cfg):
    """Whether the tables of results/ have the run of this name, with these settings, to its end."""
    for row in record.read(record.RESULTS / env_cfg.task / record.RUNS):
        if row["run"] == name:
            kept_env, kept = record.settings(row)
            same = (kept_env, read_by(kept)) == (env_cfg, read_by(cfg))
            return same and int(row["iterations"]) >= cfg.iterations
    return False
