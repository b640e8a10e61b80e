"""Collect finished runs into a folder beside this file: `python results/collect.py flat RUN...`.

For each run: config.json, every tenth row of metrics.csv, policy.npz (of PPO only on the curriculum), the map of
commands. Then curves.png, from what was collected: task reward, speed, power and alpha over environment steps, each a
running mean of 100 iterations. Folders of `alpha`, which compare readings of it (`alpha/flat`), have 1500 iterations
at most and no policies, and their curves also show the gap and the effective lambda, 1 / alpha.
"""

import re
import shutil
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

HERE = Path(__file__).parent
PANELS = dict(reward="task reward per step", v_x="body v_x [m/s]", power="power [W]", alpha="alpha")
ALPHA_PANELS = PANELS | dict(gap="gap J(pi) - J(pi')", lam="effective lambda, 1 / alpha")
# told apart by colour-blind readers
COLOURS = ("#0072b2", "#e69f00", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#000000", "#999999", "#882255", "#ddcc77",
           "#332288")  # fmt: skip


def collect(run, into):
    """Copy what is worth keeping of one run."""
    to = into / run.name
    to.mkdir(parents=True, exist_ok=True)
    config = (run / "config.json").read_text()
    (to / "config.json").write_text(re.sub(r"--out \S*/(?=\S)", "--out runs/", config))  # wherever the runs were kept
    header, *rows = (run / "metrics.csv").read_text().splitlines()
    reading = into.parent.name == "alpha"
    (to / "metrics.csv").write_text("\n".join([header, *rows[9 : 1500 if reading else None : 10]]) + "\n")
    mapped = (run / "commands.png").exists()
    for name in ("policy.npz",) * (("eipo" in run.name and not reading) or mapped) + ("commands.png",) * mapped:
        shutil.copy(run / name, to)


def columns(folder):
    """The columns of a metrics.csv as arrays."""
    rows = np.genfromtxt(folder / "metrics.csv", delimiter=",", names=True)
    c = {name: rows[name] for name in rows.dtype.names}
    c["reward"] = c.get("task_reward", c["reward"])  # the shaped reward is another sum
    with np.errstate(divide="ignore"):
        return c | dict(lam=1 / c["alpha"])


def smooth(x):
    """Running mean over 10 rows, i.e. 100 iterations."""
    return np.convolve(x, np.full(10, 0.1), mode="valid")


def draw(folders, into):
    """curves.png, one line per run; the dotted lines are pi' of EIPO."""
    panels = ALPHA_PANELS if into.parent.name == "alpha" else PANELS
    figure = Figure(figsize=(12, 3.25 * len(panels) / 2), layout="constrained")
    for axes, (name, title) in zip(figure.subplots(len(panels) // 2, 2).flat, panels.items(), strict=True):
        for folder, colour in zip(folders, COLOURS[: len(folders)], strict=True):
            c = columns(folder)
            steps = smooth(c["steps"]) / 1e6
            for column, style in ((name, "-"), ("prime_" + name, ":")):
                if column in c and np.isfinite(c[column]).any() and not (name in ("alpha", "lam") and "gap" not in c):
                    label = folder.name.removeprefix(f"{into.name}-").removesuffix("-seed0")
                    label += " (pi')" if style == ":" else ""
                    axes.plot(steps, smooth(c[column]), style, color=colour, label=label)
        axes.set(title=title, xlabel="million environment steps")
        axes.grid(alpha=0.3)
    for axes in (2, 3, 5) if panels is ALPHA_PANELS else (2,):
        figure.axes[axes].set_yscale("log")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside right upper", fontsize=8)
    figure.savefig(into / "curves.png", dpi=110)


if __name__ == "__main__":
    into, *runs = HERE / sys.argv[1], *map(Path, sys.argv[2:])
    for run in runs:
        collect(run, into)
    draw(sorted(path.parent for path in into.glob("*/metrics.csv")), into)
