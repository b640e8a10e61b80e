"""Runs seed by seed: `python -m lab seeds RUN...`."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import evaluate
from lab import episodes
from runtime import metrics, run_folder

# `seeds` says when the mean task reward of a run's robots reached these
LEVELS = dict(flat=(1.2, 1.35))


def overview(folder, args):
    """One run as a row of means over episodes with random starts or, in columns that say so, with
    nominal ones.

    Commands are those of Figs. 2 to 4, also on the task `curriculum`. On a task like `velocity`
    there are none.
    """
    env_cfg, cfg = run_folder.load_config(folder)
    commands = evaluate.commands_of(env_cfg.task)
    each = max(1, args.episodes // len(commands))
    played, nominal = episodes.both_starts(folder, env_cfg.task, commands, each, args)
    return dict(run=folder.name, seed=cfg.seed) | evaluate.summary(played, nominal, commands)


def reached(columns, level):
    """Million environment steps, and minutes, after which the mean reward of 20 iterations is at a
    level, or NaN.
    """
    if (np.diff(columns["iteration"]) > 1).any():
        return np.nan, np.nan  # only every tenth row was kept
    means = np.convolve(columns["reward"], np.ones(20) / 20, "valid")
    if not (means >= level).any():
        return np.nan, np.nan
    at = np.argmax(means >= level) + 19
    seconds = np.diff(columns["time_s"], prepend=0.0)
    # the clock starts anew where a run was resumed
    seconds = np.where(seconds < 0, columns["time_s"], seconds)
    return columns["steps"][at] / 1e6, seconds[: at + 1].sum() / 60


def seeds(folders, args):
    """How soon each run of one task learned, and what it does now: its `overview` and its learning
    curve.
    """
    rows = []
    figure = Figure(figsize=(6, 3.6), layout="constrained")
    axes = figure.subplots()
    for folder in map(Path, folders):
        columns = metrics.read(folder)
        task = run_folder.load_config(folder)[0].task
        if not columns.keys() >= {"iteration", "steps", "reward", "time_s"}:
            raise ValueError(f"{folder / 'metrics.csv'} has no rows, or not the columns of a run")
        times = {
            f"{unit}_{level}": x
            for level in LEVELS.get(task, ())
            for unit, x in zip(("msteps", "minutes"), reached(columns, level), strict=True)
        }
        rows.append(overview(folder, args) | times)
        axes.plot(columns["steps"] / 1e6, columns["reward"], label=folder.name, linewidth=0.8)
    axes.set(xlabel="million steps", ylabel="task reward per step of pi")
    axes.legend(fontsize=7)
    axes.grid(alpha=0.3)
    return rows, figure
