"""Which runs the figures and Table I need, and what is kept of a run that has been evaluated.

`evaluate.py --commands table1` prints the runs that are still to be trained. A run's kind is EIPO or PPO(lambda), with
its other cost or reward.
"""

import shlex
from contextlib import suppress
from dataclasses import asdict, fields, replace
from itertools import compress
from pathlib import Path

from matplotlib import colormaps

import eipo
import tasks
import train
from runtime import metrics, run_folder
from runtime.flags import Options, parse, settle

LAMBDAS = (0, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2)  # Eq. (10)
KINDS = ("EIPO", *(f"PPO({lam:g})" for lam in LAMBDAS))
EIPO = ("--algo", "eipo")
PPO = {lam: ("--algo", "ppo", "--lam", f"{lam:g}") for lam in LAMBDAS}
SWEEPS = dict(  # the runs behind each figure and Table I: (task, flags of train.py). Table I has EIPO twice: with as
    # many robots in all as PPO, and with as many per policy
    fig2=[("flat", flags) for flags in (EIPO, PPO[0.005], PPO[0])],
    fig3=[("rough", flags) for flags in (EIPO, PPO[0.005], PPO[0])],
    fig4=[(task, flags) for task in ("flat", "rough") for flags in (EIPO, *PPO.values())],
    fig5=[("curriculum", flags)
          for flags in (EIPO, (*EIPO, "--aux", "smooth"), PPO[0.005], (*PPO[0], "--reward", "shaped"))],
    fig6=[("velocity", flags) for flags in (EIPO, PPO[0.01])],
    table1=[("velocity", flags) for flags in (EIPO, (*EIPO, "--num-envs", "256"), *PPO.values())])  # fmt: skip
SEEDS = dict(fig2=3, fig3=3, fig4=1, fig5=1, fig6=3, table1=3)  # 3 as in V-D, 1 where runs are many or long
RESULTS = Path(__file__).parents[1] / "results"  # where finished runs are kept, in a folder for each task


def by_label(folders, task):
    """The run folders of one task by kind: {"EIPO": [folder of a seed, ...], "PPO(0)": ...}.

    One kind with two numbers of robots is two kinds. Raises ValueError if there are no runs, and for two runs of one
    kind that differ in more than the seed, or not in it.
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
                raise ValueError(f"{first} and {folder} are both {name} but {what}: give one of them")
    order = {name: i for i, name in enumerate(KINDS)}
    return {name: list(groups[name]) for name in sorted(groups, key=lambda x: (order.get(x.split(",")[0], 99), x))}


def kind(env_cfg, cfg):
    """What the paper's figures call a run: EIPO or PPO(lambda), here with its other lambda_0, cost or reward."""
    usual = eipo.Config(**tasks.TASKS[env_cfg.task].learner)
    name = f"PPO({cfg.lam:g})" if cfg.algo == "ppo" else "EIPO" if cfg.lam == usual.lam else f"EIPO from {cfg.lam:g}"
    name += f" at eta_alpha {cfg.lr_alpha:g}" if cfg.algo == "eipo" and cfg.lr_alpha != usual.lr_alpha else ""
    return name + " smooth" * (env_cfg.aux == "smooth") + " shaped" * (env_cfg.reward == "shaped")


def read_by(cfg):
    """cfg, where PPO has the default steps of alpha, which it does not read: runs that differ in them are the same."""
    steps = {f.name: f.default for f in fields(cfg) if f.name.endswith("_alpha")}
    return replace(cfg, **steps) if cfg.algo == "ppo" else cfg


def color(name):
    """The color of a kind of run in every figure: EIPO is blue, and PPO orange to brown. A large lambda is dark."""
    if name.startswith("EIPO"):
        return "#0072B2"
    lam = float(name[len("PPO(") : name.index(")")])
    return colormaps["YlOrBr"](0.3 + 0.07 * sum(x <= lam for x in LAMBDAS))


def missing_runs(what, flags):
    """The train.py commands that a figure or the table still lacks, seeds as in SEEDS; flags: to be added to each."""
    if what not in SWEEPS:
        raise ValueError(f"--commands takes one of {', '.join(SWEEPS)}, and flags of train.py")
    own = {"--task", "--algo", "--lam", "--seed", "--out", "--resume"}
    own |= {flag for _, setting in SWEEPS[what] for flag in setting if flag[:2] == "--"}
    taken = [flag for flag in flags if flag.split("=")[0] in own]
    if taken:
        raise ValueError(f"--commands sets {taken[0]} itself")
    for task, setting in SWEEPS[what]:
        for seed in range(SEEDS[what]):
            argv = ["--task", task, *setting, "--seed", str(seed), *flags]
            if (so_far := progress(argv)) not in ("running", "done"):
                yield shlex.join(["python", "train.py", *argv, *(["--resume"] if so_far else [])])


def progress(argv):
    """How far the run of these train.py arguments is: "" if it has not begun, "running", "started" or "done".

    A run is also done if `evaluate.py ... --out results/TASK` has kept it there.
    """
    options, given_env, given_learner = parse(argv)
    env_cfg, cfg = settle(given_env, given_learner)
    folder = train.run_path(Options(**options), env_cfg, cfg)
    if run_folder.running(folder):
        return "running"
    kept = RESULTS / env_cfg.task / folder.name
    with suppress(ValueError):  # nothing was kept there, or something of another version
        kept_env, kept_cfg = run_folder.load_config(kept)
        if (kept_env, read_by(kept_cfg)) == (env_cfg, read_by(cfg)) and last(kept) >= cfg.iterations:
            return "done"
    if not (folder / "checkpoint.npz").exists():
        return ""
    train.settle_resumed(folder, asdict(env_cfg), asdict(cfg))  # raises if it is a run of other settings
    return "done" if last(folder) >= cfg.iterations else "started"


def keep_runs(out, folders):
    """Keep of every run, in out/NAME, what its numbers rest on: settings, episodes, policy, every tenth row of metrics.

    So a figure can be drawn again without the run, and `--commands` counts a run in results/TASK as done.
    """
    for folder in folders:
        if (kept := out / folder.name).resolve() == folder.resolve() or RESULTS.resolve() in folder.resolve().parents:
            continue  # what stands in results/ is kept already: `fig4 --out results` would copy it
        kept.mkdir(exist_ok=True)
        for name in ("config.json", "policy.npz", run_folder.EPISODES, "metrics.csv"):
            if not (folder / name).exists():
                (kept / name).unlink(missing_ok=True)  # it would be that of another policy
                continue
            data = thinned(folder) if name == "metrics.csv" else (folder / name).read_bytes()
            run_folder.replace_file(kept / name, lambda file, data=data: file.write(data))


def thinned(folder):
    """The metrics.csv of a run, as bytes: every tenth row and the last one, with five digits of what is not whole."""
    columns = metrics.read(folder)
    iterations = columns.get("iteration", [])
    kept = [i % 10 == 0 or i == iterations[-1] for i in iterations]
    rows = compress(zip(*columns.values(), strict=True), kept)
    lines = (",".join(f"{x:.0f}" if float(x).is_integer() else f"{x:.5g}" for x in row) for row in rows)
    return "\n".join([",".join(columns), *lines, ""]).encode()


def last(folder):
    """The last iteration in a run's metrics.csv."""
    return metrics.read(folder).get("iteration", [0])[-1] if (folder / "metrics.csv").exists() else 0
