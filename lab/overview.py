"""All runs in one picture: `python -m lab tradeoff RUN...` and `python -m lab lambdas RUN...`.

A dot is a run. Its score is task performance, on `velocity` the peak of Table I, and its power that
of Eq. (9) without the bonus. Both are of the kept episodes with random starts.
"""

import numpy as np
from matplotlib.figure import Figure

from lab import claims, episodes, sweep
from runtime import flags, metrics, run_folder

TASKS = dict(flat="task performance", rough="task performance", velocity="peak velocity [m/s]")
FLOOR = dict(flat=1.4, rough=1.0, velocity=-1.0)  # a lower score is drawn there, as a triangle
PRINTED = {"EIPO": 2.86, "PPO(0)": 2.12, "PPO(0.02)": 1.37}  # m/s, Table I


def dots(folders):
    """A row for each run of TASKS whose episodes were kept: what it is, its score, its power."""
    rows = []
    for folder in folders:
        env_cfg, cfg = run_folder.load_config(folder)
        played = episodes.read_text(folder / run_folder.EPISODES)
        if not played or env_cfg.task not in TASKS or env_cfg.clip != "power":
            continue
        e = claims.random_starts(played, env_cfg.task)
        score = claims.peak(e) if env_cfg.task == "velocity" else claims.performance(e)
        row = dict(task=env_cfg.task, run=folder.name, kind=sweep.kind(env_cfg, cfg))
        row |= dict(algo=cfg.algo, lam=cfg.lam, seed=cfg.seed, score=score, power=claims.power(e))
        alpha = metrics.read(folder).get("alpha", [np.nan])[-1]
        rows.append(row | dict(alpha=alpha))
    if not rows:
        raise ValueError(f"none of the runs is of {', '.join(TASKS)} and has kept episodes")
    return rows


def scatter(axes, rows, x, y, floor=-np.inf):
    """A dot for each row: EIPO a blue diamond, PPO by lambda, and a triangle where y is lower."""
    for row in sorted(rows, key=lambda row: row["algo"], reverse=True):  # EIPO above
        marker = "D" if row["algo"] == "eipo" else "o"
        style = dict(marker="v" if row[y] < floor else marker, alpha=0.85, linewidths=0)
        axes.scatter(x(row), max(row[y], floor), 36, color=sweep.color(row["kind"]), **style)
    axes.grid(alpha=0.3)


def explain(figure, place):
    """The legend: EIPO, and PPO by groups of lambdas."""
    names = {sweep.color("EIPO"): "EIPO"}
    for lam in sweep.LAMBDAS:
        color = sweep.color(f"PPO({lam:g})")
        first = names.get(color, f"PPO({lam:g})").removesuffix(")").split(" to ")[0]
        names[color] = f"{first} to {lam:g})" if color in names else f"{first})"
    for color, name in names.items():
        marker = "D" if name == "EIPO" else "o"
        figure.axes[0].scatter([], [], color=color, marker=marker, label=name)
    figure.legend(loc=place, fontsize=8, ncols=1 if "right" in place else len(names))


def tradeoff(folders, args):
    """Score over power, a dot for each seed: up and left is better. What stands is a triangle.

    EIPO has its lambda_0 beside it, where that is not the task's own.
    """
    rows = dots(folders)
    figure = Figure(figsize=(12, 4.5), layout="constrained")
    for axes, (task, title) in zip(figure.subplots(1, len(TASKS)), TASKS.items(), strict=True):
        mine = [row for row in rows if row["task"] == task]
        scatter(axes, mine, lambda row: row["power"], "score", FLOOR[task])
        axes.margins(y=0.08)  # room for names
        axes.set(xscale="log", xlabel="power [W]", ylabel=title, title=task)
        axes.set_xticks(ticks := (100, 200, 400, 800), ticks)
        axes.minorticks_off()
        name_dots(axes, mine, flags.settle(dict(task=task), {})[1].lam)
    for name, speed in PRINTED.items():
        axes.axhline(speed, color="black", linestyle=":", linewidth=0.8)
        place = dict(transform=axes.get_yaxis_transform(), fontsize=7, va="bottom")
        axes.text(0.02, speed, f"{name}, the paper's", **place)
    explain(figure, "outside right center")
    return rows, figure


def name_dots(axes, rows, usual):
    """Write lambda_0 beside each dot of EIPO that has not the usual one.

    Of four places around a dot it takes the one that is farthest from all dots and names.
    """
    axes.figure.draw_without_rendering()  # now the axes have their size
    dots = axes.transData.transform([(row["power"], row["score"]) for row in rows])
    taken = [*dots]
    for row, dot in zip(rows, dots, strict=True):
        if row["algo"] == "eipo" and row["lam"] != usual:
            places = dot + np.array([(26, 0), (-26, 0), (0, 13), (0, -13)])  # pixels
            free = [np.sort(np.hypot(*((taken - place) / (2, 1)).T))[0] for place in places]
            place = places[np.argmax(free)]
            style = dict(ha="center", va="center", fontsize=6)
            axes.text(*axes.transData.inverted().transform(place), f"{row['lam']:g}", **style)
            taken += [place]


def lambdas(folders, args):
    """Score, power and the last 1 / alpha over lambda: of PPO, and over lambda_0 of EIPO."""
    rows = dots(folders)
    tasks = [task for task in TASKS if any(row["task"] == task for row in rows)]
    figure = Figure(figsize=(4 * len(tasks), 8), layout="constrained")
    panels = figure.subplots(3, len(tasks), squeeze=False, sharex=True)
    for column, task in zip(panels.T, tasks, strict=True):
        mine = [row | dict(end=1 / row["alpha"]) for row in rows if row["task"] == task]
        scatter(column[0], mine, shown, "score", FLOOR[task])
        scatter(column[1], mine, shown, "power")
        scatter(column[2], [row for row in mine if row["algo"] == "eipo"], shown, "end")
        column[0].set(title=task, ylabel=TASKS[task])
        column[1].set(yscale="log", ylabel="power [W]")
        column[1].set_yticks(ticks := (100, 200, 400, 800), ticks)
        column[1].minorticks_off()
        end = "EIPO's last 1 / alpha [1/W]"
        column[2].set(yscale="log", ylabel=end, xlabel="lambda, lambda_0 [1/W]")
        column[2].set_xscale("log")
        column[2].axline((1e-4, 1e-4), (1e-2, 1e-2), color="black", linestyle=":", linewidth=0.8)
    explain(figure, "outside upper center")
    return rows, figure


def shown(row):
    """Where a row's lambda stands on a logarithmic axis, on which 0 is at its left end."""
    return max(row["lam"], 5e-5)
