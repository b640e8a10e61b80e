"""The figures of tutorial.md: `draw(name, column=..., ...)` writes tutorial/NAME.csv and draws NAME.png from it.

The page computes every column; nothing is computed here. A PNG carries the checksum of the CSV that it was drawn
from, so that a test can compare the data and leave the pixels alone. The background is opaque white: the figures are
read on white and on dark pages.
"""

import hashlib
from itertools import zip_longest
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

HERE = Path(__file__).parent
BLUE, ORANGE, GREEN, RED, GREY = "#0072b2", "#e69f00", "#009e73", "#d55e00", "#777777"  # safe for colour-blind readers


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
    text = table(columns)
    (HERE / f"{name}.csv").write_text(text)
    figure = FIGURES[name]({key: np.ravel(x) for key, x in columns.items()})
    metadata = dict(Software=None, Description=checksum(text))
    figure.savefig(HERE / f"{name}.png", dpi=110, facecolor="white", metadata=metadata)


def panels(n, height=2.9):
    """A figure with n panels in a row."""
    figure = Figure(figsize=(8, height), layout="constrained")
    axes = np.atleast_1d(figure.subplots(1, n))
    for a in axes:
        a.grid(alpha=0.3)
        a.spines[["top", "right"]].set_visible(False)
    return figure, axes


def trap(c):
    """Task and energy of the best policy of Eq. (2), over lambda."""
    figure, (left, right) = panels(2)
    for axes, key, title in ((left, "J", "task J of the answer"), (right, "F", "energy F of the answer")):
        axes.plot(c["lam"], c[key], color=BLUE, label="from theta = 0")
        axes.plot(c["lam"], c[key + "_from_3"], color=ORANGE, linestyle="--", label="from theta = 3")
        axes.axvspan(0, 0.5, color=GREEN, alpha=0.12)
        axes.set(title=title, xlabel="lambda")
    left.set_ylim(0, 1.1)
    left.text(0.25, 0.1, "keeps\nthe task", ha="center", color=GREEN)
    left.text(1.2, 0.1, "lazy", ha="center", color=RED)
    right.annotate("wasteful: 9 at lambda = 0", (0.0, 9.0), (0.35, 8.3), arrowprops=dict(arrowstyle="->"), color=RED)
    right.legend(loc="center right", frameon=False)
    return figure


def alpha(c):
    """Algorithm 1 on the toy: alpha and theta, with the kink and without, with momentum and without."""
    figure, (left, right) = panels(2)
    runs = dict(plain=("no momentum", BLUE), momentum=("momentum 0.99", ORANGE), smooth=("no kink", GREEN))
    for run, (label, colour) in runs.items():
        left.plot(c["iteration"], c["alpha_" + run], color=colour, label=label)
        right.plot(c["iteration"], c["theta_" + run], color=colour, label=label)
    left.axhline(2, color=GREY, linestyle=":")
    left.text(2000, 2.15, "alpha = 2", ha="right", color=GREY)
    left.set(title="alpha", xlabel="iteration", yscale="log")
    right.set(title="theta: 1 does the task", xlabel="iteration", ylim=(0, 1.05))
    right.legend(frameon=False, loc="lower right")
    return figure


def reward(c):
    """The four task rewards over the forward velocity, for a command of 0.5 m/s."""
    figure, (axes,) = panels(1)
    names = dict(flat=("Eq. 5, flat", BLUE), rough=("Eq. 6, rough", ORANGE), curriculum=("Eq. 8, curriculum", GREEN),
                 max_velocity=("Eq. 7, velocity", RED))  # fmt: skip
    for key, (label, colour) in names.items():
        axes.plot(c["v_x"], c[key], color=colour, label=label)
    axes.axvline(0.5, color=GREY, linestyle=":")
    axes.text(0.52, 0.02, "command", color=GREY)
    axes.set(xlabel="v_x [m/s]", ylabel="reward per step", ylim=(-0.55, 2.05))
    axes.legend(frameon=False, loc="lower right")
    return figure


def ground(c):
    """A tile of Perlin noise from above and along one line, as the rough task and as the velocity task have it."""
    heights = np.stack([c[key] for key in c if key.startswith("row")]) * 100
    figure = Figure(figsize=(8, 3.1), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.4))
    image = left.imshow(heights, origin="lower", extent=(0, 4, 0, 4), cmap="cividis")
    figure.colorbar(image, label="height [cm]")
    left.axhline(2.6, color="white", linestyle=":")
    left.set(title="a tile of the rough task", xlabel="x [m]", ylabel="y [m]")
    for key, colour, label in (("rough", BLUE, "15 cm, 1 cell/m"), ("less", ORANGE, "5 cm, 4 cells/m")):
        right.plot(c["x"], c[key] * 100, color=colour, label=label)
    right.set(title="along the dotted line", xlabel="x [m]", ylabel="height [cm]", ylim=(-8, 10))
    right.grid(alpha=0.3)
    right.spines[["top", "right"]].set_visible(False)
    right.legend(frameon=False, loc="upper center", ncols=2)
    return figure


def robot(c):
    """A step of the PD controller, and what the motors can give."""
    figure, (left, right) = panels(2)
    left.plot(c["time"] * 1000, c["q"], color=BLUE)
    left.axhline(c["target"][0], color=GREY, linestyle=":", label="target")
    left.set(title="front right thigh, target + 0.25 rad", xlabel="time [ms]", ylabel="angle [rad]")
    left.legend(frameon=False, loc="lower right")
    right.plot(c["speed"], c["thigh"], color=BLUE, label="hip, thigh")
    right.plot(c["speed"], c["calf"], color=ORANGE, label="calf")
    right.set(title="largest torque", xlabel="joint speed [rad/s]", ylabel="[N m]")
    right.legend(frameon=False)
    return figure


def go1(c):
    """Our runs: task reward, power, alpha and gap over environment steps; keys are run:column."""
    figure = Figure(figsize=(8, 5.4), layout="constrained")
    axes = dict(zip(("reward", "power", "alpha", "gap"), figure.subplots(2, 2).flat, strict=True))
    runs = list(dict.fromkeys(key.split(":")[0] for key in c))
    for run, colour in zip(runs, (BLUE, ORANGE, GREEN, RED, "#cc79a7", "#56b4e9", GREY, "black"), strict=False):
        for name, a in axes.items():
            for column, style in ((name, "-"), ("prime_" + name, ":")):
                if f"{run}:{column}" in c:
                    label = run if style == "-" else None
                    a.plot(c[f"{run}:steps"] / 1e6, c[f"{run}:{column}"], style, color=colour, label=label)
    titles = dict(reward="task reward per step (dotted: pi')", power="power [W], by each run's own clip",
                  alpha="alpha", gap="gap J(pi) - J(pi')")  # fmt: skip
    for name, a in axes.items():
        a.grid(alpha=0.3)
        a.spines[["top", "right"]].set_visible(False)
        a.set(title=titles[name], xlabel="million environment steps")
    axes["power"].set_yscale("log")
    axes["gap"].axhline(0, color=GREY)
    axes["reward"].legend(frameon=False, loc="lower right", fontsize=8)
    return figure


FIGURES = {f.__name__: f for f in (trap, alpha, reward, ground, robot, go1)}
