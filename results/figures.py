"""The paper's Figures 2 to 6 and Table I, and three pictures of ours, from the runs that are kept.

Each is a function of Runs that returns the rows of its CSV and the picture. Thin lines and small
dots are seeds, thick and large ones their means.
"""

from itertools import cycle

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator
from scipy import stats

import evaluate
from results.paper import FAST, MARGINS, SWEEP, TABLE1
from results.runs import by_group, inside, with_primes
from runtime.cli import Refused
from tasks import LAMBDAS

HARDWARE = {"EIPO": 2.5, "PPO(0.01)": 1.5}  # m/s, peaks of the real robot, Section VI (D37)
LABELS = dict(score="score", energy="energy [J/m]", power="power [W]", peak="peak [m/s]")
BLUE, BROWN, GREEN, RED = "#0072B2", "#8C510A", "#009E73", "#C00000"


def measure_of(group):
    """Which of evaluate.numbers says how well the task of a group is done."""
    return "peak" if group.task == "velocity" else "score"


def style(kind):
    """Colour, marker and line of a kind of run in every figure.

    EIPO is blue, PPO yellow to brown by lambda, in five shades that one can tell apart: of 0, up to
    0.0005, 0.002, 0.005 and more. Each lambda has its marker, and other settings a dashed line.
    """
    shade = sum(kind.lam > x for x in (0, 5e-4, 2e-3, 5e-3))
    color = colormaps["YlOrBr"]((0.3, 0.45, 0.6, 0.78, 1.0)[shade])
    marker = "os^v<>pPX"[sum(kind.lam >= x for x in LAMBDAS[1:])]
    line = "-" if kind.is_plain else "--"
    return dict(color=BLUE if kind.algo == "eipo" else color, marker=marker, linestyle=line)


def panels_of(names, num_rows, width=4.0, height=3.0, sharex="col", **options):
    """A Figure with a column of panels for each name: (Figure, [(name, (Axes, ...)), ...]).

    width, height: [inch] of a panel
    """
    size = max(5.0, width * len(names)), height * num_rows + 1.0
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(num_rows, len(names), squeeze=False, sharex=sharex, **options).T
    for name, (top, *_) in zip(names, panels, strict=True):
        top.set_title(str(name).replace(", ", ",\n"), fontsize=10)
    return figure, list(zip(names, panels, strict=True))


def log_axis(*panels):
    """Make y of panels logarithmic, with ticks at 1, 2, 5, 10, ..., if all in them is above 0."""
    if min(axes.dataLim.y0 for axes in panels) > 0:
        for axes in panels:
            axes.set_yscale("log")
            axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axes.yaxis.set_major_formatter("{x:g}")
            axes.yaxis.set_minor_locator(NullLocator())


def legend_below(figure):
    """One legend for all panels, below them, in as many columns as the figure has room for."""
    found = {}
    for axes in figure.axes:
        found |= {str(label): x for x, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    if found:
        width, height = figure.get_size_inches()
        columns = max(1, int(width / (0.06 * max(map(len, found)) + 0.5)))
        figure.set_size_inches(width, height + 0.16 * np.ceil(len(found) / columns))
        place = dict(loc="outside lower center", ncols=columns, fontsize=7)
        figure.legend(found.values(), found, **place)


# ---- over commands ----


def did(run, columns):
    """Columns of what pi did, by command; "energy" [J/m] is power over speed."""
    energy = evaluate.energy_per_metre(run.did["power"][:, None], run.did["v_x"][:, None])
    return {name: energy if name == "energy" else run.did[name] for name in columns}


def rows_of(group, kind, run, columns):
    """Rows of a CSV, for each command: what pi of a Run did."""
    about = dict(group=group, kind=kind, run=run.name)
    asked = dict(v_x_asked=run.did["asked_v_x"], yaw_asked=run.did["asked_yaw"])
    table = asked | did(run, columns)
    return [about | dict(zip(table, row, strict=True)) for row in zip(*table.values(), strict=True)]


def over_commands(runs, tasks, columns):
    """Rows and a Figure of some columns by command, a panel for each group of runs and column."""
    groups, rows = by_group(runs, *tasks), []
    figure, panels = panels_of(groups, len(columns))
    for group, all_axes in panels:
        for kind, arm in groups[group].items():
            rows += [row for run in arm for row in rows_of(group, kind, run, columns)]
            for axes, column in zip(all_axes, columns, strict=True):
                x = arm[0].did["asked_v_x"]
                seeds = np.array([did(run, [column])[column] for run in arm])
                seeds = np.where(np.isfinite(seeds), seeds, np.nan)  # a robot that stands: inf J/m
                look = style(kind)
                thin = dict(color=look["color"], linestyle=look["linestyle"], linewidth=0.5)
                axes.plot(x, seeds.T, alpha=0.5, **thin)
                axes.plot(x, seeds.mean(0), markersize=4, label=str(kind), **look)
                axes.set(xlabel="command v_x [m/s]", ylabel=LABELS[column])
                axes.grid(alpha=0.3)
        if "energy" in columns:  # a robot that is asked to stand spends much per metre
            log_axis(all_axes[1])
    legend_below(figure)
    return rows, figure


def fig2(runs):
    """Score and J/m by command, flat ground. Section V-A."""
    return over_commands(runs, ["flat"], ("score", "energy"))


def fig3(runs):
    """The same on rough ground of 15 cm. Section V-B."""
    return over_commands(runs, ["rough"], ("score", "energy"))


def fig4(runs):
    """Score of every lambda on flat and rough ground. Section V-C."""
    return over_commands(runs, ["flat", "rough"], ("score",))


def outline(axes, mesh, mine):
    """Draw the border of some cells of a mesh; mine: (rows, columns) bool, which they are."""
    x, y = mesh.get_coordinates()[0, :, 0], mesh.get_coordinates()[:, 0, 1]
    padded = np.pad(mine, 1)
    look = dict(colors="#D55E00", linewidth=2, capstyle="projecting", clip_on=False)
    i, j = np.nonzero(padded[1:-1, 1:] != padded[1:-1, :-1])
    axes.vlines(x[j], y[i], y[i + 1], **look)
    i, j = np.nonzero(padded[1:, 1:-1] != padded[:-1, 1:-1])
    axes.hlines(y[i], x[j], x[j + 1], **look)


def fig5(runs):
    """Score and power over commands of v_x and yaw rate, means over seeds. Section V-E.

    A line goes around the commands that the grid of a seed had reached when training ended. What is
    outside was asked and never trained.
    """
    columns, rows = ("score", "power"), []
    (group, kinds), *others = by_group(runs, "curriculum").items()
    if others:
        raise Refused(
            "these runs have several lengths, and this figure shows one: name the runs of one"
        )
    figure, panels = panels_of(kinds, 2, sharey=True)
    for arm in kinds.values():
        rows += [row for run in arm for row in rows_of(group, run.kind, run, columns)]
    for i, column in enumerate(columns):
        means = [np.mean([run.did[column] for run in arm], 0) for arm in kinds.values()]
        for (_, axes), mean, arm in zip(panels, means, kinds.values(), strict=True):
            v_x, yaw = (np.unique(arm[0].did[x]) for x in ("asked_v_x", "asked_yaw"))
            shape = len(v_x), len(yaw)
            image = axes[i].pcolormesh(
                yaw, v_x, mean.reshape(shape), vmin=np.min(means), vmax=np.max(means)
            )
            for cells in (run.reached for run in arm if run.reached):
                reached = inside(arm[0].did["asked_v_x"], arm[0].did["asked_yaw"], cells)
                outline(axes[i], image, reached.reshape(shape))
        figure.colorbar(image, ax=[axes[i] for _, axes in panels], label=LABELS[column])
    figure.supxlabel("command yaw rate [rad/s]")
    figure.supylabel("command v_x [m/s]")
    return rows, figure


# ---- velocity ----


def fig6(runs):
    """Speed over time on velocity, of the robots that have not fallen. Section VI.

    Dotted lines are the peaks of the paper's robot (D37).
    """
    groups, rows = by_group(runs, "velocity"), []
    figure, panels = panels_of(groups, 1, sharey=True)
    for group, (axes,) in panels:
        for kind, arm in groups[group].items():
            time, look = arm[0].speed["time"], style(kind)
            seeds = np.array([run.speed["v_x"] for run in arm])
            axes.plot(time, seeds.T, **look | dict(marker="", linewidth=0.6, alpha=0.5))
            axes.plot(
                time, seeds.mean(0), linewidth=2, markevery=6, markersize=5, label=str(kind), **look
            )
            for run, v_x in zip(arm, seeds, strict=True):
                about = dict(group=group, kind=kind, run=run.name)
                rows += [about | dict(time=t, v_x=v) for t, v in zip(time, v_x, strict=True)]
        for name, peak in HARDWARE.items():
            axes.axhline(peak, color="black", linestyle=":", linewidth=1)
            place = dict(ha="right", va="bottom", fontsize=7)
            axes.text(time[-1], peak, f"{name}, the paper's robot", **place)
        axes.set(xlabel="time [s]", ylabel="speed ahead [m/s]")
        axes.grid(alpha=0.3)
    legend_below(figure)
    return rows, figure


def table1(runs):
    """Peak velocity of every lambda beside what the paper prints. Table I.

    A dot is the interquartile mean over the episodes of all seeds, with the paper's 95 % bootstrap
    interval over episodes (D26). A small one is that of a seed.
    """
    groups, rows = by_group(runs, "velocity"), []
    printed = dict(zip(FAST + SWEEP, TABLE1, strict=True))
    most = max(map(len, groups.values()))
    figure, panels = panels_of(groups, 1, width=6.0, height=0.45 * most, sharex=True)
    for group, (axes,) in panels:
        kinds = groups[group]
        for at, (kind, arm) in enumerate(kinds.items()):
            seeds = [run.episodes["peak"] for run in arm]
            if len(np.concatenate(seeds)) < 2:
                raise Refused(f"{kind} has one episode, and an interval needs more")
            low, high = stats.bootstrap(
                [np.concatenate(seeds)],
                evaluate.iqm,
                method="percentile",
                n_resamples=2000,
                batch=100,
                rng=np.random.default_rng(2024),
            ).confidence_interval
            mean = evaluate.iqm(np.concatenate(seeds))
            power = np.mean([run.numbers["power"] for run in arm])
            paper = printed.get(kind._replace(other=()), np.nan)
            row = dict(group=group, kind=kind, seeds=len(arm), peak=mean, low=low, high=high)
            rows.append(row | dict(power=power, paper=paper))
            axes.plot(list(map(evaluate.iqm, seeds)), [at] * len(arm), ".", color=BLUE, alpha=0.5)
            error = [[mean - low], [high - mean]]
            axes.errorbar(mean, at, xerr=error, fmt="o", color=BLUE, capsize=3)
            axes.plot(paper, at, "D", color="#D55E00", markerfacecolor="none")
        labels = [f"{kind}, n = {len(arm)}".replace(", ", ",\n") for kind, arm in kinds.items()]
        axes.set(yticks=range(len(kinds)), yticklabels=labels, ylim=(len(kinds) - 0.5, -0.5))
        axes.set_xlabel("peak velocity [m/s]")
        axes.grid(alpha=0.3)
    figure.suptitle("dots: ours; diamonds: the paper's", fontsize=8)
    return rows, figure


def strides(runs):
    """Peak velocity over strides a second, a dot for each run, and for each pi' an open one.

    Other settings than the usual ones have a black edge.
    """
    groups, rows = by_group(runs, "velocity"), []
    figure, panels = panels_of(groups, 1, sharex=True, sharey=True)
    for group, (axes,) in panels:
        for kind, arm in with_primes(groups[group]).items():
            x, y = ([run.did[name][0] for run in arm] for name in ("strides", "peak"))
            look = style(kind) | dict(linestyle="", markersize=5)
            look |= dict(markerfacecolor="none") if kind.prime else {}
            look |= {} if kind.is_plain else dict(markeredgecolor="black")
            axes.plot(x, y, label=str(kind), **look)
            for run, strides, peak in zip(arm, x, y, strict=True):
                about = dict(group=group, kind=kind, run=run.name)
                rows.append(about | dict(strides=strides, peak=peak))
        axes.set(xlabel="strides [1/s]", ylabel=LABELS["peak"])
        axes.grid(alpha=0.3)
    legend_below(figure)
    return rows, figure


# ---- what lambda and alpha do ----


def alpha(runs):
    """alpha over iterations, a line for each run of EIPO. Dotted lines are 1 / lambda of each
    weight of plain PPO, with what it scores and draws: at such an alpha pi has the same objective.
    """
    groups = by_group(runs)
    groups = {x: kinds for x, kinds in groups.items() if any(k.algo == "eipo" for k in kinds)}
    if not groups:
        raise Refused("none of these runs is of EIPO, which alone has an alpha")
    rows, colors = [], {}  # a kind has one colour in all panels
    palette = cycle((BLUE, GREEN, RED, BROWN, "black", "#7A5195"))
    figure, panels = panels_of(groups, 1, sharey=True)
    for group, (axes,) in panels:
        for kind, arm in groups[group].items():
            if kind.algo == "ppo" and kind.lam > 0 and kind.is_plain:
                score = np.mean([run.numbers[measure_of(group)] for run in arm])
                power = np.mean([run.numbers["power"] for run in arm])
                axes.axhline(1 / kind.lam, color="black", linestyle=":", linewidth=1)
                at = dict(xycoords=("axes fraction", "data"), va="center")
                label = f" {kind}:\n {score:.2f} on {power:.0f} W"
                axes.annotate(label, (1, 1 / kind.lam), fontsize=7, **at)
            if kind.algo == "eipo":
                color = colors.get(kind) or colors.setdefault(kind, next(palette))
                for run in arm:
                    x, y = run.learned["iteration"], run.learned["alpha"]
                    axes.plot(x, y, color=color, linewidth=1, label=str(kind))
                    about = dict(group=group, kind=kind, run=run.name)
                    rows += [about | dict(iteration=i, alpha=a) for i, a in zip(x, y, strict=True)]
        axes.set(xlabel="iteration", ylabel="alpha")
        axes.grid(alpha=0.3)
    log_axis(*figure.axes)
    legend_below(figure)
    return rows, figure


def weights(runs):
    """Score and power over lambda, with a column of panels for each group of runs.

    Dots are runs of PPO, open ones those that do not walk, and a line joins their means. An arrow
    is a run of EIPO, from the lambda with which it starts to the one at its end. In the grey band
    PPO scores as well as with the best weight, within the margin. Another reward or cost is left
    out, and PPO with other settings.
    """
    runs = [run for run in runs if (run.kind.aux, run.kind.reward) == ("energy", "paper")]
    runs = [run for run in runs if run.kind.algo == "eipo" or run.kind.is_plain]
    if not runs:
        raise Refused("none of these runs is of EIPO, or of PPO with the usual settings")
    groups, rows = by_group(runs), []
    others = dict.fromkeys(kind.other for kinds in groups.values() for kind in kinds if kind.other)
    colors = {(): BLUE} | dict(zip(others, cycle((RED, GREEN, "#7A5195", "black")), strict=False))
    figure, panels = panels_of(groups, 2)
    for group, all_axes in panels:
        measure = measure_of(group)
        for kind, arm in groups[group].items():
            for run in arm:
                row = dict(group=group, kind=kind, run=run.name, lam=kind.lam, lam_end=run.lam_end)
                x = run.numbers
                rows.append(row | dict(measure=x[measure], power=x["power"], walks=run.walks))
        mine, (top, low) = [row for row in rows if row["group"] == group], all_axes
        if means := draw_weights(top, mine, "measure", colors):
            best = max(means)
            top.axhspan(best - MARGINS[measure], best, color="black", alpha=0.1, linewidth=0)
        draw_weights(low, mine, "power", colors)
        log_axis(low)
        top.set_ylabel(LABELS[measure])
        low.set(ylabel=LABELS["power"], xlabel="lambda (of EIPO from start to end)")
    legend_below(figure)
    return rows, figure


def draw_weights(axes, rows, column, colors):
    """Draw a column of rows of `weights` over lambda; returns the means of PPO at each lambda.

    colors: {other settings of EIPO: its colour}
    """
    some = (x for row in rows for x in (row["lam"], row["lam_end"]) if x > 0)
    zero = min([LAMBDAS[1], *some]) / 3  # where 0 stands on an axis that is logarithmic
    fixed = [row for row in rows if row["kind"].algo == "ppo"]
    lams = sorted({row["lam"] for row in fixed})
    means = [np.mean([row[column] for row in fixed if row["lam"] == lam]) for lam in lams]
    axes.plot([lam or zero for lam in lams], means, color=BROWN, linewidth=1)
    for label, walks in (("PPO", True), ("PPO that does not walk", False)):
        dots = [row for row in fixed if row["walks"] == walks]
        if dots:
            at, y = [row["lam"] or zero for row in dots], [row[column] for row in dots]
            face = BROWN if walks else "white"
            axes.plot(at, y, "o", color=BROWN, mfc=face, markersize=4, label=label)
    for row in rows:
        kind = row["kind"]
        if kind.algo == "eipo":
            label = ", ".join(["EIPO", *kind.other])
            color = colors[kind.other]
            end = row["lam_end"] if np.isfinite(row["lam_end"]) else 10 * max(LAMBDAS)
            look = dict(color=color, arrowstyle="-|>", shrinkA=0, shrinkB=0)
            axes.annotate("", (end, row[column]), (row["lam"], row[column]), arrowprops=look)
            axes.plot(row["lam"], row[column], "|", color=color)
            axes.plot(end, row[column], ".", color=color, label=label)
    axes.set_xscale("log")
    ticks = [f"{lam:g}" for lam in LAMBDAS]
    axes.set_xticks([lam or zero for lam in LAMBDAS], ticks, fontsize=6, rotation=45)
    axes.xaxis.set_minor_locator(NullLocator())
    axes.grid(alpha=0.3)
    return means
