"""The paper's Figures 2 to 6 and Table I from our own runs, in the simulator that trained them."""

import io
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib import ticker
from matplotlib.figure import Figure
from PIL import Image

import evaluate
from lab import episodes, record, statistics, sweep
from runtime import run_folder

TABLE1 = dict(
    zip(
        sweep.KINDS,
        (
            (2.86, 2.84, 2.89),
            (2.12, 2.12, 2.12),
            (1.55, 1.53, 1.56),
            (1.49, 1.48, 1.50),
            (1.58, 1.57, 1.60),
            (1.64, 1.63, 1.65),
            (1.58, 1.55, 1.60),
            (1.62, 1.61, 1.62),
            (1.45, 1.45, 1.46),
            (1.37, 1.37, 1.37),
        ),
        strict=True,
    )
)  # m/s, Table I
HARDWARE = {"EIPO": 2.5, "PPO(0.01)": 1.5}  # m/s, peaks of the real robot, Section VI (D45)


def by_command(folders, task, commands, columns, args, statistic=np.mean):
    """Rows of a CSV, a row for each kind of run and each command, from episodes with random starts.

    Each has a statistic of some columns of Episodes, with intervals. "energy" is energy per metre.

    commands: (n, 3). Every run plays about args.episodes episodes, equally many of each command,
        and as many from the nominal pose, of which the rows have the share that fell.
    """
    each = max(1, args.episodes // len(commands))
    rows = []
    for name, runs in sweep.by_label(folders, task).items():
        both = [episodes.both_starts(folder, task, commands, each, args) for folder in runs]
        played, nominal = zip(*both, strict=True)
        for i, command in enumerate(commands):
            mine = slice(i * each, (i + 1) * each)
            row = dict(task=task, run=name, v_x_asked=command[0], yaw_asked=command[2])
            row |= dict(seeds=len(runs), episodes=each)
            row |= dict(fell=np.mean([e.fell[mine] for e in played]))
            row |= dict(fell_nominal=np.mean([e.fell[mine] for e in nominal]))
            for column in columns:
                names = ("power", "v_x") if column == "energy" else (column,)
                of = evaluate.energy_per_metre if column == "energy" else statistic
                seeds = [[getattr(e, name)[mine] for name in names] for e in played]
                row |= statistics.summarise(column, seeds, of)
            rows.append(row)
    return rows


def draw_lines(axes, rows, x, column):
    """Draw each kind of run: its mean, its interval over episodes and, lighter, over seeds."""
    names = list(dict.fromkeys(row["run"] for row in rows))
    for i, name in enumerate(names):
        mine = [row for row in rows if row["run"] == name]
        at, y = (np.array([row[c] for row in mine], float) for c in (x, column))
        color = sweep.color(name)
        alpha = 0.25 if len(names) < 4 else 0.1
        style = dict(linewidth=1.2, marker="sv^D<>px*"[i % 9])
        if name == "EIPO":
            style = dict(linewidth=2.5, marker="o")
        style |= dict(markersize=4, markevery=max(1, len(at) // 10))
        axes.plot(at, y, label=name, color=color, **style)
        for over, shade in (("", alpha), ("_seeds", alpha / 2)):
            low, high = (
                np.array([row[f"{column}{over}_{end}"] for row in mine], float)
                for end in ("low", "high")
            )
            axes.fill_between(at, low, high, color=color, alpha=shade, linewidth=0)
    axes.grid(alpha=0.3)


def name_lines(axes):
    """Write the name of each line of the axes beside its end, one above the other.

    A line without a finite number ends at the top: robots that do not move spend infinite J/m.
    """
    to_axes = axes.transScale + axes.transLimits  # from data, also on a logarithmic axis
    finite = [y[np.isfinite(y)] for y in (line.get_ydata() for line in axes.lines)]
    ends = [to_axes.transform((0, y[-1]))[1] if len(y) else 1.0 for y in finite]
    order = np.argsort(ends)
    step = 0.055
    places = np.clip(ends, 0, 1)
    for below, above in pairwise(order):
        places[above] = max(places[above], places[below] + step)
    places[order] = np.minimum(places[order], 1 - step * np.arange(len(order))[::-1])
    for line, end, place in zip(axes.lines, ends, places, strict=True):
        style = dict(fontsize=7, va="center", annotation_clip=False)
        arrow = dict(arrowstyle="-", color=line.get_color(), linewidth=0.6)
        at = (1.0, max(end, 0))
        text = (1.04, place)
        style |= dict(xycoords="axes fraction", textcoords="axes fraction", arrowprops=arrow)
        axes.annotate(line.get_label(), at, text, **style)


def draw_panels(rows, panels, floors=None):
    """A Figure with a panel over the command v_x for each (task, column, label of the y axis).

    floors: {task: where the y axis begins}, below which lines leave the panel
    """
    figure = Figure(figsize=(5 * len(panels), 3.6), layout="constrained")
    for axes, (task, column, title) in zip(
        figure.subplots(1, len(panels), squeeze=False).flat, panels, strict=True
    ):
        axes.set(xlabel="command v_x [m/s]", ylabel=title, title=f"{task} ground", xlim=(0, 1))
        if column == "energy":  # a robot that is asked to stand spends much per metre
            axes.set_yscale("log")
            axes.yaxis.set_major_locator(ticker.LogLocator(2))
            axes.yaxis.set_major_formatter(ticker.ScalarFormatter())
            axes.yaxis.set_minor_locator(ticker.NullLocator())
        draw_lines(axes, [row for row in rows if row["task"] == task], "v_x_asked", column)
        axes.set_ylim(bottom=(floors or {}).get(task))
        name_lines(axes)
    return figure


def fig2(folders, args, task="flat"):
    """Task performance and energy per velocity on flat ground, by command. Section V-A."""
    rows = by_command(folders, task, evaluate.COMMANDS, ("performance", "energy"), args)
    return rows, draw_panels(
        rows, [(task, "performance", "task performance"), (task, "energy", "energy [J/m]")]
    )


def fig3(folders, args):
    """As `fig2`, on rough ground of 15 cm. Section V-B."""
    return fig2(folders, args, "rough")


def fig4(folders, args):
    """Task performance of every lambda on flat and rough ground, or on the one with runs. V-C."""
    tasks = {run_folder.load_config(Path(folder))[0].task for folder in folders}
    if not (tasks := [task for task in ("flat", "rough") if task in tasks]):
        raise ValueError("none of the run folders is of the task flat or rough")
    rows = [
        row
        for task in tasks
        for row in by_command(folders, task, evaluate.COMMANDS, ("performance",), args)
    ]
    panels = [(task, "performance", "task performance") for task in tasks]
    return rows, draw_panels(rows, panels, floors=dict(flat=1.2, rough=0.8))


def fig5(folders, args):
    """Task performance and power over commands of v_x and yaw rate. Section V-E."""
    commands = np.array(
        [(x, 0.0, yaw) for x in np.linspace(-1, 4, 11) for yaw in np.linspace(-5, 5, 11)]
    )
    rows = by_command(folders, "curriculum", commands, ("performance", "power"), args)
    names = list(dict.fromkeys(row["run"] for row in rows))
    figure = Figure(figsize=(3.2 * len(names) + 1, 5.6), layout="constrained")
    panels = figure.subplots(2, len(names), squeeze=False, sharex=True, sharey=True)
    for i, column in enumerate(("performance", "power")):
        values = np.array(
            [[row[column] for row in rows if row["run"] == name] for name in names]
        ).reshape(-1, 11, 11)
        for axes, name, value in zip(panels[i], names, values, strict=True):
            image = axes.pcolormesh(
                commands[:11, 2], commands[::11, 0], value, vmin=values.min(), vmax=values.max()
            )
            axes.set(title=name if i == 0 else "")
        figure.colorbar(image, ax=panels[i], label=("task performance", "power [W]")[i])
    figure.supxlabel("command yaw rate [rad/s]")
    figure.supylabel("command v_x [m/s]")
    return rows, figure


def fig6(folders, args):
    """Mean speed over time of the robots that have not fallen. Section VI.

    Dotted lines are peaks of the paper's robot (D45).

    Each point is a mean over about a period of the clock, which smooths the strides.
    """
    rows = []
    for name, runs in sweep.by_label(folders, "velocity").items():
        series = []
        for folder in runs:
            policy, env = evaluate.load(
                folder, args.episodes, args.clip, args.roughness, world=args.world
            )
            played = evaluate.steps(policy, env)
            v_x = np.array([np.where(alive, log["v_x"], np.nan) for _, log, alive, _ in played])
            strides = max(1, int(len(v_x) * env.period * env.env_cfg.clock_hz))
            series.append([stride.mean(0) for stride in np.array_split(v_x, strides)])
        time = [
            env.period * stride.mean()
            for stride in np.array_split(np.arange(len(v_x)) + 0.5, strides)
        ]
        rows += [
            dict(task="velocity", run=name, time=t, seeds=len(runs), episodes=args.episodes)
            | statistics.summarise("v_x", at)
            for t, *at in zip(time, *series, strict=True)
        ]
    figure = Figure(figsize=(5, 3.6), layout="constrained")
    draw_lines(axes := figure.subplots(), rows, "time", "v_x")
    name_lines(axes)
    for name, peak in HARDWARE.items():
        axes.axhline(peak, color="black", linestyle=":", linewidth=1)
        axes.text(rows[-1]["time"], peak, f"{name}, the paper's robot", ha="right", va="bottom")
    axes.set(xlabel="time [s]", ylabel="speed ahead [m/s]")
    return rows, figure


def table1(folders, args):
    """Interquartile mean of the peak velocity of every lambda, beside the paper's. Table I."""
    columns = "peak", "peak_sustained", "v_x", "v_x_late", "power", "energy"
    rows = by_command(folders, "velocity", np.zeros((1, 3)), columns, args, statistics.iqm)  # D26
    for row in rows:
        printed = TABLE1.get(row["run"].split(",")[0], [np.nan] * 3)
        row |= zip(("paper", "paper_low", "paper_high"), printed, strict=True)
    at = np.arange(len(rows))[::-1]
    figure = Figure(figsize=(5, 0.4 * len(rows) + 1.2), layout="constrained")
    axes = figure.subplots()
    over_seeds = [[row[f"peak_seeds_{end}"] for row in rows] for end in ("low", "high")]
    wide = dict(color="#0072B2", alpha=0.3, linewidth=5, label="ours, over seeds")
    axes.hlines(at, *over_seeds, **wide)
    ours = dict(label="ours", fmt="o", color="#0072B2")
    printed = dict(label="the paper's", fmt="D", color="#D55E00", markerfacecolor="none")
    for name, style in (("peak", ours), ("paper", printed)):
        mean, low, high = (
            np.array([row[c] for row in rows]) for c in (name, f"{name}_low", f"{name}_high")
        )
        axes.errorbar(mean, at, xerr=np.nan_to_num([mean - low, high - mean]), capsize=3, **style)
    axes.set(yticks=at, yticklabels=[row["run"] for row in rows], xlabel="peak velocity [m/s]")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside upper center", ncols=3, fontsize=8)
    return rows, figure


def save(out, what, rows, figure):
    """Write what.csv and what.png into the folder out: both, or if that fails neither."""
    rounded = ({k: f"{x:.5g}" if isinstance(x, float) else x for k, x in r.items()} for r in rows)
    table = record.as_csv([*rounded])
    drawn = io.BytesIO()
    image = io.BytesIO()
    figure.savefig(drawn, dpi=150, format="png")
    colours = Image.open(drawn).convert("RGB").quantize(128, dither=Image.Dither.NONE)
    colours.save(image, "PNG", optimize=True)  # a third of the size

    def write(file):  # the PNG takes its place once the CSV is written, and before it takes its own
        file.write(table)
        file.flush()
        run_folder.replace_file(out / f"{what}.png", lambda png: png.write(image.getvalue()))

    run_folder.replace_file(out / f"{what}.csv", write)
    print(f"{out / what}.csv and .png")
