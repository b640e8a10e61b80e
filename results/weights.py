"""Does anybody have to choose lambda? PPO at every weight, EIPO from several lambda_0.

`weights` draws it, and `answers` has it as tables, by section 10 of audit/rules.md.
"""

import re
from itertools import cycle
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from matplotlib.ticker import NullLocator
from scipy import stats

import evaluate
from results import tables
from results.figures import LABELS, log_axis, panels_by
from results.tables import LAMBDAS, MARGINS, by_group, score_of

WALKS = 0.25  # m/s, mean speed ahead above which an arm or a run counts as walking, by section 10
BROWN = "#8C510A"
COLOURS = "#0072B2", "#00B0C8", "#E754B0", "#009E73", "#7A5195"  # of EIPO, by its lambda_0
OTHERS = "#C00000", "#FF7F0E", "#404040"  # of EIPO with other settings, by these


def is_ppo(kind):
    """Whether a kind of run is PPO(lambda), at any lambda, with the paper's reward and settings."""
    return kind.startswith("PPO(") and kind.endswith(")")


def is_eipo(kind):
    """Whether a kind of run is EIPO, from any lambda_0."""
    return kind.startswith("EIPO")


def last_lam(run):
    """lambda at the end of a run, which for EIPO is 1 / alpha, of alpha's mean over the last
    hundred iterations.
    """
    if run.settings["algo"] == "ppo":
        return run.settings["lam"]
    iteration, alpha = (run.metrics[name] for name in ("iteration", "alpha"))
    alpha = alpha[iteration > iteration[-1] - 100].mean()
    return 1 / alpha if alpha > 0 else np.inf


# ---- the figure ----


def weights(runs):
    """Score and power over lambda: rows of a CSV and a Figure, with a panel for each group of runs.

    A dot is a run of PPO, open if it does not walk. An arrow is a run of EIPO, from lambda_0 to its
    last lambda. In the grey band PPO scores as well as with the best weight, within the margin.
    """
    rows = []
    for group, kinds in by_group(runs).items():
        for name, arm in kinds.items():
            each, _ = tables.means(arm)
            columns = each[score_of(group)], each["power"], each["J/m"], each["v_x"]
            for run, score, power, energy, v_x in zip(arm, *columns, strict=True):
                row = dict(group=group, kind=name, run=run.name, lam=run.settings["lam"])
                row |= dict(lam_end=last_lam(run), score=score, power=power, energy=energy, v_x=v_x)
                rows.append(row)
    figure, panels = panels_by("group", rows, 2)
    # one start, or one setting, has one colour in all panels
    parts = dict.fromkeys(part(label(row)) for row in rows if is_eipo(row["kind"]))
    cycles = {True: cycle(COLOURS), False: cycle(OTHERS)}
    colours = {name: next(cycles[is_eipo(name)]) for name in parts}
    above = [x for row in rows for x in (row["lam"], row["lam_end"]) if x > 0]
    zero = min([*above, LAMBDAS[1]]) / 3  # where 0 stands on an axis that is logarithmic
    for _, _, (_, bottom) in panels[1:]:
        bottom.sharey(panels[0][2][1])  # a watt is a watt on any ground
    for group, mine, (top, bottom) in panels:
        means = draw(top, mine, "score", zero, colours)
        if means:
            best = max(means.values())
            low = best - MARGINS[score_of(group)]
            top.axhspan(low, best, color="black", alpha=0.1, linewidth=0)
        walking = [row["score"] for row in mine if row["v_x"] > WALKS]
        if 0 < len(walking) < len(mine):  # robots that stand are below
            top.set_ylim(bottom=min(walking) - 3 * MARGINS[score_of(group)])
        draw(bottom, mine, "power", zero, colours)
        top.set_ylabel(LABELS[score_of(group)])
        bottom.set(ylabel=LABELS["power"], xlabel="lambda (of EIPO from start to end)")
        log_axis(bottom)
        bottom.set_xscale("log")
        ticks = [f"{lam:g}" for lam in LAMBDAS]
        bottom.set_xticks([lam or zero for lam in LAMBDAS], ticks, fontsize=6, rotation=45)
        bottom.xaxis.set_minor_locator(NullLocator())
        bottom.legend(loc="upper center", bbox_to_anchor=(0.5, -0.3), ncols=2, fontsize=7)
    return rows, figure


def label(row):
    """What the figure calls a kind of EIPO: the paper's lambda_0 is said, too."""
    return re.sub("^EIPO(?=,|$)", f"EIPO from {row['lam']:g}", row["kind"])


def part(name):
    """What gives a kind of EIPO its colour: its other settings, or else its start."""
    start, _, settings = name.partition(", ")
    return settings or start


def draw(axes, rows, column, zero, colours):
    """Draw a column of the rows of one group over lambda, with 0 at `zero`, since its axis is
    logarithmic. Returns the means of PPO over its seeds, {lambda: mean}.

    colours: {`part` of the label of a kind of EIPO: colour}
    """
    ppo = [row for row in rows if is_ppo(row["kind"])]
    by_lam = sorted(tables.grouped(ppo, "lam").items())
    means = {lam: np.mean([row[column] for row in mine]) for lam, mine in by_lam}
    line = sorted({*LAMBDAS, *means})  # it has a gap where a weight was not run
    y = [means.get(lam, np.nan) for lam in line]
    axes.plot([lam or zero for lam in line], y, color=BROWN, linewidth=1)
    for name, face, stands in (("PPO", BROWN, False), ("PPO that does not walk", "white", True)):
        dots = [row for row in ppo if (row["v_x"] <= WALKS) == stands]
        at, y = [row["lam"] or zero for row in dots], [row[column] for row in dots]
        axes.plot(at, y, "o", color=BROWN, markerfacecolor=face, markersize=4, label=name)
    eipo = [row for row in rows if is_eipo(row["kind"])]
    for mine in tables.grouped(sorted(eipo, key=itemgetter("lam")), "kind").values():
        name = label(mine[0])
        for i, row in enumerate(mine):
            start, end = row["lam"], min(row["lam_end"], 10 * max(LAMBDAS))
            colour, y = dict(color=colours[part(name)]), row[column]
            shaft = dict(marker="|", markevery=[0], linewidth=1, alpha=0.5, **colour)
            axes.plot([start, end], [y, y], **shaft, label="" if i else name)
            axes.plot([end], [y], ">" if end > start else "<", markersize=6, **colour)
    axes.grid(alpha=0.3)
    return means


# ---- the tables ----


class Spread(NamedTuple):
    """How much seeds of one arm differ, pooled over several arms."""

    s: float  # standard deviation
    df: int  # degrees of freedom

    def between(self, x, y):
        """The mean of x (seeds,) less that of y, and its 95 % interval: infinite if df is 0."""
        difference, half = x.mean() - y.mean(), np.inf
        if self.df:
            half = stats.t.ppf(0.975, self.df) * self.s * np.sqrt(1 / len(x) + 1 / len(y))
        return difference, difference - half, difference + half


def spread(arms):
    """The Spread of arms, each the numbers (seeds,) of its runs."""
    df = sum(len(x) - 1 for x in arms)
    squares = sum(((x - x.mean()) ** 2).sum() for x in arms)
    return Spread(np.sqrt(squares / df) if df else np.nan, df)


def answers(runs):
    """Yields tables in Markdown, for each group of runs with PPO, of both kinds of start. A group
    without PPO has one line instead.

    Where some runs of an arm walk and others stand, the same follows without the latter, as a
    description: they make the spread large, which the rules take to be alike in all arms.
    """
    for group, kinds in by_group(runs).items():
        if not any(is_ppo(kind) for kind in kinds):
            yield f"{group}: without runs of PPO there is nothing to compare with."
            yield ""
            continue
        walking = that_walk(kinds)
        versions = {group: kinds}
        if any(len(walking[kind]) < len(kinds[kind]) for kind in kinds):
            versions |= {f"{group}, runs that walk": walking}
        for name, some in versions.items():
            for nominal in (False, True):
                yield from answers_of(name, some, nominal)
        yield f"Commits: {', '.join(sorted(tables.commits(kinds)))}."
        yield ""


def that_walk(kinds):
    """Kinds of runs, and of an arm in which some run walks those that do."""

    def walks(run):
        return evaluate.numbers(tables.evaluation(run.episodes))["v_x"] > WALKS

    return {kind: [run for run in arm if walks(run)] or arm for kind, arm in kinds.items()}


def answers_of(group, kinds, nominal):
    """The table of one group, from random starts or from nominal ones, and after it the kinds with
    other settings beside the same without. Power is a geometric mean.
    """
    arms = pooled(kinds, score_of(group), nominal)
    margin = MARGINS[score_of(group)]
    ppo = [kind for kind in kinds if is_ppo(kind)]
    best = max(ppo, key=lambda kind: arms.score[kind].mean())
    good = [kind for kind in ppo if arms.score[kind].mean() > arms.score[best].mean() - margin]
    least = min(good, key=lambda kind: arms.power[kind].mean())
    lams = [kinds[kind][0].settings["lam"] for kind in good]
    starts = "nominal starts" if nominal else "random starts"
    columns = f"less {best}", "", "geometric power", f"of {least}"
    columns = *columns, "last lambda is good", "less PPO(0.005)"
    yield f"| {' | '.join((f'{group}, {starts}', 'score', *columns, 'seeds'))} |"
    yield "|---" * 9 + "|"
    for kind, arm in kinds.items():
        difference = arms.less(kind, best)
        less, word = shown(difference), goodness(difference, margin)
        if kind == best:
            less, word = "", "best"
        ratio = arrived = other = ""
        if is_eipo(kind):
            word = {"surely good": "no worse", "surely not": "worse"}.get(word, "open")
            ratio = shown(arms.times(kind, least), "")
            arrived = f"{sum(arrives(last_lam(run), lams) for run in arm)} of {len(arm)}"
        if not is_ppo(kind) and "PPO(0.005)" in kinds:
            other = shown(arms.less(kind, "PPO(0.005)"))
        cells = f"{arms.score[kind].mean():.3f}", less, word
        cells += f"{np.exp(arms.power[kind].mean()):.0f} W", ratio, arrived, other, str(len(arm))
        yield f"| {kind} | {' | '.join(cells)} |"
    yield ""
    for kind in kinds:
        plain = kind.split(",")[0]
        if plain != kind and plain in kinds:
            less, ratio = shown(arms.less(kind, plain)), shown(arms.times(kind, plain), "")
            yield f"{kind}, scores {less} beside {plain}, on {ratio} times the power."
            yield ""


class Pooled(NamedTuple):
    """The kinds of one group: what their seeds have, and how much seeds differ."""

    score: dict  # {kind: (seeds,)}
    power: dict  # {kind: (seeds,)}, its logarithm
    of_score: Spread
    of_power: Spread

    def less(self, kind, other):
        """The score of one kind less that of another, and its interval."""
        return self.of_score.between(self.score[kind], self.score[other])

    def times(self, kind, other):
        """The power of one kind as a ratio to that of another, and its interval."""
        return np.exp(self.of_power.between(self.power[kind], self.power[other]))


def pooled(kinds, name, nominal):
    """The Pooled of the kinds of one group, whose score is one of evaluate.numbers. The Spreads are
    over the arms that walk.
    """
    score, power, walking = {}, {}, []
    for kind, arm in kinds.items():
        played = [evaluate.numbers(tables.evaluation(run.episodes, nominal)) for run in arm]
        score[kind] = np.array([x[name] for x in played])
        power[kind] = np.log([x["power"] for x in played])
        walks = np.mean([x["v_x"] for x in played]) > WALKS
        plain = is_ppo(kind) or (is_eipo(kind) and "," not in kind)
        if walks and plain:  # what has other settings is no arm
            walking.append(kind)
    return Pooled(score, power, *(spread([x[kind] for kind in walking]) for x in (score, power)))


def goodness(difference, margin):
    """Whether a difference to the best is above minus the margin, and surely if its interval is."""
    mean, low, high = difference
    if low > -margin or high < -margin:
        return "surely good" if low > -margin else "surely not"
    return "good" if mean > -margin else "not good"


def arrives(lam, good):
    """Whether lambda is among good weights, give or take a factor of 2."""
    above = [x for x in good if x > 0]
    return bool(above) and min(above) / 2 <= lam <= max(above) * 2


def shown(ends, sign="+"):
    """A difference or a ratio as text, with its interval unless that is infinite."""
    mean, low, high = (f"{x:{sign}.{3 if sign else 2}f}" for x in ends)
    return f"{mean} [{low}, {high}]" if np.isfinite(ends[2]) else mean
