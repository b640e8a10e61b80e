"""The numbers of a run: metrics.csv, the line on the console, and the pictures."""

import csv
import os
import sys
import time

import numpy as np

import tasks
from runtime import run_folder
from runtime.interrupt import say

FAULTS = ("skipped", "prime_skipped", "ended_diverged")  # shown only if they are not 0
EVERY = 30  # s from one line to the next where the output is no terminal


class Log:
    """metrics.csv, which grows by a row in each iteration, and the line on the console."""

    def __init__(self, folder, done, iterations):
        """done: iterations of the checkpoint. Later rows are dropped and will be computed again."""
        self.path = folder / "metrics.csv"
        self.done, self.iterations = done, iterations
        self.start = time.monotonic()
        self.first, self.shown = None, -EVERY
        with run_folder.reading(self.path):
            lines = self.path.read_text().splitlines(True) if done and self.path.exists() else []
        # another version may have had other columns
        self.names = next(csv.reader(lines), None)
        kept = "".join(lines[: done + 1])
        run_folder.replace_file(self.path, lambda file: file.write(kept.encode()))

    def add(self, iteration, metrics):
        """Write one row and show it. Its time counts from the last start or resumption."""
        seconds = time.monotonic() - self.start
        rate = metrics["steps"] / iteration * (iteration - self.done) / seconds
        clock = dict(time_s=round(seconds, 2), steps_per_s=round(rate, 1))
        row = dict(iteration=iteration) | metrics | clock
        with open(self.path, "a", newline="") as file:
            self.names = self.names or list(row)
            names = dict(fieldnames=self.names, restval="nan", extrasaction="ignore")
            writer = csv.DictWriter(file, **names, lineterminator="\n")
            if file.tell() == 0:
                writer.writeheader()
            writer.writerow(row)
            file.flush()
            os.fsync(file.fileno())  # it is on the disk before a checkpoint may follow
        self.show(row)

    def show(self, row):
        """Print a row: on a terminal each one, elsewhere the first, the last, one every 30 s."""
        self.first = self.first or row
        line = summary(row, self.first, self.iterations)
        if sys.stdout.isatty():
            say(f"\r{line}\x1b[K", end="")
        elif row["iteration"] == self.iterations or row["time_s"] >= self.shown + EVERY:
            say(line)
            self.shown = row["time_s"]


def summary(row, first, iterations):
    """What matters of a row of metrics.csv, in one line.

    The time left takes the mean of all iterations since `first`, the first row of this process,
    which also compiled.
    """
    timed = row["iteration"] - first["iteration"]
    left = iterations - row["iteration"]
    seconds = left * (row["time_s"] - first["time_s"]) / max(1, timed)
    task = row.get("task_reward", row["reward"])  # a shaped reward is not the task's
    return (
        f"{row['iteration']}/{iterations}  {row['steps_per_s']:.0f} steps/s  "
        + (f"{seconds / 60:.0f} min left  " if timed else "")
        + f"task {task:.2f}  v_x {row['v_x']:.2f} m/s  power {row['power']:.0f} W  "
        + f"alpha {row['alpha']:.1f}"
        + (f"  share {row['task_share']:.2f}  gap {row['gap']:+.2f}" if "gap" in row else "")
        + "".join(f"  {name} {row[name]:.2g}" for name in FAULTS if row.get(name))
    )


def read(folder):
    """The columns of metrics.csv: {"iteration": (n,), "reward": (n,), ...}; {} without a row."""
    path = folder / "metrics.csv"
    with run_folder.reading(path), open(path, newline="") as file:
        # a row that is being written, or that a full disk cut off, lacks its last columns
        rows = [row for row in csv.DictReader(file) if None not in row.values()]
        return {name: np.array([row[name] for row in rows], float) for name in rows[:1] and rows[0]}


# ---- pictures ----

PANELS = dict(
    reward="task reward per step",
    v_x="speed ahead [m/s]",
    power="power [W]",
    falls="falls of a robot per minute",
    gap="gap J(pi) - J(pi'): alpha rises below 0",
    alpha="alpha, the weight of the task",
    task_share="task's share of pi's objective",
    std="exploration noise",
)


def draw(folder, weights):
    """Draw the pictures of a run, or say that it failed; weights: of its curriculum, or None."""
    try:
        draw_curves(folder)
        if weights is not None:
            draw_commands(folder, weights)
    except Exception as error:  # whatever it is, a picture is not worth a run
        print(f"train.py: no picture was drawn: {error!r}", file=sys.stderr)


def draw_curves(folder):
    """Draw curves.png: the most telling columns of metrics.csv over environment steps."""
    from matplotlib.figure import Figure  # here, because it is slow to import

    env_cfg, _ = run_folder.load_config(folder)
    minutes = env_cfg.physics_steps * env_cfg.timestep / 60  # that a control step takes
    columns = read(folder)
    figure = Figure(figsize=(14, 6))
    # by hand, because matplotlib's layout engines take longer than all the rest
    figure.subplots_adjust(left=0.04, right=0.99, bottom=0.1, top=0.94, wspace=0.2, hspace=0.2)
    axes = figure.subplots(2, 4, sharex=True)
    for ax, (name, title) in zip(axes.flat, PANELS.items(), strict=True):
        for prefix, label, color in (("", "pi", "#0072B2"), ("prime_", "pi'", "#E69F00")):
            curve = columns.get(prefix + name)
            if name == "reward":  # a shaped reward is not the task's
                curve = columns.get(prefix + "task_reward", curve)
            if name == "falls" and prefix + "ended_fall" in columns:
                curve = columns[prefix + "ended_fall"] / minutes
            if curve is not None:
                ax.plot(columns["steps"] / 1e6, curve, label=label, color=color, linewidth=0.8)
        ax.set_title(title)
        ax.grid(alpha=0.3)
    axes[0, 0].legend(loc="lower right")
    axes[1, 0].axhline(0, color="black", linewidth=0.8)
    figure.supxlabel("million steps")
    save_figure(folder / "curves.png", figure)


def draw_commands(folder, weights):
    """Draw commands.png: the weights (22, 40) of a tasks.Grid."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    low, high = tasks.Grid.low, tasks.Grid.high
    extent = low[2], high[2], low[0], high[0]  # of yaw rate, then of v_x
    image = axes.imshow(weights, origin="lower", extent=extent, aspect="auto", vmin=0, vmax=1)
    title = f"{weights.mean():.1%} of all commands"
    axes.set(title=title, xlabel="yaw rate [rad/s]", ylabel="v_x [m/s]")
    figure.colorbar(image, label="weight")
    save_figure(folder / "commands.png", figure)


def save_figure(path, figure):
    """Replace a PNG."""
    run_folder.replace_file(path, lambda file: figure.savefig(file, dpi=100, format="png"))
