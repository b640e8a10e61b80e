"""The paper's Figures 2 to 6 and Table I, and two pictures of all runs, from kept episodes.

Each figure is a function of Runs that returns the rows of its CSV and the picture.
"""

import io

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

import evaluate
from lab import record, statistics, sweep
from runtime import run_folder

PRINTED = (
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
)
TABLE1 = dict(zip(sweep.KINDS, PRINTED, strict=True))  # m/s and interval, Table I
HARDWARE = {"EIPO": 2.5, "PPO(0.01)": 1.5}  # m/s, peaks of the real robot, Section VI (D45)
BOTTOM = dict(flat=1.2, rough=0.8)  # task performance at which the y axis begins
# the score of a run in the pictures of all runs: its name and the label of its axis
SCORES = dict(
    flat=("performance", "task performance"),
    rough=("performance", "task performance"),
    velocity=("peak", "peak velocity [m/s]"),
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


# ---- over commands ----


def by_command(runs, task, commands, columns, statistic=np.mean):
    """Rows of a CSV: for each kind of run and each command (n, 3), a statistic of some columns of
    Episodes with its intervals. "energy" is energy per metre.

    They are of random starts, but for `fell_nominal`. Every seed counts with as many episodes.
    """
    rows = []
    runs = [run for run in runs if run.episodes]
    for name, seeds in sweep.by_kind(runs, task).items():
        for command in commands:
            random, nominal = (
                [at_command(record.evaluation(run, nominal=start), command) for run in seeds]
                for start in (False, True)
            )
            each = min(len(e["fell"]) for e in random)
            random = [{column: x[:each] for column, x in e.items()} for e in random]
            row = dict(task=task, run=name, v_x_asked=command[0], yaw_asked=command[2])
            row |= dict(seeds=len(seeds), episodes=each)
            row |= dict(fell=np.mean([e["fell"] for e in random]))
            row |= dict(fell_nominal=np.mean([e["fell"].mean() for e in nominal]))
            for column in columns:
                names = ("power", "v_x") if column == "energy" else (column,)
                of = evaluate.energy_per_metre if column == "energy" else statistic
                row |= statistics.summarise(column, [[e[x] for x in names] for e in random], of)
            rows.append(row)
    return rows


def at_command(e, command):
    """The columns of the episodes that were asked for one command (3,)."""
    asked = np.column_stack([e["asked_v_x"], e["asked_v_y"], e["asked_yaw"]])
    mine = np.isclose(asked, command).all(1)
    return {column: x[mine] for column, x in e.items()}


def draw_lines(axes, rows, x, column):
    """Draw each kind of run: its mean, its interval over episodes and, lighter, over seeds."""
    names = list(dict.fromkeys(row["run"] for row in rows))
    for i, name in enumerate(names):
        mine = [row for row in rows if row["run"] == name]
        at, y = (np.array([row[c] for row in mine], float) for c in (x, column))
        style = dict(linewidth=1.2, marker="sv^D<>px*"[i % 9])
        if name == "EIPO":
            style = dict(linewidth=2.5, marker="o")
        style |= dict(markersize=4, color=sweep.color(name))
        axes.plot(at, y, label=f"{name}, n = {mine[0]['seeds']}", **style)
        for over, alpha in (("", 0.2), ("_seeds", 0.1)):
            ends = [[row[f"{column}{over}_{end}"] for row in mine] for end in ("low", "high")]
            style = dict(color=sweep.color(name), alpha=alpha, linewidth=0)
            axes.fill_between(at, *np.array(ends, float), **style)
    axes.grid(alpha=0.3)


def draw_panels(rows, panels):
    """A Figure with a panel over the command v_x for each (task, column, label of the y axis)."""
    figure = Figure(figsize=(5.5 * len(panels), 3.6), layout="constrained")
    for axes, (task, column, label) in zip(
        figure.subplots(1, len(panels), squeeze=False).flat, panels, strict=True
    ):
        if column == "energy":  # a robot that is asked to stand spends much per metre
            axes.set_yscale("log")
            axes.set_yticks(ticks := (100, 200, 400, 800, 1600, 3200), ticks)
            axes.minorticks_off()
        draw_lines(axes, [row for row in rows if row["task"] == task], "v_x_asked", column)
        axes.set(xlabel="command v_x [m/s]", ylabel=label, title=f"{task} ground", xlim=(0, 1))
        axes.set_ylim(bottom=BOTTOM.get(task) if column == "performance" else None)
        axes.legend(loc="upper left", bbox_to_anchor=(1, 1), fontsize=8)
    return figure


def fig2(runs, task="flat"):
    """Task performance and J/m by command, flat ground. Section V-A."""
    rows = by_command(runs, task, evaluate.COMMANDS, ("performance", "energy"))
    panels = [(task, "performance", "task performance"), (task, "energy", "energy [J/m]")]
    return rows, draw_panels(rows, panels)


def fig3(runs):
    """The same on rough ground of 15 cm. Section V-B."""
    return fig2(runs, "rough")


def fig4(runs):
    """Task performance of every lambda on flat and rough ground. Section V-C."""
    tasks = [x for x in ("flat", "rough") if any(run.settings["task"] == x for run in runs)]
    rows = [
        row for task in tasks for row in by_command(runs, task, evaluate.COMMANDS, ("performance",))
    ]
    panels = [(task, "performance", "task performance") for task in tasks]
    return rows, draw_panels(rows, panels)


def fig5(runs):
    """Task performance and power over commands of v_x and yaw rate. Section V-E."""
    rows = by_command(runs, "curriculum", record.GRID, ("performance", "power"))
    names = list(dict.fromkeys(row["run"] for row in rows))
    figure = Figure(figsize=(3.2 * len(names) + 1, 5.6), layout="constrained")
    panels = figure.subplots(2, len(names), squeeze=False, sharex=True, sharey=True)
    v_x, yaw = record.GRID[::11, 0], record.GRID[:11, 2]
    for line, column, unit in zip(panels, ("performance", "power"), ("-", "W"), strict=True):
        values = np.array([row[column] for row in rows]).reshape(-1, 11, 11)
        for axes, value in zip(line, values, strict=True):
            image = axes.pcolormesh(yaw, v_x, value, vmin=values.min(), vmax=values.max())
        figure.colorbar(image, ax=line, label=f"{column} [{unit}]")
    for axes, name in zip(panels[0], names, strict=True):
        axes.set_title(name.replace(" at ", "\nat "), fontsize=10)
    figure.supxlabel("command yaw rate [rad/s]")
    figure.supylabel("command v_x [m/s]")
    return rows, figure


REGIONS = {  # of Figure 5, by commands of v_x [m/s] and the size of the yaw rate [rad/s]
    "straight ahead, 0 to 1.5 m/s": lambda x, yaw: (x >= 0) & (x <= 1.5) & (yaw == 0),
    "straight ahead, 2 to 4 m/s": lambda x, yaw: (x >= 2) & (yaw == 0),
    "backwards, 0.5 and 1 m/s": lambda x, yaw: (x < 0) & (yaw == 0),
    "0 to 1 m/s ahead, turning at 1 or 2 rad/s": lambda x, yaw: (
        (x >= 0) & (x <= 1) & (yaw >= 1) & (yaw <= 2)
    ),
    "0 to 1 m/s ahead, turning at 3 to 5 rad/s": lambda x, yaw: (x >= 0) & (x <= 1) & (yaw >= 3),
    "all": lambda x, yaw: x == x,
}


def regions(rows):
    """Yields Figure 5 by region, as lines of Markdown: task performance, power, early ends."""
    names = "v_x_asked", "yaw_asked", "performance", "power", "fell"
    kinds = list(dict.fromkeys(row["run"] for row in rows))
    table = [[[float(row[x]) for x in names] for row in rows if row["run"] == k] for k in kinds]
    yield f"| commands | how many | {' | '.join(kinds)} |\n{'|---' * (len(kinds) + 2)}|"
    for region, contains in REGIONS.items():
        x, yaw, *numbers = np.moveaxis(table, -1, 0)  # each (kinds, commands)
        mine = contains(x[0], abs(yaw[0]))
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
    kinds = sweep.by_kind([run for run in runs if run.speed], "velocity")
    for name, seeds in kinds.items():
        time = seeds[0].speed["time"]
        v_x = np.array([run.speed["v_x"] for run in seeds])
        columns = {run.name: v for run, v in zip(seeds, v_x, strict=True)} | dict(mean=v_x.mean(0))
        color = sweep.color(name)
        for seed, speed in columns.items():
            style = dict(linewidth=2, label=f"{name}, n = {len(seeds)}")
            style = style if seed == "mean" else dict(linewidth=0.6, alpha=0.5)
            axes.plot(time, speed, color=color, **style)
            about = dict(task="velocity", kind=name, run=seed)
            rows += [about | dict(time=t, v_x=v) for t, v in zip(time, speed, strict=True)]
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
    columns = "peak", "peak_sustained", "v_x", "v_x_late", "power", "energy"
    rows = by_command(runs, "velocity", np.zeros((1, 3)), columns, statistics.iqm)
    for row in rows:
        printed = TABLE1.get(row["run"].split(",")[0], [np.nan] * 3)
        row |= zip(("paper", "paper_low", "paper_high"), printed, strict=True)
    at = np.arange(len(rows))[::-1]
    figure = Figure(figsize=(6, 0.35 * len(rows) + 1.2), layout="constrained")
    axes = figure.subplots()
    over_seeds = [[row[f"peak_seeds_{end}"] for row in rows] for end in ("low", "high")]
    axes.hlines(at, *over_seeds, color="#0072B2", alpha=0.3, linewidth=5, label="ours, over seeds")
    ours = dict(label="ours", fmt="o", color="#0072B2")
    printed = dict(label="the paper's", fmt="D", color="#D55E00", markerfacecolor="none")
    for name, style in (("peak", ours), ("paper", printed)):
        mean, low, high = (np.array([r[name + x] for r in rows]) for x in ("", "_low", "_high"))
        axes.errorbar(mean, at, xerr=np.nan_to_num([mean - low, high - mean]), capsize=3, **style)
    labels = [f"{row['run']}, n = {row['seeds']}" for row in rows]
    axes.set(yticks=at, yticklabels=labels, xlabel="peak velocity [m/s]")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside upper center", ncols=3, fontsize=8)
    return rows, figure


# ---- all runs ----


def dots(runs):
    """A row for each run whose episodes were kept: what it is, its score, its power, its alpha."""
    rows = []
    for run in runs:
        s = run.settings
        if run.episodes and s["task"] in SCORES and s["clip"] == "power":
            e = record.evaluation(run)
            row = dict(task=s["task"], run=run.name, kind=sweep.kind(s), algo=s["algo"])
            row |= dict(lam=s["lam"], seed=s["seed"])
            row |= dict(score=statistics.NUMBERS[SCORES[s["task"]][0]](e))
            row |= dict(power=statistics.NUMBERS["power"](e))
            rows.append(row | dict(alpha=run.metrics.get("alpha", [np.nan])[-1]))
    if not rows:
        raise ValueError(f"none of the runs is of {', '.join(SCORES)} and has kept episodes")
    return rows


def scatter(axes, rows, x, y):
    """A dot for each row, EIPO's a diamond, and the mean of each kind as a larger one."""
    for kind in dict.fromkeys(row["kind"] for row in rows):
        mine = [row for row in rows if row["kind"] == kind]
        at = np.array([(row[x], row[y]) for row in mine])
        style = dict(color=sweep.color(kind), marker="D" if mine[0]["algo"] == "eipo" else "o")
        axes.scatter(*at.T, 12, alpha=0.6, linewidths=0, **style)
        axes.scatter(*at.mean(0), 50, edgecolors="white", linewidths=0.5, **style)
    axes.grid(alpha=0.3)


def explain(figure):
    """The legend: EIPO, and PPO by groups of lambdas."""
    groups = {}
    for kind in sweep.KINDS:
        groups.setdefault(sweep.color(kind), []).append(kind)
    for color, kinds in groups.items():
        style = dict(marker="D" if kinds[0] == "EIPO" else "o", color=color)
        name = " to ".join(dict.fromkeys((kinds[0], kinds[-1])))
        figure.axes[0].scatter([], [], label=name, **style)
    figure.legend(loc="outside upper center", fontsize=8, ncols=len(groups))


def tradeoff(runs):
    """Score over power, a small dot for each seed and a large one for the mean of a kind."""
    rows = dots(runs)
    tasks = list(dict.fromkeys(row["task"] for row in rows))
    figure = Figure(figsize=(4.2 * len(tasks), 4.5), layout="constrained")
    for axes, task in zip(figure.subplots(1, len(tasks), squeeze=False)[0], tasks, strict=True):
        scatter(axes, [row for row in rows if row["task"] == task], "power", "score")
        axes.set(xlabel="power [W]", ylabel=SCORES[task][1], title=task, xscale="log")
        axes.set_xticks(ticks := (50, 100, 200, 400, 800), ticks)
        axes.minorticks_off()
        for name in ("EIPO", "PPO(0)") if task == "velocity" else ():
            axes.axhline(TABLE1[name][0], color="black", linestyle=":", linewidth=0.8)
            axes.text(50, TABLE1[name][0], f"{name}, the paper's", fontsize=7, va="bottom")
    explain(figure)
    return rows, figure


def lambdas(runs):
    """Score, power and the last 1 / alpha over lambda: of PPO, and over lambda_0 of EIPO.

    lambda = 0 is at the left end.
    """
    rows = [row | dict(at=max(row["lam"], 5e-5), end=1 / row["alpha"]) for row in dots(runs)]
    tasks = list(dict.fromkeys(row["task"] for row in rows))
    figure = Figure(figsize=(4.2 * len(tasks), 8), layout="constrained")
    panels = figure.subplots(3, len(tasks), squeeze=False, sharex=True)
    for column, task in zip(panels.T, tasks, strict=True):
        mine = [row for row in rows if row["task"] == task]
        scatter(column[0], mine, "at", "score")
        scatter(column[1], mine, "at", "power")
        scatter(column[2], [row for row in mine if row["algo"] == "eipo"], "at", "end")
        column[0].set(title=task, ylabel=SCORES[task][1], xscale="log")
        column[1].set(ylabel="power [W]", yscale="log")
        column[1].set_yticks(ticks := (50, 100, 200, 400, 800), ticks)
        column[1].minorticks_off()
        column[2].set(yscale="log", ylabel="EIPO's last 1 / alpha [1/W]", xlabel="lambda [1/W]")
        column[2].axline((1e-4, 1e-4), (1e-2, 1e-2), color="black", linestyle=":", linewidth=0.8)
    explain(figure)
    return rows, figure
