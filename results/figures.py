"""The paper's Figures 2 to 6 and Table I, from kept episodes.

Each figure is a function of Runs that returns the rows of its CSV and the picture. Numbers are
means, or in Table I interquartile means (but for J/m), with two 95 % bootstrap intervals. One
resamples the episodes of all seeds, as the paper does. The other resamples the seeds, and so shows
how much trainings differ. With two or three seeds it reaches from the lowest seed to the highest,
which is less than 95 %.
"""

import re
from itertools import cycle

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

import evaluate
from results import tables
from results.tables import KINDS, LAMBDAS, by_group, score_of, task_of
from runtime.cli import Refused

PEAKS = 2.86, 2.12, 1.55, 1.49, 1.58, 1.64, 1.58, 1.62, 1.45, 1.37
TABLE1 = dict(zip(KINDS, PEAKS, strict=True))  # m/s, as printed in Table I
HARDWARE = {"EIPO": 2.5, "PPO(0.01)": 1.5}  # m/s, peaks of the real robot, Section VI (D37)
# a number of a CSV, its interval over episodes, and that over seeds
ENDS = "", "_low", "_high", "_seeds_low", "_seeds_high"
BOTTOM = dict(flat=1.2, rough=0.8)  # of the score's axis, which leaves out runs that stand
LABELS = dict(
    performance="task performance", energy="energy [J/m]", power="power [W]", peak="peak [m/s]"
)


# ---- what the figures share ----


def style(name):
    """Colour and marker of a kind of run in every figure but that of `weights`.

    EIPO is blue, PPO yellow to brown by lambda, in five shades that one can tell apart: of 0, up to
    0.0005, 0.002, 0.005 and more. Each lambda and lambda_0 has its marker. Lines of runs with other
    settings are dashed.
    """
    lam = re.search(r"(?:PPO\(|from )([^ ,)]+)", name)
    lam = float(lam[1]) if lam else -1  # EIPO from its usual lambda_0
    shade = sum(x < lam for x in (0, 5e-4, 2e-3, 5e-3))
    color = colormaps["YlOrBr"]((0.3, 0.45, 0.6, 0.78, 1.0)[shade])
    color = "#0072B2" if name.startswith("EIPO") else color
    look = dict(color=color, marker="Dos^v<>pPX"[sum(x <= lam for x in LAMBDAS)])
    return look | dict(linestyle="--" if re.search(", |smooth|shaped", name) else "-")


def summarise(name, by_seed, statistic=np.mean):
    """Columns of a CSV: a statistic, and its intervals over episodes and over seeds.

    by_seed:   one array per seed, (episodes,), or (k, episodes) for a statistic of k numbers of an
               episode
    statistic: of k arrays (..., episodes), with an argument axis, as np.mean
    """
    by_seed = [np.atleast_2d(x) for x in by_seed]

    def of_seeds(drawn):
        return statistic(*np.hstack([by_seed[i] for i in drawn]), axis=-1)

    seeds = np.arange(len(by_seed))
    over_episodes = evaluate.interval(np.hstack(by_seed), statistic, batch=100)
    over_seeds = evaluate.interval([seeds], of_seeds, vectorized=False)
    numbers = float(of_seeds(seeds)), *over_episodes, *over_seeds
    return dict(zip([name + end for end in ENDS], numbers, strict=True))


def by_command(group, kinds, commands, columns, statistic=np.mean):
    """Rows of a CSV: for each kind of run and each command (n, 3), a statistic of some columns of
    Episodes from random starts, with its intervals. "energy" is energy per metre.

    group, kinds: of `tables.by_group`
    """
    rows = []
    for name, arm in kinds.items():
        for command in commands:
            each = [
                tables.where(np.isclose([e[x] for x in tables.ASKED], command[:, None]).all(0), e)
                for e in (tables.evaluation(run.episodes) for run in arm)
            ]
            n = min(len(e["fell"]) for e in each)  # so that every seed counts as much
            each = [{column: x[:n] for column, x in e.items()} for e in each]
            row = dict(group=group, run=name, v_x_asked=command[0], yaw_asked=command[2])
            row |= dict(seeds=len(arm), episodes=n, fell=np.mean([e["fell"] for e in each]))
            for column in columns:
                names = ("power", "v_x") if column == "energy" else (column,)
                of = evaluate.energy_per_metre if column == "energy" else statistic
                row |= summarise(column, [[e[x] for x in names] for e in each], of)
            rows.append(row)
    return rows


def one_group(runs, task):
    """The name and the kinds of the one group of a task. Refused if its runs have several lengths,
    since these figures have one panel.
    """
    groups = by_group(runs, task)
    if len(groups) > 1:
        raise Refused(f"these runs have several lengths, so take some: {'; '.join(groups)}")
    (found,) = groups.items()
    return found


def panels_by(column, rows, num_panels):
    """A Figure with panels one above the other for each group of rows.

    Returns the Figure and [(value of the column, the rows that have it, their Axes), ...].
    """
    groups = tables.grouped(rows, column)
    figure = Figure(figsize=(4 * len(groups), 3 * num_panels + 1.5), layout="constrained")
    panels = figure.subplots(num_panels, len(groups), squeeze=False, sharex="col").T
    for name, (top, *_) in zip(groups, panels, strict=True):
        top.set_title(name.replace(" at ", "\nat "), fontsize=10)
    return figure, list(zip(groups, groups.values(), panels, strict=True))


def log_axis(axes):
    """Make y logarithmic, with ticks at 1, 2, 5, 10, ..., unless there is nothing to show on it."""
    if not axes.dataLim.y1 > 0:
        return
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_locator(NullLocator())


# ---- over commands ----


def draw_lines(axes, rows, column):
    """Draw each kind of run over the command v_x: its mean, its interval over episodes and,
    lighter, over seeds. What is infinite is left out.
    """
    for name, mine in tables.grouped(rows, "run").items():
        names = "v_x_asked", *(column + end for end in ENDS)
        numbers = np.array([[row[x] for row in mine] for x in names])
        at, mean, *bands = np.where(np.isfinite(numbers), numbers, np.nan)
        look = style(name)
        axes.plot(at, mean, markersize=4, label=f"{name}, n = {mine[0]['seeds']}", **look)
        axes.fill_between(at, *bands[:2], color=look["color"], alpha=0.2, linewidth=0)
        axes.fill_between(at, *bands[2:], color=look["color"], alpha=0.1, linewidth=0)
    axes.grid(alpha=0.3)


def over_commands(runs, tasks, columns):
    """Rows and a Figure of some columns by command, a panel for each group of runs and column."""
    rows = []
    for group, kinds in by_group(runs, *tasks).items():
        rows += by_command(group, kinds, evaluate.commands_of(task_of(group)), columns)
    figure, panels = panels_by("group", rows, len(columns))
    for group, mine, all_axes in panels:
        for axes, column in zip(all_axes, columns, strict=True):
            draw_lines(axes, mine, column)
            axes.set(xlabel="command v_x [m/s]", ylabel=LABELS[column], xlim=(0, 1))
        if (bottom := BOTTOM[task_of(group)]) < all_axes[0].get_ylim()[1]:  # do any of them walk?
            all_axes[0].set_ylim(bottom=bottom)
        if "energy" in columns:  # a robot that is asked to stand spends much per metre
            log_axis(all_axes[1])
        place = dict(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2, fontsize=7)
        all_axes[-1].legend(*all_axes[0].get_legend_handles_labels(), **place)
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


def outline(axes, mesh, inside):
    """Draw the border of some cells of a mesh; inside: (rows, columns) bool, which they are."""
    x, y = mesh.get_coordinates()[0, :, 0], mesh.get_coordinates()[:, 0, 1]
    padded = np.pad(inside, 1)
    look = dict(colors="#D55E00", linewidth=2, capstyle="projecting", clip_on=False)
    i, j = np.nonzero(padded[1:-1, 1:] != padded[1:-1, :-1])
    axes.vlines(x[j], y[i], y[i + 1], **look)
    i, j = np.nonzero(padded[1:, 1:-1] != padded[:-1, 1:-1])
    axes.hlines(y[i], x[j], x[j + 1], **look)


def fig5(runs):
    """Task performance and power over commands of v_x and yaw rate. Section V-E.

    Of each seed a line goes around the commands that its grid had reached when training ended, if
    the tables say it. What is outside was asked and never trained.
    """
    group, kinds = one_group(runs, "curriculum")
    rows = by_command(group, kinds, tables.GRID, ("performance", "power"))
    figure, panels = panels_by("run", rows, 2)
    v_x, yaw = tables.GRID[::11, 0], tables.GRID[:11, 2]
    for i, column in enumerate(("performance", "power")):
        values = np.array([row[column] for row in rows]).reshape(-1, 11, 11)
        line = [all_axes[i] for _, _, all_axes in panels]
        for axes, value, arm in zip(line, values, kinds.values(), strict=True):
            image = axes.pcolormesh(yaw, v_x, value, vmin=values.min(), vmax=values.max())
            for cells in (run.reached for run in arm if run.reached):
                inside = tables.inside(tables.GRID[:, 0], tables.GRID[:, 2], cells)
                outline(axes, image, inside.reshape(11, 11))
        figure.colorbar(image, ax=line, label=LABELS[column])
    figure.supxlabel("command yaw rate [rad/s]")
    figure.supylabel("command v_x [m/s]")
    return rows, figure


# ---- velocity ----


def fig6(runs):
    """Speed over time on velocity, of the robots that have not fallen. Section VI.

    A line is a seed, and a thick one the mean of a kind. Dotted lines are the peaks of the paper's
    robot (D37).
    """
    rows = []
    figure = Figure(figsize=(6.5, 3.6), layout="constrained")
    axes = figure.subplots()
    group, kinds = one_group([run for run in runs if run.speed], "velocity")
    for name, arm in kinds.items():
        time = arm[0].speed["time"]
        speeds = {run.name: run.speed["v_x"] for run in arm}
        mean = np.mean(list(speeds.values()), 0)
        color = style(name)["color"]
        for seed, v_x in (speeds | dict(mean=mean)).items():
            axes.plot(time, v_x, color=color, linewidth=0.6, alpha=0.5)
            about = dict(group=group, kind=name, run=seed)
            rows += [about | dict(time=t, v_x=v) for t, v in zip(time, v_x, strict=True)]
        axes.plot(time, mean, color=color, linewidth=2, label=f"{name}, n = {len(arm)}")
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
    group, kinds = one_group(runs, "velocity")
    rows = by_command(group, kinds, np.zeros((1, 3)), columns, evaluate.iqm)
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


# ---- what alpha does ----


def tradeoff(runs):
    """Power over the score, a small dot for each run and a large one for each kind.

    Hollow dots are the pi_prime of the same runs, and dashed ones have other settings. The score is
    task performance, on velocity the peak.
    """
    rows = []
    groups = by_group(runs)
    one_task = len(set(map(task_of, groups))) == 1
    figure = Figure(figsize=(4.5 * len(groups), 5.5), layout="constrained")
    panels = figure.subplots(1, len(groups), squeeze=False, sharex=one_task, sharey=one_task)[0]
    for (group, kinds), axes in zip(groups.items(), panels, strict=True):
        score = score_of(group)
        for name, arm in tables.with_primes(kinds).items():
            look = style(name.removeprefix("pi' of "))
            look["edgecolors"] = look.pop("color")
            look["facecolors"] = "none" if name.startswith("pi'") else look["edgecolors"]
            each, _ = tables.means(arm)
            x, y = each[score], each["power"]
            axes.scatter(x, y, 12, alpha=0.6, linewidths=0.5, **look)
            axes.scatter(x.mean(), y.mean(), 60, label=f"{name}, n = {len(arm)}", **look)
            about = dict(group=group, kind=name)
            rows += [
                about | dict(run=run.name, score=a, power=b)
                for run, a, b in zip(arm, x, y, strict=True)
            ]
        low, high = axes.get_xlim()
        if low < BOTTOM.get(task_of(group), np.inf) < high:  # runs that stand are left of it
            axes.set_xlim(left=BOTTOM[task_of(group)])
        axes.set(xlabel=LABELS[score], ylabel=LABELS["power"], title=group)
        log_axis(axes)
        axes.grid(alpha=0.3)
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2, fontsize=7)
    return rows, figure


def alpha(runs):
    """alpha over iterations, a line for each run of EIPO, dashed for each kind in another way.
    Dotted lines are 1 / lambda of each kind of PPO, with what it scores and draws: at such an alpha
    pi has the same objective.
    """
    rows = []
    groups = by_group(runs)
    figure = Figure(figsize=(4.5 * len(groups), 3.8), layout="constrained")
    panels = figure.subplots(1, len(groups), squeeze=False, sharey=True)[0]
    for (group, kinds), axes in zip(groups.items(), panels, strict=True):
        dashes = cycle(("-", "--", "-.", (0, (6, 1, 1, 1, 1, 1)), (0, (9, 3)), (0, (2, 1))))
        for name, arm in kinds.items():
            algo, lam = (arm[0].settings[x] for x in ("algo", "lam"))
            if algo == "ppo" and lam > 0:
                mean = tables.means(arm)[1]
                label = f" {name}:\n {mean[score_of(group)]:.2f} on {mean['power']:.0f} W"
                axes.axhline(1 / lam, color="black", linestyle=":", linewidth=1)
                at = dict(xycoords=("axes fraction", "data"), va="center")
                axes.annotate(label, (1, 1 / lam), fontsize=7, **at)
            if algo == "ppo":
                continue
            look = dict(color=style(name)["color"], linewidth=1, linestyle=next(dashes))
            for run in arm:
                x, y = (run.metrics[key] for key in ("iteration", "alpha"))
                axes.plot(x, y, label=name if run is arm[0] else None, **look)
                about = dict(group=group, kind=name, run=run.name)
                rows += [about | dict(iteration=i, alpha=a) for i, a in zip(x, y, strict=True)]
        axes.set(xlabel="iteration", ylabel="alpha", title=group)
        if len(axes.get_legend_handles_labels()[1]) > 1:
            axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), fontsize=7)
        log_axis(axes)
        axes.grid(alpha=0.3)
    if not rows:
        raise Refused("none of these runs is of EIPO, which alone has an alpha")
    return rows, figure
