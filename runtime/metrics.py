"""The numbers of a run: metrics.csv, the line on the console, and the pictures.

Columns of metrics.csv, means over the robots and steps of an iteration where nothing else is said:

steps                          [-] control steps of all robots so far
J, gap, alpha, task_share      of Algorithm 1: J(pi), J(pi) - J(pi'), alpha, and std(alpha A_r) over
                               std(alpha A_r) + std(A_f)
reward, cost                   r [-] and f [W], or [-] for Eq. (11)
task_reward                    [-] what Eqs. (5) to (8) would pay, where reward is the shaped one
v_x, command_x                 [m/s] speed ahead, and what was asked for
power                          [W] Eq. (9) without its bonus
command_area                   mean weight of the grid of commands, 1 if it has grown all over
ended_fall, ended_diverged,    [1/step] episodes that end by a fall, by numbers that are not
ended_limit, ended_power       finite, by the limit of time, and by that of power
value_loss, estimator_loss     of critic and estimator
kl, std                        how far pi moved in this iteration, and its exploration noise
lr, skipped                    Adam's step size, and updates skipped so far, as not finite
prime_...                      the same of pi'
time_s, steps_per_s            since this process began: seconds, and control steps a second
"""

import os
import sys
import time
from contextlib import suppress

import numpy as np

from runtime import run_folder
from runtime.cli import Refused, say, warn

EVERY = 30  # s from one line to the next where the output is no terminal


class Log:
    """metrics.csv, which grows by a row in each iteration, and the line on the console."""

    def __init__(self, folder, done, iterations):
        """done: iterations of the checkpoint."""
        self.path = folder / "metrics.csv"
        self.done, self.iterations = done, iterations
        self.start = time.monotonic()
        self.first, self.shown_at = None, -EVERY
        self.begun, self.unwritten = False, ""  # rows that wait for the file

    def begin(self, header):
        """Keep the rows up to the checkpoint. What was written after it will be computed again.

        A copy of a folder in which something trained may lack rows, or have half a row at its end.
        """
        text = self.path.read_bytes() if self.done and self.path.exists() else b""
        first, *lines = text[: text.rfind(b"\n") + 1].split() or [header]
        if first != header:
            raise Refused(f"{self.path} has other columns than this code: move it away")
        with run_folder.reading(self.path):
            rows = {int(line.split(b",")[0]): line for line in lines}
        rows = [rows[i] for i in range(1, self.done + 1) if i in rows]
        if len(rows) < self.done:
            warn(
                f"{self.path} lacks {self.done - len(rows)} rows of {self.done}: it goes on without"
            )
        data = b"".join(line + b"\n" for line in [header, *rows])
        run_folder.replace_file(self.path, lambda file: file.write(data))

    def add(self, iteration, metrics):
        """Take one row, show it, and write it if that can be done now. The clock starts anew with
        every process.
        """
        seconds = time.monotonic() - self.start
        rate = metrics["steps"] / iteration * (iteration - self.done) / seconds
        clock = dict(time_s=round(seconds, 2), steps_per_s=round(rate, 1))
        row = dict(iteration=iteration) | metrics | clock
        self.header = ",".join(row).encode()
        self.unwritten += ",".join(map(str, row.values())) + "\n"
        self.show(row)

    def write(self):
        """Write the rows that are not written yet."""
        if not self.unwritten:
            return
        if self.begun and not self.path.exists():
            warn(f"{self.path} is gone, with its rows: it begins anew")
            self.begun = False
        if not self.begun:
            self.begin(self.header)
            self.begun = True
        size = self.path.stat().st_size
        try:
            with open(self.path, "ab") as file:
                file.write(self.unwritten.encode())
                file.flush()
                os.fsync(file.fileno())  # they are on the disk before a checkpoint follows
        except OSError:
            with suppress(OSError):  # half a row shall not stay
                os.truncate(self.path, size)
            raise
        self.unwritten = ""

    def show(self, row):
        """Print a row: on a terminal each one, elsewhere the first, the last, one every 30 s."""
        self.first = self.first or row
        line = console_line(row, self.first, self.iterations)
        if sys.stdout and sys.stdout.isatty():
            say(f"\r{line}\x1b[K", end="")
        elif row["iteration"] == self.iterations or row["time_s"] >= self.shown_at + EVERY:
            say(line)
            self.shown_at = row["time_s"]


def console_line(row, first, iterations):
    """What matters of a row of metrics.csv, in one line.

    first: the first row of this process, which also compiled: the time left does not count it
    """
    timed = row["iteration"] - first["iteration"]
    task = row.get("task_reward", row["reward"])  # a shaped reward is not the task's
    left = race = ""
    if timed:
        seconds = (row["time_s"] - first["time_s"]) / timed * (iterations - row["iteration"])
        left = f"{seconds / 60:.0f} min left  "
    if "gap" in row:
        race = f"alpha {row['alpha']:.1f}  share {row['task_share']:.2f}  gap {row['gap']:+.2f}"
    return (
        f"{row['iteration']}/{iterations}  {row['steps_per_s']:.0f} steps/s  {left}"
        f"task {task:.2f}  v_x {row['v_x']:.2f} m/s  power {row['power']:.0f} W  {race}"
    )


def read(folder):
    """The columns of metrics.csv: {"iteration": (n,), "reward": (n,), ...}."""
    path = folder / "metrics.csv"
    with run_folder.reading(path), open(path) as file:
        names = file.readline().strip().split(",")
        columns = np.loadtxt(file, delimiter=",", ndmin=2).T
        return dict(zip(names, columns, strict=True))


# ---- pictures ----

PANELS = dict(
    reward="reward per step",
    v_x="speed ahead [m/s]",
    power="power [W]",
    ended_fall="falls per robot and step",
    gap="gap J(pi) - J(pi'): alpha rises below 0",
    alpha="alpha, the weight of the task",
    task_share="task's share of pi's objective",
    std="exploration noise",
)


def draw_curves(folder):
    """Draw curves.png: the most telling columns of metrics.csv over environment steps."""
    os.environ["MPLBACKEND"] = "Agg"  # a notebook's is not valid in a process of its own
    from matplotlib.figure import Figure  # here, because it is slow to import

    columns = read(folder)
    figure = Figure(figsize=(14, 6))
    # by hand, because matplotlib's layout engines take longer than all the rest
    figure.subplots_adjust(left=0.04, right=0.99, bottom=0.1, top=0.94, wspace=0.25, hspace=0.2)
    axes = figure.subplots(2, 4, sharex=True)
    for ax, (name, title) in zip(axes.flat, PANELS.items(), strict=True):
        for prefix, label in (("", "pi"), ("prime_", "pi'")):
            if prefix + name in columns:
                ax.plot(columns["steps"] / 1e6, columns[prefix + name], label=label, linewidth=0.8)
        ax.set_title(title)
        ax.grid(alpha=0.3)
    axes[0, 0].legend(loc="lower right")
    figure.supxlabel("million steps")
    png = dict(dpi=100, format="png")
    run_folder.replace_file(folder / "curves.png", lambda file: figure.savefig(file, **png))
