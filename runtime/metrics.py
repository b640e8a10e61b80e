"""The numbers of a run: metrics.csv, the line on the console, and the pictures.

Columns of metrics.csv, means over the robots and steps of an iteration where nothing else is said:

iteration                      [-] of Algorithm 1
steps                          [-] control steps of all robots so far
J, gap, alpha, task_share      of Algorithm 1: J(pi), J(pi) - J(pi'), alpha, and std(alpha A_r) over
                               std(alpha A_r) + std(A_f), for PPO with 1 / lambda as alpha
reward, cost                   r [-], on velocity [m/s], and f [W], or [-] for Eq. (11)
task_reward                    [-] what Eqs. (5) to (8) would pay, where reward is the shaped one
v_x, command_x                 [m/s] speed ahead, and what was asked for
power                          [W] Eq. (9) without its bonus
episode_return                 [-] sum of rewards of the episodes that ended here, nan if none did
episode_length                 [control steps] of these episodes
command_area                   mean weight of the grid of commands, 1 if it has grown all over
ended_fall, ended_diverged,    [1/step] episodes that end by a fall, by numbers that are not
ended_limit, ended_power       finite, by the limit of time, and by that of power
explained_variance             share of the variance of returns that the critic foresaw, 1 at best
explained_variance_cost        the same of its head for the cost
policy_loss, value_loss,       of actor, critic and estimator
estimator_loss
clip_fraction                  share of samples whose ratio is beyond 1 +- clip_eps
kl, std                        how far pi moved in this iteration, and its exploration noise
lr, skipped                    Adam's step size, and updates skipped so far, as not finite
prime_...                      the same of pi'
time_s, steps_per_s            since training began here: seconds, and control steps a second
"""

import os
import shutil
import sys
import time

import numpy as np

from runtime import run_folder
from runtime.cli import Refused, say, warn

QUIET_FOR = 30  # s from one line to the next where the output is no terminal


class Log:
    """metrics.csv, and the line on the console."""

    def __init__(self, folder, done, iterations):
        """done: iterations of the checkpoint. Later rows are dropped: they are computed again."""
        self.path = folder / "metrics.csv"
        self.done, self.iterations = done, iterations
        self.start = time.monotonic()
        self.first, self.shown_at = None, -QUIET_FOR
        self.lines = rows_until(done, self.path)  # of the whole file, from its header on

    def add(self, iteration, metrics):
        """Take one row and show it. The clock starts anew with every process."""
        seconds = time.monotonic() - self.start
        rate = metrics["steps"] / iteration * (iteration - self.done) / seconds
        clock = dict(time_s=round(seconds, 2), steps_per_s=round(rate, 1))
        row = dict(iteration=iteration) | metrics | clock
        header = ",".join(row)
        self.lines = self.lines or [header]
        if self.lines[0] != header:
            raise Refused(f"{self.path} has other columns than this code: move it away")
        self.lines.append(",".join(map(str, row.values())))
        self.show(row)

    def write(self):
        """Write the whole file."""
        data = "\n".join([*self.lines, ""]).encode()
        run_folder.replace_file(self.path, lambda file: file.write(data))

    def show(self, row):
        """Print a row: on a terminal each, else the first, the run's last, and one every 30 s."""
        self.first = self.first or row
        line = console_line(row, self.first, self.iterations)
        if sys.stdout and sys.stdout.isatty():
            width = shutil.get_terminal_size().columns - 1  # a line that wraps is not renewed
            say(f"\r{line[:width]}\x1b[K", end="")
        elif row["iteration"] == self.iterations or row["time_s"] >= self.shown_at + QUIET_FOR:
            say(line)
            self.shown_at = row["time_s"]


def rows_until(done, path):
    """The header of a metrics.csv and its lines up to iteration `done`; [] if there are none."""
    if not done or not path.exists():
        return []
    with run_folder.reading(path):
        header, *lines = path.read_text().splitlines()
        kept = [line for line in lines if int(line.split(",")[0]) <= done]
        if not kept or int(kept[-1].split(",")[0]) < done:
            raise Refused(f"{path} ends before iteration {done} of the checkpoint: move it away")
        return [header, *kept]


def console_line(row, first, iterations):
    """The most important numbers of a row of metrics.csv, in one line.

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
    explained_variance="what the critic foresees, of 1",
    std="exploration noise",
)


def draw_curves(folder):
    """Draw curves.png: the most telling columns of metrics.csv over environment steps."""
    try:
        _draw_curves(folder)
    except Exception as error:  # a picture is not worth a run
        warn(f"no picture of {folder}: {error!r}")


def _draw_curves(folder):
    os.environ["MPLBACKEND"] = "Agg"  # a notebook's is not valid in a process of its own
    import matplotlib  # here, because it is slow
    from matplotlib.figure import Figure

    matplotlib.rcdefaults()  # the user's style may need LaTeX
    columns = read(folder)
    figure = Figure(figsize=(14, 6))
    # by hand, because matplotlib's layout engines take longer than all the rest
    figure.subplots_adjust(left=0.05, right=0.99, bottom=0.1, top=0.94, wspace=0.25, hspace=0.2)
    axes = figure.subplots(2, 4, sharex=True)
    for ax, (name, title) in zip(axes.flat, PANELS.items(), strict=True):
        for prefix, label in (("", "pi"), ("prime_", "pi'")):
            if prefix + name in columns:
                ax.plot(columns["steps"] / 1e6, columns[prefix + name], label=label, linewidth=0.8)
        if ax.lines:
            ax.set_title(title)
            ax.grid(alpha=0.3)
        else:  # PPO has no gap and no alpha
            ax.set_axis_off()
    axes[0, 0].legend(loc="lower right")
    figure.supxlabel("million steps")
    png = dict(dpi=100, format="png")
    run_folder.replace_file(folder / "curves.png", lambda file: figure.savefig(file, **png))
