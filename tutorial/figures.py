"""The figures of tutorial.md: `draw(name, column=..., ...)` writes tutorial/NAME.csv and draws
NAME.png from it.

The columns come from the page, where they teach something, and otherwise from the functions of the
first part of this file. A PNG carries the checksum of the CSV that it was drawn from, so that a
test can compare the data and leave the pixels alone. The background is opaque white, so that the
figures can be read on white and on dark pages.
"""

import hashlib
from functools import lru_cache
from itertools import pairwise, zip_longest
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

import go1
from lab import record, sweep

HERE = Path(__file__).parent
RESULTS = HERE.parent / "results"  # our trained runs
# safe for colour-blind readers
BLUE, ORANGE, GREEN, RED, GREY = "#0072b2", "#e69f00", "#009e73", "#d55e00", "#777777"
LEGS = (BLUE, "#56b4e9", "black", ORANGE)  # of FR, FL, RR, RL
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


def escapes():
    """How runs on flat ground stopped standing: {run: None, or what `growth` found}."""
    lams = ("0.02", "0.01", "0.005", "0.002", "0.001", "0.0005", "0.0002", "0.0001")
    runs = [f"flat-ppo-lam{lam}-seed0" for lam in lams]
    kinds = ("flat-ppo", "printed-eipo", "flat-eipo")
    runs += [f"{kind}-lam0.005-seed{i}" for kind in kinds for i in range(3)]
    return {run: growth(kept(f"flat/{run}")) for run in runs}


def growth(c):
    """From when a run was last below 0.05 m/s to when it passed 0.3 m/s: iterations (n,), speeds
    (n,), mean alpha, and by how much ln v_x grew in 100 iterations. None if it never passed.

    c: columns of metrics.csv
    """
    if not (c["v_x"] > 0.3).any():
        return None
    end = np.argmax(c["v_x"] > 0.3) + 1
    rows = slice(np.flatnonzero(c["v_x"][:end] < 0.05)[-1] + 1, end)
    x, v = c["iteration"][rows], c["v_x"][rows]
    return x, v, c["alpha"][rows].mean(), 100 * np.polyfit(x, np.log(v), 1)[0]


def speeds_and_rates(left):
    """Columns of `escape` from what `escapes` found."""
    shown = {
        "EIPO": "flat-eipo-lam0.005-seed0",
        "EIPO (paper's step)": "printed-eipo-lam0.005-seed0",
        "PPO(0.005)": "flat-ppo-lam0.005-seed0",
        "PPO(0.001)": "flat-ppo-lam0.001-seed0",
    }
    columns = {}
    for name, run in shown.items():
        columns |= {f"{name}:iteration": left[run][0], f"{name}:v_x": left[run][1]}
    walked = [seen for seen in left.values() if seen]
    stood = [1 / float(run.split("-")[2][3:]) for run, seen in left.items() if not seen]
    rates = dict(alpha=[seen[2] for seen in walked], rate=[seen[3] for seen in walked])
    return columns | rates | dict(stands=stood)


def posture(pitch=15.0):
    """Columns of the robot with its nose up by a pitch [degrees], of its frames, and of a leg and
    its target.
    """
    turn = Rotation.from_euler("y", -pitch, degrees=True)
    origin, level = np.array([0, 0, 0.33]), Rotation.identity()
    ways = (turn, level, level)
    poses = [
        np.concatenate([origin, way.as_quat(scalar_first=True), go1.Q_NOMINAL]) for way in ways
    ]
    poses[2][8] += 0.25  # the target of the front right thigh
    columns = dict(origin=origin) | skeleton(poses[0])
    for name, pose in zip(("leg", "target"), poses[1:], strict=True):
        columns |= {
            f"{name}_{axis}": (x := skeleton(pose)[f"FR_{axis}"][1:]) - x[0] for axis in "xz"
        }
    frames = dict(body=turn.as_matrix().T, heading=np.eye(3))
    return columns | {
        f"{name}_{axis}": 0.2 * v
        for name, f in frames.items()
        for axis, v in zip("xyz", f, strict=True)
    }


def moments(poses, feet):
    """Columns of four moments of a stride of a third of a second, from where the front right foot
    lands.

    poses: (T, 19) of MuJoCo and feet: {leg: (T,)} on the ground, both 200 times a second
    """
    lands = np.argmax(np.diff(feet["FR"]) > 0) + 1
    after = np.array([0, 17, 34, 51])
    points = {
        f"at{i}_{name}": x
        for i, n in enumerate(after)
        for name, x in skeleton(poses[lands + n]).items()
    }
    return dict(moment=0.005 * after) | {name: x for name, x in points.items() if name[-1] != "y"}


def skeleton(pose):
    """Columns {"FR_x": (4,), ...} [m] of the points of each leg, hip joint to foot, in the robot's
    heading frame.

    pose: (19,) of MuJoCo, as qpos of a robot: position [m], quaternion and joint angles [rad] of
        the trunk
    """
    hip = pose[7::3]
    aside = go1.HIP_OFFSET * go1.SIDE
    thigh = go1.HIP + np.stack([0 * hip, aside * np.cos(hip), aside * np.sin(hip)], -1)
    lower = go1.leg_points(pose[7:]).reshape(4, 2, 3)
    points = np.concatenate([go1.HIP[:, None], thigh[:, None], lower], 1)
    trunk = Rotation.from_quat(pose[3:7], scalar_first=True)
    yaw = np.arctan2(*trunk.as_matrix()[[1, 0], 0])
    points = (Rotation.from_euler("z", -yaw) * trunk).apply(points.reshape(-1, 3)).reshape(4, 4, 3)
    points[..., 2] += pose[2]
    return {
        f"{leg}_{axis}": points[i, :, j]
        for i, leg in enumerate(go1.LEGS)
        for j, axis in enumerate("xyz")
    }


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


def loop(c):
    """The loop of Algorithm 1, with the numbers of one iteration of a run."""
    figure = Figure(figsize=(8, 3.7), layout="constrained")
    axes = figure.subplots()
    axes.set(xlim=(-0.75, 10.4), ylim=(-0.62, 4.62))
    axes.axis("off")
    n = {key: x[0] for key, x in c.items()}
    boxes = {  # x, y, half a width, text
        "pi": (0, 4, 0.3, "pi"),
        "L6": (2.6, 4, 0.8, f"L6 rollout tau\n{n['power']:.0f} W"),
        "L8": (5.7, 4, 0.9, "L8 estimate\nalpha A_r - A_f"),
        "L9": (9.0, 4, 0.95, "L9 PPO update"),
        "L12": (
            4.2,
            2.25,
            1.35,
            f"L12 gap J(pi) - J(pi')\n{n['J']:.3f} - {n['J'] - n['gap']:.3f} = {n['gap']:.3f}",
        ),
        "L13": (7.0, 2.25, 0.65, "L13 step\nagainst it"),
        "alpha": (9.3, 2.25, 0.4, f"alpha\n{n['alpha']:.0f}"),
        "pi'": (0, 0.5, 0.3, "pi'"),
        "L7": (2.6, 0.5, 0.8, f"L7 rollout tau'\n{n['prime_power']:.0f} W"),
        "L10": (5.7, 0.5, 0.75, "L10 estimate\nA_r"),
        "L11": (9.0, 0.5, 1.0, "L11 PPO update"),
    }
    for x, y, _, text in boxes.values():
        colour = {4: BLUE, 0.5: ORANGE}.get(y, RED)
        box = dict(boxstyle="round,pad=0.4", facecolor="white", edgecolor=colour, linewidth=1.6)
        axes.text(x, y, text, ha="center", va="center", fontsize=9.5, bbox=box, zorder=3)
    arrow = dict(arrowstyle="-|>", color="black", shrinkA=0, shrinkB=0)
    for row in ("pi L6 L8 L9", "L12 L13 alpha", "pi' L7 L10 L11"):
        for a, b in pairwise(row.split()):
            (x, y, half, _), (u, _, other, _) = boxes[a], boxes[b]
            axes.annotate("", (u - other, y), (x + half, y), arrowprops=arrow)
    for start, end in (
        ((5.3, 3.55), (4.6, 2.7)),
        ((5.3, 0.95), (4.6, 1.8)),
        ((8.85, 2.6), (6.1, 3.55)),
    ):
        axes.annotate("", end, start, arrowprops=arrow)
    notes = (
        (1.05, 4.12, "acts"),
        (1.05, 0.62, "acts"),
        (8.3, 3.15, "weighs the task"),
        (4.5, 4.4, "trains"),
        (4.5, -0.45, "trains"),
    )
    for x, y, text in notes:
        axes.text(x, y, text, ha="center", fontsize=9, color=GREY)
    for y, edge in ((4.57, 4.28), (-0.52, 0.22)):
        axes.plot([9, 9, 0, 0], [edge, y, y, y], color="black", linewidth=1)
        axes.annotate("", (0, edge), (0, y), arrowprops=arrow)
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


def pace(c):
    """alpha and power of EIPO on the four tasks, with a longer step of alpha and with the paper's;
    keys are task:step:column.
    """
    figure, axes = panels(4, 4.4, rows=2)
    labels = dict(longer="a longer step", paper="the paper's")
    styles = dict(longer=dict(color=BLUE), paper=dict(color=GREY, linestyle="--"))
    for i, task in enumerate(dict.fromkeys(key.split(":")[0] for key in c)):
        top, bottom = axes[i], axes[i + 4]
        for step, style in styles.items():
            x = c[f"{task}:{step}:steps"] / 1e6
            top.plot(x, c[f"{task}:{step}:alpha"], label=labels[step], **style)
            bottom.plot(x, c[f"{task}:{step}:power"], **style)
        x, prime = c[f"{task}:longer:steps"] / 1e6, c[f"{task}:longer:prime_power"]
        bottom.plot(x, prime, color=ORANGE, linestyle=":", linewidth=2)
        top.set_title(task, fontsize=10)
        top.ticklabel_format(useOffset=False)
        bottom.set_ylim(0, 1000)
        for a, label in ((top, "alpha"), (bottom, "power [W]")):
            a.set_xlabel("million steps", fontsize=8)
            a.set_ylabel(label, fontsize=8)
            a.tick_params(labelsize=8)
    axes[0].legend(frameon=False, fontsize=8)
    axes[4].text(0.5, 0.9, "dotted: pi'", color=ORANGE, transform=axes[4].transAxes, fontsize=8)
    return figure


def escape(c):
    """How standing is left: the speed of runs that stood, on a logarithmic axis, and its rate over
    alpha.
    """
    figure, (left, right) = panels(2, 3.0)
    for run in (key.removesuffix(":v_x") for key in c if key.endswith(":v_x")):
        style = "--" if "step" in run else "-"
        left.plot(c[f"{run}:iteration"], c[f"{run}:v_x"], style, color=sweep.color(run), label=run)
    left.axhline(0.3, color=GREY, linestyle=":", linewidth=0.8)
    left.set(xlabel="iteration", ylabel="speed of the batch [m/s]", yscale="log", ylim=(0.01, 5))
    left.legend(frameon=False, fontsize=8, loc="upper right")
    right.plot(c["alpha"], c["rate"], "o", color=BLUE)
    right.plot(c["stands"], 0 * c["stands"], "x", color=RED)
    right.text(50, 0.6, "stand", color=RED, fontsize=9)
    right.set(
        xlabel="alpha while the speed grows",
        ylabel="growth of ln v_x in 100 iterations",
        xscale="log",
    )
    return figure


def valley(c):
    """What a walk is worth on its way from standing, for several alpha; keys are panel:column."""
    figure = Figure(figsize=(8, 3.1), layout="constrained")
    names = list(dict.fromkeys(key.split(":")[0] for key in c if ":" in key))
    panels = figure.subplots(1, len(names), sharey=True)
    for axes, name in zip(panels, names, strict=True):
        for alpha, shade in zip((100, 200, 400, 1000), (0.35, 0.55, 0.75, 1.0), strict=True):
            worth = c[f"{name}:reward"] - c[f"{name}:F"] / alpha
            axes.plot(c["amplitude"], worth, color=colormaps["Blues"](shade), label=f"{alpha}")
        axes.plot(c["amplitude"], c[f"{name}:v_x"], ":", color=GREY, linewidth=2)
        axes.set(xlabel="amplitude", title=name.replace(" with", "\nwith"))
        axes.title.set_fontsize(10)
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_ylabel("J - F / alpha per step")
    panels[0].text(0.0, 1.1, "dotted: speed [m/s]", color=GREY, fontsize=8)
    handles = panels[0].get_legend_handles_labels()
    figure.legend(*handles, title="alpha", loc="outside right center", frameon=False, fontsize=8)
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


def stick(axes, c, prefix, shift=0.0):
    """Draw a skeleton from the side, far legs first and thinner."""
    hips = np.array([[c[f"{prefix}{leg}_{axis}"][0] for axis in "xz"] for leg in go1.LEGS])
    axes.plot(
        *(hips[[0, 2]] + [shift, 0]).T, color="black", linewidth=9, solid_capstyle="round", zorder=2
    )
    for leg, colour in zip(go1.LEGS, LEGS, strict=True):
        near = leg in ("FR", "RR")
        x, z = c[f"{prefix}{leg}_x"][1:] + shift, c[f"{prefix}{leg}_z"][1:]
        axes.plot(
            x,
            z,
            "o-",
            color=colour,
            linewidth=3 if near else 2,
            markersize=4,
            zorder=3 if near else 1,
        )


def hop(c):
    """The three-legged hop: four moments of a stride from its right, and the footfalls."""
    figure = Figure(figsize=(8, 4.2), layout="constrained")
    top, below = figure.subplots(2, 1, height_ratios=(1.25, 1))
    for i in range(4):
        stick(top, c, f"at{i}_", shift=0.75 * i)
        top.text(0.75 * i, 0.48, f"{1000 * c['moment'][i]:.0f} ms", ha="center", fontsize=9)
    top.axhline(0, color=GREY)
    top.set(
        xlabel="x [m], ahead is to the right; each moment is drawn 0.75 m further on",
        ylabel="height [m]",
        aspect="equal",
        ylim=(-0.03, 0.55),
    )
    footfalls(below, c)
    return figure


def footfalls(axes, c):
    """Bars for the feet that are on the ground, over time."""
    for i, (leg, colour) in enumerate(zip(go1.LEGS, LEGS, strict=True)):
        axes.fill_between(
            c["time"],
            -i - 0.38,
            -i + 0.38,
            where=c[leg] > 0,
            step="post",
            color=colour,
            linewidth=0,
        )
    axes.set(
        yticks=-np.arange(4),
        yticklabels=go1.LEGS,
        xlabel="time [s]",
        xlim=(0, c["time"][-1]),
        ylabel="on the ground",
    )
    axes.spines[["top", "right"]].set_visible(False)


def leap(c):
    """Footfalls of the running robot."""
    figure = Figure(figsize=(8, 1.9), layout="constrained")
    footfalls(figure.subplots(), c)
    return figure


def robot(c):
    """The robot with its joints and two frames; and one leg with its angles, and where its springs
    pull it.
    """
    figure = Figure(figsize=(8, 3.9), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.55, 1))
    # how the page's two axes look at x, y, z
    across = np.array([[0.88, 0.45, 0.0], [-0.12, 0.34, 0.93]])

    def put(*xyz):
        return across @ np.array(xyz)

    points = {
        leg: np.stack([put(*p) for p in zip(*(c[f"{leg}_{axis}"] for axis in "xyz"), strict=True)])
        for leg in go1.LEGS
    }
    hips = np.array([points[leg][0] for leg in ("FR", "FL", "RL", "RR", "FR")])
    left.fill(*hips.T, color="0.85", zorder=1)
    left.plot(*hips.T, color="black", linewidth=2, zorder=1)
    for leg, colour in zip(go1.LEGS, LEGS, strict=True):
        left.plot(
            *points[leg].T,
            "o-",
            color=colour,
            linewidth=4,
            markersize=6,
            markerfacecolor="white",
            zorder=2,
        )
        left.text(*(points[leg][-1] - [0.02, 0.045]), leg, color=colour, ha="center", weight="bold")
    for i, name in enumerate(("hip", "thigh", "calf", "foot")):
        left.annotate(
            name,
            points["FR"][i],
            points["FR"][i] + [0.1, (0.12, 0.0, 0.0, 0.0)[i]],
            arrowprops=dict(arrowstyle="-", color=GREY),
            fontsize=9,
            va="center",
        )
    for prefix, colour, name in (
        ("body", GREEN, "trunk's frame"),
        ("heading", "#cc79a7", "heading frame"),
    ):
        start = put(*c["origin"]) if prefix == "body" else put(-0.62, 0.1, 0.12)
        for axis in "xyz":
            end = start + across @ c[f"{prefix}_{axis}"]
            left.annotate(
                "",
                end,
                start,
                arrowprops=dict(arrowstyle="-|>", color=colour, linewidth=1.8),
                zorder=4,
            )
            left.text(
                end[0] - 0.01,
                end[1] + 0.02,
                axis,
                color=colour,
                fontsize=10,
                weight="bold",
                zorder=6,
            )
        x, y = start + np.array([-0.17, 0.16] if prefix == "body" else [0.0, -0.04])
        left.text(x, y, name, color=colour, fontsize=9, ha="center", va="top", zorder=4)
    left.set(aspect="equal", ylim=(-0.1, 0.57), xlim=(-0.58, 0.42))
    left.axis("off")
    for key, colour, style, width in (("target", GREY, "o--", 1.5), ("leg", BLUE, "o-", 4)):
        right.plot(c[key + "_x"], c[key + "_z"], style, color=colour, linewidth=width, markersize=7)
    (x, z), (u, v), _ = zip(c["leg_x"], c["leg_z"], strict=True)
    right.plot([x, x], [z, z - 0.16], ":", color="black")
    right.plot([u, u + (u - x) * 0.6], [v, v + (v - z) * 0.6], ":", color="black")
    right.text(x + 0.012, z - 0.15, "thigh 0.8 rad from\nstraight down", fontsize=9)
    right.text(
        u - 0.1, v - 0.1, "calf -1.5 rad from\nthe thigh's line", fontsize=9, ha="center", va="top"
    )
    right.text(
        -0.08,
        -0.345,
        "grey: where the springs pull\nif the thigh's target is 0.25 rad more",
        fontsize=9,
        color=GREY,
        va="top",
        ha="center",
    )
    right.set(
        aspect="equal",
        xlabel="x [m]",
        ylabel="z [m]",
        title="front right leg, from its right side",
        xlim=(-0.38, 0.2),
        ylim=(-0.42, 0.04),
    )
    right.spines[["top", "right"]].set_visible(False)
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
        loop,
        alpha,
        ahead,
        pace,
        escape,
        valley,
        reward,
        ground,
        commands,
        hop,
        leap,
        robot,
        motor,
        mirror,
        runs,
    )
}
