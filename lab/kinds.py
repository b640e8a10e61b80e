"""Kinds of runs: EIPO or PPO(lambda), and whatever else of a run is not usual for its task."""

import re

from matplotlib import colormaps

import eipo
import tasks
from runtime.command import Refused

LAMBDAS = (0, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2)  # Eq. (10)
KINDS = ("EIPO", *(f"PPO({lam:g})" for lam in LAMBDAS))


def kind(settings):
    """What the figures call a run with these settings, {name: setting}."""
    s = settings
    usual = eipo.Config(**tasks.TASKS[s["task"]].learner)
    name = f"PPO({s['lam']:g})"
    if s["algo"] == "eipo":
        name = "EIPO" + f" from {s['lam']:g}" * (s["lam"] != usual.lam)
        name += f" at eta_alpha {s['lr_alpha']:g}" * (s["lr_alpha"] != usual.lr_alpha)
    name += " smooth" * (s["aux"] == "smooth") + " shaped" * (s["reward"] == "shaped")
    return name + f", {s['num_envs']} robots" * (s["num_envs"] != usual.num_envs)


def by_kind(runs, task):
    """The runs of one task by kind: {"EIPO": [a Run of each seed, ...], "PPO(0)": ...}.

    Refused if there are no runs, or if two of one kind differ in more than the seed, or
    not in it: such runs are no sample of anything.
    """
    kinds = {}
    for run in runs:
        if run.settings["task"] == task:
            kinds.setdefault(kind(run.settings), []).append(run)
    if not kinds:
        raise Refused(f"none of the runs is of the task {task}")
    for name, (first, *others) in kinds.items():
        for other in others:
            a, b = first.settings, other.settings
            names = {x for x in a.keys() & b.keys() if a[x] != b[x]}
            if a["algo"] == "ppo":  # which reads no step of alpha
                names = {x for x in names if not x.endswith("_alpha")}
            if names != {"seed"}:
                what = ", ".join(sorted(names)) or "nothing, not even in the seed"
                raise Refused(f"{first.name} and {other.name} are {name} but differ in {what}")
    place = dict(zip(KINDS, range(10), strict=True))
    return dict(sorted(kinds.items(), key=lambda x: (place.get(x[0].split(",")[0], 10), x[0])))


def style(name):
    """Color and marker of a kind of run in every figure.

    EIPO is blue, PPO yellow to brown by lambda, in five shades that one can tell apart: of 0, up to
    0.0005, 0.002, 0.005 and more. Each lambda and lambda_0 has its marker.
    """
    lam = re.search(r"(?:PPO\(|from )([^ ,)]+)", name)
    lam = float(lam[1]) if lam else -1  # EIPO from its usual lambda_0
    shade = sum(x < lam for x in (0, 5e-4, 2e-3, 5e-3))
    color = colormaps["YlOrBr"]((0.3, 0.45, 0.6, 0.78, 1.0)[shade])
    color = "#0072B2" if name.startswith("EIPO") else color
    return dict(color=color, marker="Dos^v<>pPX"[sum(x <= lam for x in LAMBDAS)])
