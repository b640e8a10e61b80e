"""Kinds of runs, and which runs the figures and Table I need: `python -m lab sweep table1`.

A run's kind is EIPO or PPO(lambda), and whatever else of it is not usual for its task.
"""

import shlex

from matplotlib import colormaps

import eipo
import tasks

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
    fig6=[("velocity", flags) for flags in (EIPO, PPO[0], PPO[0.0001], PPO[0.01])],
    table1=[("velocity", flags) for flags in (EIPO, (*EIPO, "--num-envs", "256"), *PPO.values())],
)


def commands(what, seeds, flags):
    """Yields the train.py commands of the runs behind a figure; flags: added to each."""
    if what not in SWEEPS:
        raise ValueError(f"sweep takes one of {', '.join(SWEEPS)}")
    for task, setting in SWEEPS[what]:
        for seed in seeds:
            argv = ["--task", task, *setting, "--seed", str(seed), *flags]
            yield shlex.join(["python", "train.py", *argv])


def kind(settings):
    """What the figures call a run with these settings, {name: setting}."""
    s = settings
    usual = eipo.Config(**tasks.TASKS[s["task"]].learner)
    name = "EIPO" if s["algo"] == "eipo" else f"PPO({s['lam']:g})"
    if s["algo"] == "eipo":
        name += f" from {s['lam']:g}" * (s["lam"] != usual.lam)
        name += f" at eta_alpha {s['lr_alpha']:g}" * (s["lr_alpha"] != usual.lr_alpha)
    name += " smooth" * (s["aux"] == "smooth") + " shaped" * (s["reward"] == "shaped")
    return name + f", {s['num_envs']} robots" * (s["num_envs"] != usual.num_envs)


def by_kind(runs, task):
    """The runs of one task by kind: {"EIPO": [a Run of each seed, ...], "PPO(0)": ...}.

    Raises ValueError if there are no runs, and if two of one kind differ in more than the seed, or
    not in it: such runs are no sample of anything.
    """
    kinds = {}
    for run in runs:
        if run.settings["task"] == task:
            kinds.setdefault(kind(run.settings), []).append(run)
    if not kinds:
        raise ValueError(f"none of the runs is of the task {task}")
    for name, (first, *others) in kinds.items():
        for other in others:
            names = first.settings.keys() & other.settings.keys()
            names = {x for x in names if first.settings[x] != other.settings[x]}
            if first.settings["algo"] == "ppo":  # which reads no step of alpha
                names = {x for x in names if not x.endswith("_alpha")}
            if names != {"seed"}:
                what = f"differ in {', '.join(sorted(names))}" if names else "have the same seed"
                raise ValueError(f"{first.name} and {other.name} are both {name} but {what}")
    place = {name: i for i, name in enumerate(KINDS)}
    return dict(sorted(kinds.items(), key=lambda x: (place.get(x[0].split(",")[0], 99), x[0])))


def color(name):
    """The color of a kind of run in every figure: EIPO is blue, PPO yellow to brown by lambda.

    There are five for PPO, which one can tell apart: of 0, up to 0.0005, 0.002, 0.005 and more.
    """
    if name.startswith("EIPO"):
        return "#0072B2"
    lam = float(name[len("PPO(") : name.index(")")])
    group = sum(x < lam for x in (0, 5e-4, 2e-3, 5e-3))
    return colormaps["YlOrBr"]((0.3, 0.45, 0.6, 0.78, 1.0)[group])
