"""The numbers of a run: metrics.csv, the line on the console, and the pictures."""

import os
import sys
import time

import numpy as np

import tasks
from runtime import run_folder
from runtime.interrupt import say

FAULTS = ("skipped", "prime_skipped", "ended_diverged")  # shown only if they are not 0


class Log:
    """metrics.csv, which grows by a row in each iteration."""

    def __init__(self, folder, done):
        """done: iterations behind us. Later rows are dropped, as they will be computed again.

        The run does not need the earlier ones: if some are missing, it goes on, and a line on
        stderr says so.
        """
        self.path = folder / "metrics.csv"
        self.done = done
        self.start = time.monotonic()
        self.names = None
        rows = whole_rows(self.path) if done and self.path.exists() else []
        kept = {row["iteration"]: row for row in rows if int(row["iteration"]) <= done}
        self.kept = list(kept.values())
        if (missing := done - len(self.kept)) > 0:
            print(
                f"{self.path} lacks {missing} of {done} rows: the run goes on without them",
                file=sys.stderr,
            )

    def row(self, iteration, metrics):
        """Write one row, and return it as a dict. Time counts from the last start or resumption."""
        seconds = time.monotonic() - self.start
        new = iteration - self.done
        rate = metrics["steps"] / iteration * new / seconds
        clock = dict(time_s=round(seconds, 2), steps_per_s=round(rate, 1))
        row = dict(iteration=iteration) | metrics | clock
        if not self.names or not self.path.exists():
            # another version may have other columns
            self.names = list((self.kept[0] if self.kept else {}) | row)
            lines = map(self.line, [dict(zip(self.names, self.names, strict=True)), *self.kept])
            run_folder.replace_file(self.path, lambda file: file.write("".join(lines).encode()))
        with open(self.path, "a", newline="") as file:
            file.write(self.line(row))
        return row

    def line(self, row):
        """A row as text."""
        return ",".join(str(row.get(name, "nan")) for name in self.names) + "\n"

    def sync(self):
        """Wait until all rows are on the disk. Then a checkpoint may follow them there."""
        with open(self.path, "a") as file:
            os.fsync(file.fileno())


def whole_rows(path):
    """The rows of metrics.csv as dicts of text, without what a crash or a full disk has torn."""
    lines = path.read_text(errors="replace").split("\n")[:-1] or [""]
    names, *rows = (line.split(",") for line in lines)
    rows = [dict(zip(names, row, strict=True)) for row in rows if len(row) == len(names)]
    return [row for row in rows if row.get("iteration", "").isdecimal()]


def read(folder):
    """The columns of metrics.csv: {"iteration": (n,), "reward": (n,), ...}; {} without a row."""
    rows = whole_rows(folder / "metrics.csv")
    names = rows[0] if rows else ()
    try:
        return {name: np.array([row[name] for row in rows], float) for name in names}
    except ValueError as error:
        raise ValueError(f"{folder / 'metrics.csv'} is damaged: {error}") from None


def report(row, first, iterations):
    """Print what matters of a row of metrics.csv: on a terminal each, elsewhere one in 100.

    The time left takes the mean of all iterations since `first`, the first row of this process,
    which also compiled.
    """
    iteration = row["iteration"]
    timed = row["iteration"] - first["iteration"]
    seconds = (iterations - iteration) * (row["time_s"] - first["time_s"]) / max(1, timed)
    left = f"{seconds / 60:.0f} min left  " if timed else ""
    task = row.get("task_reward", row["reward"])  # a shaped reward is not the task's
    line = (
        f"{iteration}/{iterations}  {row['steps_per_s']:.0f} steps/s  {left}task {task:.2f}  "
        f"v_x {row['v_x']:.2f} m/s  power {row['power']:.0f} W  alpha {row['alpha']:.1f}"
        + (f"  share {row['task_share']:.2f}  gap {row['gap']:+.2f}" if "gap" in row else "")
        + "".join(f"  {name} {row[name]:.2g}" for name in FAULTS if row.get(name))
    )
    if sys.stdout.isatty():
        say(f"\r{line}\x1b[K", end="")
    elif iteration % 100 == 0 or iteration == iterations:
        say(line)


def draw(folder, weights):
    """Draw the pictures of a run, or say that it failed; weights: of its curriculum, or None."""
    try:
        draw_curves(folder)
        if weights is not None:
            draw_commands(folder, weights)
    except Exception as error:  # whatever it is, a picture is not worth a run
        say(f"train.py: no picture was drawn: {' '.join(str(error).split())}", sys.stderr)


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


def draw_curves(folder):
    """Draw curves.png: the most telling columns of metrics.csv over environment steps."""
    from matplotlib.figure import Figure  # here, because it is slow to import

    env_cfg, _ = run_folder.load_config(folder)
    period = env_cfg.physics_steps * env_cfg.timestep  # s, of a control step
    columns = read(folder)
    for policy in ("", "prime_"):
        if policy + "task_reward" in columns:  # a shaped reward is not the task's
            columns[policy + "reward"] = columns[policy + "task_reward"]
        if policy + "ended_fall" in columns:
            columns[policy + "falls"] = columns[policy + "ended_fall"] * 60 / period
    figure = Figure(figsize=(14, 6))
    # by hand, because matplotlib's layout engines take longer than all the rest
    figure.subplots_adjust(left=0.04, right=0.99, bottom=0.08, top=0.94, wspace=0.2, hspace=0.2)
    axes = dict(zip(PANELS, figure.subplots(2, 4, sharex=True).flat, strict=True))
    for name, title in PANELS.items():
        for column, label, color in ((name, "pi", "#0072B2"), (f"prime_{name}", "pi'", "#E69F00")):
            if column in columns and np.isfinite(columns[column]).any():
                style = dict(label=label, color=color, linewidth=0.8)
                axes[name].plot(columns["steps"] / 1e6, columns[column], **style)
        axes[name].set_title(title)
        axes[name].grid(alpha=0.3)
    for name in ("gap", "alpha", "task_share", "std"):  # the lower row
        axes[name].set_xlabel("million steps")
    axes["gap"].axhline(0, color="black", linewidth=0.8)
    draw_levels(axes["reward"], env_cfg.task)
    axes["reward"].legend(loc="lower right")
    run_folder.replace_file(
        folder / "curves.png", lambda file: figure.savefig(file, dpi=100, format="png")
    )


def draw_levels(axes, task):
    """Draw the `levels` of a task's reward as dotted lines with names."""
    for name, level in levels(task).items():
        axes.axhline(level, color="black", linestyle=":", linewidth=0.8)
        place = dict(transform=axes.get_yaxis_transform(), ha="right", va="bottom", fontsize=8)
        axes.text(0.99, level, name, **place)
    axes.margins(y=0.08)  # room for the name of the highest one


def levels(task):
    """What a robot earns per step that stands, and one that does as it is told: {name: reward}.

    Means over the task's commands. On `curriculum` nobody knows them beforehand, and on `velocity`
    there are none.
    """
    rules = tasks.TASKS[task]
    commands = rules.commands()
    if isinstance(commands, tasks.Grid):
        return {"as told": rules.reward(np.zeros(3), np.zeros(3))}
    asked = np.linspace(0, 1, 1001)[:, None] * commands.high
    if not commands.high.any():
        return {}
    found = {"as told": rules.reward(asked, asked).mean()}
    return found | dict(standing=rules.reward(0 * asked, asked).mean())


def draw_commands(folder, weights):
    """Draw commands.png: the weights of the curriculum over the commands (see curriculum.py)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    low, high = tasks.Grid.low, tasks.Grid.high
    extent = low[2], high[2], low[0], high[0]  # of yaw rate, then of v_x
    image = axes.imshow(weights, origin="lower", extent=extent, aspect="auto", vmin=0, vmax=1)
    axes.set(
        title=f"{weights.mean():.1%} of all commands", xlabel="yaw rate [rad/s]", ylabel="v_x [m/s]"
    )
    figure.colorbar(image, label="weight")
    run_folder.replace_file(
        folder / "commands.png", lambda file: figure.savefig(file, dpi=100, format="png")
    )
