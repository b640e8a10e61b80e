"""The figures of tutorial.md: `draw(name, column=..., ...)` writes tutorial/NAME.csv and draws
NAME.png from it.

The columns come from the page, where they teach something, and otherwise from the functions of the
first part of this file. A PNG carries the checksum of the CSV that it was drawn from, so that a
test can compare the data and leave the pixels alone. The background is opaque white, so that the
figures can be read on white and on dark pages.
"""

import hashlib
from functools import lru_cache
from itertools import zip_longest
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from lab import record, sweep

HERE = Path(__file__).parent
RESULTS = HERE.parent / "results"  # our trained runs
# safe for colour-blind readers
BLUE, ORANGE, GREEN, RED, GREY = "#0072b2", "#e69f00", "#009e73", "#d55e00", "#777777"
COLOURS = (BLUE, ORANGE, GREEN, RED, "#cc79a7", "#56b4e9", GREY, "black")


def table(columns):
    """The CSV of some columns, lists of numbers of any length."""
    rows = zip_longest(*(np.ravel(x) for x in columns.values()))
    lines = [",".join("" if x is None else f"{x:.6g}" for x in row) for row in rows]
    return "\n".join([",".join(columns), *lines]) + "\n"


def checksum(text):
    """What the PNG says about the CSV that it shows."""
    return hashlib.sha256(text.encode()).hexdigest()


def draw(name, **columns):
    """Write the columns to tutorial/NAME.csv and draw them into tutorial/NAME.png."""
    if any("," in key for key in columns):
        raise ValueError(f"a column's name has a comma: {list(columns)}")
    text = table(columns)
    (HERE / f"{name}.csv").write_text(text)
    figure = FIGURES[name]({key: np.ravel(x) for key, x in columns.items()})
    metadata = dict(Software=None, Description=checksum(text))
    figure.savefig(HERE / f"{name}.png", dpi=100, facecolor="white", metadata=metadata)


# ---- columns ----


tables = lru_cache(record.groups)  # a page asks for many runs of one file


def kept(run):
    """The columns of metrics.csv of a run, TASK/NAME, of which results/ keeps every tenth row."""
    task, name = run.split("/")
    rows = tables(RESULTS / task / record.METRICS)[name]
    return {key: np.array([row[key] for row in rows], float) for key in record.without_run(rows[0])}


def training(runs, names, until=None):
    """Columns {"RUN:NAME": (n,)} of metrics.csv, up to an iteration; runs: {run: TASK/NAME}."""
    columns = {}
    for run, where in runs.items():
        c = kept(where)
        rows = c["iteration"] <= (until or np.inf)
        columns |= {f"{run}:{name}": c[name][rows] for name in ("steps", *names) if name in c}
    return columns


# ---- pictures ----


def panels(n, height=2.9, rows=1):
    """A figure with n panels in each of some rows."""
    figure = Figure(figsize=(8, height), layout="constrained")
    axes = figure.subplots(rows, n, squeeze=False).ravel()
    for a in axes:
        a.grid(alpha=0.3)
        a.spines[["top", "right"]].set_visible(False)
    return figure, axes


def trap(c):
    """Task and energy of the best policy of Eq. (2), over lambda."""
    figure, (left, right) = panels(2)
    for axes, key, label in (
        (left, "J", "task J of the answer"),
        (right, "F", "energy F of the answer"),
    ):
        axes.plot(c["lam"], c[key], color=BLUE, label="from theta = 0")
        axes.plot(
            c["lam"], c[key + "_from_3"], color=ORANGE, linestyle="--", label="from theta = 3"
        )
        axes.axvspan(0, 0.5, color=GREEN, alpha=0.12)
        axes.set(ylabel=label, xlabel="lambda")
    left.set_ylim(0, 1.1)
    left.text(0.25, 0.1, "keeps\nthe task", ha="center", color=GREEN)
    left.text(1.2, 0.1, "lazy", ha="center", color=RED)
    right.annotate(
        "wasteful: 9 at lambda = 0",
        (0.0, 9.0),
        (0.35, 8.3),
        arrowprops=dict(arrowstyle="->"),
        color=RED,
    )
    right.legend(loc="center right", frameon=False)
    return figure


def alpha(c):
    """Algorithm 1 on the toy: alpha and theta, with the kink and without, with momentum and
    without.
    """
    figure, (left, right) = panels(2)
    runs = dict(
        plain=("no momentum", BLUE),
        momentum=("momentum 0.99", ORANGE),
        smooth=("no kink", GREEN),
        stuck=("pi' is stuck at 0.9", RED),
    )
    for run, (label, colour) in runs.items():
        left.plot(c["iteration"], c["alpha_" + run], color=colour, label=label)
        right.plot(c["iteration"], c["theta_" + run], color=colour, label=label)
    left.axhline(2, color=GREY, linestyle=":")
    left.text(2000, 2.1, "alpha = 2", ha="right", color=GREY)
    left.set(ylabel="alpha", xlabel="iteration", yscale="log", ylim=(0.15, 40))
    right.set(ylabel="theta: 1 does the task", xlabel="iteration", ylim=(0, 1.05))
    right.legend(frameon=False, loc="lower right")
    return figure


def ahead(c):
    """A run in which pi overtakes pi': gap, alpha and power over iterations."""
    figure, (gap, multiplier, power) = panels(3, 2.6)
    x = c["iteration"]
    gap.plot(x, c["gap"], color=BLUE)
    gap.axhline(0, color="black", linewidth=0.8)
    gap.fill_between(x, c["gap"], 0, where=c["gap"] > 0, color=RED, alpha=0.25, linewidth=0)
    gap.set_title("red: pi is ahead", color=RED, fontsize=10)
    multiplier.plot(x, c["alpha"], color=BLUE)
    multiplier.ticklabel_format(useOffset=False)
    power.plot(x, c["power"], color=BLUE, label="pi")
    power.plot(x, c["prime_power"], color=ORANGE, linestyle=":", linewidth=2, label="pi'")
    power.legend(frameon=False)
    for a, label in (
        (gap, "gap J(pi) - J(pi')"),
        (multiplier, "alpha"),
        (power, "power [W], power clip"),
    ):
        a.set(xlabel="iteration", ylabel=label)
    return figure


def reward(c):
    """The four task rewards over the forward velocity, for a command of 0.5 m/s."""
    figure, (axes,) = panels(1, 2.7)
    names = dict(
        flat=("Eq. 5, flat", BLUE),
        rough=("Eq. 6, rough", ORANGE),
        curriculum=("Eq. 8, curriculum", GREEN),
        max_velocity=("Eq. 7, velocity", RED),
    )
    for key, (label, colour) in names.items():
        axes.plot(
            c["v_x"],
            c[key],
            color=colour,
            label=label,
            linestyle="--" if key == "curriculum" else "-",
        )
    axes.axvline(0.5, color=GREY, linestyle=":")
    axes.text(0.52, -0.45, "command", color=GREY)
    axes.set(xlabel="v_x [m/s]", ylabel="reward per step", ylim=(-0.55, 2.05))
    axes.legend(frameon=False, loc="upper left")
    return figure


def ground(c):
    """The ground of the rough task from above, all of its tiles; and its roughest and velocity's
    along a line.
    """
    heights = np.stack([c[key] for key in c if key.startswith("row")]) * 100
    figure = Figure(figsize=(8, 3.4), layout="constrained")
    top, below = figure.subplots(2, 1, height_ratios=(1, 2.2))
    style = dict(cmap="cividis", aspect="auto", interpolation="nearest")
    image = top.imshow(heights, origin="lower", extent=(0, 96, 0, 6), **style)
    figure.colorbar(image, label="height [cm]")
    top.set(xlabel="x [m], 6 m for each of the 16 tiles, from 0 to 15 cm", ylabel="y [m]")
    for key, colour, label in (
        ("rough", BLUE, "rough: 15 cm, 1 cell per metre"),
        ("velocity", ORANGE, "velocity: 5 cm, 4 cells per metre"),
    ):
        below.plot(c["x"], c[key] * 100, color=colour, label=label)
    below.set(xlabel="x [m], along the middle of the last tile", ylabel="height [cm]", ylim=(-7, 8))
    below.grid(alpha=0.3)
    below.spines[["top", "right"]].set_visible(False)
    below.legend(frameon=False, loc="upper center", ncols=2)
    return figure


def commands(c):
    """Weights of the cells of the command curriculum, as it grows."""
    figure = Figure(figsize=(8, 2.7), layout="constrained")
    for axes, (key, weights) in zip(figure.subplots(1, 3, sharey=True), c.items(), strict=True):
        shape = weights.reshape(22, 40)
        image = axes.imshow(
            shape, origin="lower", extent=(-10, 10, -1, 10), aspect="auto", vmin=0, vmax=1
        )
        axes.set(title=f"after {key[6:]}: {weights.mean():.1%} of cells", xlabel="yaw rate [rad/s]")
        axes.title.set_fontsize(10)
    figure.axes[0].set_ylabel("v_x [m/s]")
    figure.colorbar(image, ax=figure.axes, label="weight")
    return figure


def motor(c):
    """A step of the PD controller, and what the motors can give."""
    figure, (left, right) = panels(2, 2.6)
    left.plot(c["time"] * 1000, c["q"], color=BLUE, label="front right thigh")
    left.axhline(c["target"][0], color=GREY, linestyle=":", label="target, + 0.25 rad")
    left.axvspan(0, 20, color=GREEN, alpha=0.12, label="one control step")
    left.set(xlabel="time [ms]", ylabel="angle [rad]")
    left.legend(frameon=False, loc="lower right")
    right.plot(c["speed"], c["thigh"], color=BLUE, label="hip, thigh")
    right.plot(c["speed"], c["calf"], color=ORANGE, label="calf")
    right.set(xlabel="joint speed [rad/s]", ylabel="largest torque [N m]")
    right.legend(frameon=False)
    return figure


def kind_colour(run, otherwise):
    """The colour of a kind of run, EIPO or PPO(lambda), as in the figures of results/."""
    return sweep.color(run) if run.startswith(("EIPO", "PPO(")) else otherwise


def lines(axes, c, column):
    """A line for each run over environment steps, and a dotted one for pi'; keys of c are
    run:column.
    """
    runs = dict.fromkeys(key.split(":")[0] for key in c if ":" in key)
    for run, colour in zip(runs, map(kind_colour, runs, COLOURS), strict=True):
        for name, style, label in ((column, "-", run), (f"prime_{column}", ":", f"{run}, pi'")):
            if f"{run}:{name}" in c:
                axes.plot(
                    c[f"{run}:steps"] / 1e6, c[f"{run}:{name}"], style, color=colour, label=label
                )
    axes.set_xlabel("million environment steps")


def mirror(c):
    """Task reward with tied and with plain networks, of pi and of pi'."""
    figure, (axes,) = panels(1, 2.7)
    lines(axes, c, "reward")
    axes.axhline(c["standing"][0], color=GREY, linewidth=0.8)
    axes.text(
        2.5,
        c["standing"][0] - 0.015,
        "standing still",
        color=GREY,
        fontsize=9,
        ha="right",
        va="top",
    )
    axes.set(ylabel="task reward per step, Eq. (5)")
    axes.legend(frameon=False, ncols=2, loc="lower right")
    return figure


def runs(c):
    """Our runs on flat ground: task reward, power, alpha and gap over environment steps; keys are
    run:column.
    """
    figure, axes = panels(2, 4.8, rows=2)
    labels = dict(
        reward="task reward per step",
        power="power [W], power clip",
        alpha="alpha",
        gap="gap J(pi) - J(pi')",
    )
    for a, (name, label) in zip(axes, labels.items(), strict=True):
        lines(a, c, name)
        a.set_ylabel(label)
    axes[3].axhline(0, color=GREY)
    axes[0].legend(frameon=False, loc="lower right", fontsize=9)
    return figure


FIGURES = {
    f.__name__: f
    for f in (
        trap,
        alpha,
        ahead,
        reward,
        ground,
        commands,
        motor,
        mirror,
        runs,
    )
}
