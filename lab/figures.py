"""The paper's Figures 2 to 6 and Table I, from kept episodes.

Each figure is a function of Runs that returns the rows of its CSV and the picture.
"""

import io

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator
from PIL import Image

import evaluate
from lab import record, statistics
from lab.kinds import KINDS, by_kind, style
from runtime import run_folder
from runtime.command import Refused

PEAKS = 2.86, 2.12, 1.55, 1.49, 1.58, 1.64, 1.58, 1.62, 1.45, 1.37
TABLE1 = dict(zip(KINDS, PEAKS, strict=True))  # m/s, as printed in Table I
HARDWARE = {"EIPO": 2.5, "PPO(0.01)": 1.5}  # m/s, peaks of the real robot, Section VI (D45)
BOTTOM = dict(flat=1.2, rough=0.8)  # of the axis: runs that stand are far below the others
LABELS = dict(
    performance="task performance", energy="energy [J/m]", power="power [W]", peak="peak [m/s]"
)


def save(out, name, figure, rows=()):
    """Write name.png and, of rows, name.csv into the folder out.

    The PNG has 128 colours, which makes it a third of the size.
    """
    out.mkdir(parents=True, exist_ok=True)
    if rows:
        record.write(out / f"{name}.csv", rows)
    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=150, format="png")
    image = Image.open(drawn).convert("RGB").quantize(128, dither=Image.Dither.NONE)
    run_folder.replace_file(out / f"{name}.png", lambda f: image.save(f, "PNG", optimize=True))


# ---- what the figures share ----


def by_command(runs, task, commands, columns, statistic=np.mean):
    """Rows of a CSV: for each kind of run and each command (n, 3), a statistic of some columns of
    Episodes from random starts, with its intervals. "energy" is energy per metre.
    """
    rows = []
    for name, seeds in by_kind([run for run in runs if run.episodes], task).items():
        for command in commands:
            each = [
                record.where(np.isclose([e[x] for x in record.ASKED], command[:, None]).all(0), e)
                for e in map(record.evaluation, seeds)
            ]
            n = min(len(e["fell"]) for e in each)  # so that every seed counts as much
            each = [{column: x[:n] for column, x in e.items()} for e in each]
            row = dict(task=task, run=name, v_x_asked=command[0], yaw_asked=command[2])
            row |= dict(seeds=len(seeds), episodes=n, fell=np.mean([e["fell"] for e in each]))
            for column in columns:
                names = ("power", "v_x") if column == "energy" else (column,)
                of = evaluate.energy_per_metre if column == "energy" else statistic
                row |= statistics.summarise(column, [[e[x] for x in names] for e in each], of)
            rows.append(row)
    return rows


def panels_by(column, rows, num_panels):
    """A Figure with panels one above the other for each group of rows.

    Returns the Figure and [(what the rows of a group have in the column, they, its Axes), ...].
    """
    if not (groups := record.grouped(rows, column)):
        raise Refused("none of the runs has what is to be drawn")
    figure = Figure(figsize=(4 * len(groups), 3 * num_panels + 1.5), layout="constrained")
    panels = figure.subplots(num_panels, len(groups), squeeze=False, sharex="col").T
    for name, (top, *_) in zip(groups, panels, strict=True):
        top.set_title(name.replace(" at ", "\nat "), fontsize=10)
    return figure, list(zip(groups, groups.values(), panels, strict=True))


def legend(column):
    """Name the kinds of runs of the first panel below the last one."""
    place = dict(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2, fontsize=7)
    column[-1].legend(*column[0].get_legend_handles_labels(), **place)


def log_axis(axes, which):
    """Make "x" or "y" logarithmic, with ticks at 1, 2, 5, 10, ..."""
    axes.set(**{f"{which}scale": "log"})
    axis = {"x": axes.xaxis, "y": axes.yaxis}[which]
    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_locator(NullLocator())


# ---- over commands ----


def draw_lines(axes, rows, column):
    """Draw each kind of run over the command v_x: its mean, its interval over episodes and,
    lighter, over seeds.
    """
    for name, mine in record.grouped(rows, "run").items():
        ends = "", "_low", "_high", "_seeds_low", "_seeds_high"
        at, mean, *bands = (
            [row[x] for row in mine] for x in ("v_x_asked", *(column + x for x in ends))
        )
        look = style(name)
        axes.plot(at, mean, markersize=4, label=f"{name}, n = {mine[0]['seeds']}", **look)
        axes.fill_between(at, *bands[:2], color=look["color"], alpha=0.2, linewidth=0)
        axes.fill_between(at, *bands[2:], color=look["color"], alpha=0.1, linewidth=0)
    axes.grid(alpha=0.3)


def over_commands(runs, tasks, columns):
    """Rows and a Figure of some columns by command, a panel for each task and column."""
    rows = []
    for task in tasks:
        rows += by_command(runs, task, evaluate.commands_of(task), columns)
    figure, panels = panels_by("task", rows, len(columns))
    for task, mine, all_axes in panels:
        for axes, column in zip(all_axes, columns, strict=True):
            draw_lines(axes, mine, column)
            axes.set(xlabel="command v_x [m/s]", ylabel=LABELS[column], xlim=(0, 1))
        all_axes[0].set_ylim(bottom=BOTTOM[task])
        if "energy" in columns:  # a robot that is asked to stand spends much per metre
            log_axis(all_axes[1], "y")
        legend(all_axes)
    return rows, figure


def fig2(runs):
    """Task performance and J/m by command, flat ground. Section V-A."""
    return over_commands(runs, ["flat"], ("performance", "energy"))


def fig3(runs):
    """The same on rough ground of 15 cm. Section V-B."""
    return over_commands(runs, ["rough"], ("performance", "energy"))


def fig4(runs):
    """Task performance of every lambda on flat and rough ground. Section V-C."""
    return over_commands(runs, ["flat", "rough"], ("performance",))


def fig5(runs):
    """Task performance and power over commands of v_x and yaw rate. Section V-E."""
    rows = by_command(runs, "curriculum", record.GRID, ("performance", "power"))
    figure, panels = panels_by("run", rows, 2)
    v_x, yaw = record.GRID[::11, 0], record.GRID[:11, 2]
    for i, column in enumerate(("performance", "power")):
        values = np.array([row[column] for row in rows]).reshape(-1, 11, 11)
        line = [all_axes[i] for _, _, all_axes in panels]
        for axes, value in zip(line, values, strict=True):
            image = axes.pcolormesh(yaw, v_x, value, vmin=values.min(), vmax=values.max())
        figure.colorbar(image, ax=line, label=LABELS[column])
    figure.supxlabel("command yaw rate [rad/s]")
    figure.supylabel("command v_x [m/s]")
    return rows, figure


# of Figure 5, from and to: commands of v_x [m/s], and the size of the yaw rate [rad/s]
REGIONS = {
    "straight ahead, 0 to 1.5 m/s": (0, 1.5, 0, 0),
    "straight ahead, 2 to 4 m/s": (2, 4, 0, 0),
    "backwards, 0.5 and 1 m/s": (-1, -0.5, 0, 0),
    "0 to 1 m/s ahead, turning at 1 or 2 rad/s": (0, 1, 1, 2),
    "0 to 1 m/s ahead, turning at 3 to 5 rad/s": (0, 1, 3, 5),
    "all": (-1, 4, 0, 5),
}


def regions(rows):
    """Yields Figure 5 by region, as lines of Markdown: task performance, power, early ends."""
    names = "v_x_asked", "yaw_asked", "performance", "power", "fell"
    kinds = record.grouped(rows, "run")
    table = [[[float(row[x]) for x in names] for row in mine] for mine in kinds.values()]
    (v_x, *_), (yaw, *_), *numbers = np.moveaxis(table, -1, 0)  # (kinds, commands) each
    yield f"| commands | how many | {' | '.join(kinds)} |\n{'|---' * (len(kinds) + 2)}|"
    for region, (slowest, fastest, least, most) in REGIONS.items():
        mine = (slowest <= v_x) & (v_x <= fastest) & (least <= abs(yaw)) & (abs(yaw) <= most)
        means = np.transpose([number[:, mine].mean(1) for number in numbers])
        cells = (f"{j:.2f}, {w:.0f} W, {100 * fell:.0f} %" for j, w, fell in means)
        yield f"| {region} | {mine.sum()} | {' | '.join(cells)} |"


# ---- velocity ----


def fig6(runs):
    """Speed over time on velocity, of the robots that have not fallen. Section VI.

    A line is a seed, and a thick one the mean of a kind. Dotted lines are the peaks of the paper's
    robot (D45).
    """
    rows = []
    figure = Figure(figsize=(6.5, 3.6), layout="constrained")
    axes = figure.subplots()
    for name, seeds in by_kind([run for run in runs if run.speed], "velocity").items():
        time = seeds[0].speed["time"]
        speeds = {run.name: run.speed["v_x"] for run in seeds}
        speeds["mean"] = np.mean(list(speeds.values()), 0)
        color = style(name)["color"]
        for seed, v_x in speeds.items():
            axes.plot(time, v_x, color=color, linewidth=0.6, alpha=0.5)
            about = dict(task="velocity", kind=name, run=seed)
            rows += [about | dict(time=t, v_x=v) for t, v in zip(time, v_x, strict=True)]
        axes.plot(time, v_x, color=color, linewidth=2, label=f"{name}, n = {len(seeds)}")
    for name, peak in HARDWARE.items():
        axes.axhline(peak, color="black", linestyle=":", linewidth=1)
        axes.text(time[-1], peak, f"{name}, the paper's robot", ha="right", va="bottom", fontsize=7)
    axes.set(xlabel="time [s]", ylabel="speed ahead [m/s]")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right center", fontsize=8)
    return rows, figure


def table1(runs):
    """Peak velocity of every lambda beside what the paper prints. Table I.

    Interquartile means over the episodes of all seeds (D26).
    """
    columns = "peak", "v_x", "power", "energy"
    rows = by_command(runs, "velocity", np.zeros((1, 3)), columns, statistics.iqm)
    for row in rows:
        row["paper"] = TABLE1.get(row["run"].split(",")[0], np.nan)
    at = np.arange(len(rows))[::-1]
    figure = Figure(figsize=(6, 0.35 * len(rows) + 1.2), layout="constrained")
    axes = figure.subplots()
    over_seeds = [[row[f"peak_seeds_{end}"] for row in rows] for end in ("low", "high")]
    axes.hlines(at, *over_seeds, color="#0072B2", alpha=0.3, linewidth=5, label="ours, over seeds")
    peak, low, high, paper = (
        np.array([row[name] for row in rows]) for name in ("peak", "peak_low", "peak_high", "paper")
    )
    axes.errorbar(peak, at, xerr=[peak - low, high - peak], fmt="o", capsize=3, label="ours")
    axes.plot(paper, at, "D", color="#D55E00", markerfacecolor="none", label="the paper's")
    labels = [f"{row['run']}, n = {row['seeds']}" for row in rows]
    axes.set(yticks=at, yticklabels=labels, xlabel="peak velocity [m/s]")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside upper center", ncols=3, fontsize=8)
    return rows, figure
