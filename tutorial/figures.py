"""What tutorial.md needs besides the project itself: pictures, and the runs that we keep.

`draw` writes into a temporary folder, so that whoever follows the page changes no file of the
repository. The pictures that the page shows were written by `python tests/test_tutorial.py
--write`. Each carries the means of its curves as text, by which a test sees whether the code still
computes them. Their background is white, so that they can be read on a dark page, too.
"""

import tempfile
from pathlib import Path

import matplotlib
import mujoco
import numpy as np
from matplotlib.figure import Figure

import go1
from results import runs

matplotlib.rcdefaults()  # the user's style may need LaTeX
FOLDER = Path(tempfile.mkdtemp(prefix="eipo-tutorial-"))
# colours that colour-blind readers can tell apart
BLUE, ORANGE, GREEN, RED = "#0072b2", "#e69f00", "#009e73", "#d55e00"
STYLES = [(BLUE, "-"), (ORANGE, "--"), (GREEN, "-."), (RED, ":")]


# ---- pictures ----


def panels(columns, rows=1, height=2.7):
    """A figure and the axes of its panels, row after row; height: [inch] of a row."""
    figure = Figure(figsize=(8, height * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for a in axes:
        a.grid(alpha=0.3)
        a.spines[["top", "right"]].set_visible(False)
    return figure, axes


def plot(axes, xlabel, ylabel, x, curves):
    """Draw curves over x into a panel; curves: {label: y}, of which "" stays out of the legend."""
    for (label, y), (colour, style) in zip(curves.items(), STYLES, strict=False):
        axes.plot(x, y, color=colour, linestyle=style, linewidth=1.8, label=label or None)
    axes.set(xlabel=xlabel, ylabel=ylabel)
    if any(curves):
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1), ncols=4, frameon=False, fontsize=8)


def curves(*drawn):
    """A figure with a panel for each (xlabel, ylabel, x, {label: y}), as `plot` takes them."""
    figure, axes = panels(len(drawn))
    for a, panel in zip(axes, drawn, strict=True):
        plot(a, *panel)
    return figure


def draw(name, figure):
    """Write a figure to NAME.png in FOLDER."""
    metadata = dict(Software=None, Description=numbers(figure))
    figure.savefig(FOLDER / f"{name}.png", dpi=100, facecolor="white", metadata=metadata)


def numbers(figure):
    """The means of all curves and images of a figure, as text."""
    shown = [line.get_ydata() for axes in figure.axes for line in axes.lines]
    shown += [image.get_array() for axes in figure.axes for image in axes.images]
    return " ".join(f"{np.mean(x):.6g}" for x in shown)


def motor():
    """The angle of a thigh whose target moves by 0.25 rad, without gravity, and the torque limit of
    V-D.
    """
    model = go1.build_model(timestep=0.005, ground=None)
    model.opt.gravity[:] = 0
    data, q, target = mujoco.MjData(model), [], go1.Q_NOMINAL + 0.25 * (np.arange(12) == 1)
    data.qpos[2:4], data.qpos[7:] = 1.0, go1.Q_NOMINAL
    for _ in range(60):
        torque = go1.pd_torque(target, data.qpos[7:], data.qvel[6:])
        data.ctrl[:] = go1.limit_torque(torque, data.qvel[6:])
        mujoco.mj_step(model, data)
        q.append(data.qpos[8])
    angles = {"a thigh": q, "its target": 60 * [target[1]]}
    step = "time [ms]", "angle [rad]", 5 * np.arange(1, 61), angles
    speed = np.linspace(0, 40, 81)
    most = go1.limit_torque(np.full((81, 12), 99.0), np.tile(speed[:, None], 12), torque_speed=True)
    most = {"hip, thigh": most[:, 1], "calf": most[:, 2]}
    return curves(step, ("joint speed [rad/s]", "largest torque [N m]", speed, most))


def ground(rough, velocity):
    """Heights of the ground of `rough` from above, and both grounds along a line; (ny, nx) [m]."""
    figure, (above, along) = panels(1, 2, 1.7)
    above.grid(False)
    style = dict(cmap="cividis", aspect="auto", interpolation="nearest", origin="lower")
    image = above.imshow(100 * rough[::8, ::8], extent=(0, 96, 0, 6), **style)
    figure.colorbar(image, label="height [cm]")
    above.set(xlabel="x [m]: 16 tiles of 4 m and their margins, from 0 to 15 cm", ylabel="y [m]")
    last = {
        "rough: 15 cm, 1 cell per metre": 100 * rough[52, -120:],
        "velocity: 5 cm, 4 cells per metre": 100 * velocity[52, -120:],
    }
    x = 0.05 * np.arange(120)
    plot(along, "x [m] along the last tile and its margins", "height [cm]", x, last)
    along.set_ylim(-8, 14)
    return figure


def commands(grid, rng):
    """How the weights of a tasks.Grid grow for a robot that follows all commands with |v_x| + |yaw
    rate| below 5.
    """
    maps = {}
    for done in range(0, 5001, 100):
        if done in (0, 500, 5000):
            maps[f"after {done} commands"] = grid.weights.copy()
        asked = grid.draw(rng, np.arange(100))
        follows = np.abs(asked[:, [0, 2]]).sum(1) < 5
        grid.record(asked, np.outer(follows, [1.0, 1.0]))
    figure, axes = panels(len(maps))
    style = dict(extent=(-10, 10, -1, 10), aspect="auto", origin="lower", vmin=0, vmax=1)
    for a, (title, weights) in zip(axes, maps.items(), strict=True):
        a.grid(False)
        image = a.imshow(weights, **style)
        a.set_title(title, fontsize=10)
        a.set(xlabel="yaw rate [rad/s]", ylabel="v_x [m/s]" if a is axes[0] else "")
    figure.colorbar(image, ax=axes.tolist(), label="weight")
    return figure


# ---- runs that are kept in results/ ----


def kept(name):
    """The columns of metrics.csv that results/ keeps of a run, TASK/NAME."""
    return runs.read(runs.RESULTS / f"{name}.json").learned


def training(runs):
    """Reward, power, alpha and gap while runs train, and those of pi'.

    runs: {label: columns of metrics.csv}
    """
    figure, axes = panels(2, 2, 2.3)
    labels = dict(
        reward="task reward per step", power="power [W]", alpha="alpha", gap="gap J(pi) - J(pi')"
    )
    for a, (name, label) in zip(axes, labels.items(), strict=True):
        for (run, c), colour in zip(runs.items(), (BLUE, RED, ORANGE), strict=False):
            for key, style, who in ((name, "-", run), (f"prime_{name}", ":", f"{run}, pi'")):
                if key in c:
                    a.plot(c["steps"] / 1e6, c[key], style, color=colour, label=who)
        a.set(xlabel="million steps of the robots", ylabel=label)
    axes[0].legend(frameon=False, fontsize=9)
    axes[3].axhline(0, color="black", linewidth=0.8)
    return figure
