"""The promise of Eq. (3), by results/rules.md: a pi as good as the best pi', on the least energy.

Each pi is compared with the pi' of its own run. What says whether pi' was needed stands beside it:
pi' against PPO(0), and PPO(lambda) against PPO(0). `arms` is what `claims.counted` returns.
"""

import numpy as np
from matplotlib.figure import Figure

from lab import figures, record
from lab.claims import MARGINS, decide, numbers, paired, shown
from lab.kinds import style

# of the sentence about the promise
LAMBDA_0 = "EIPO", "EIPO from 0.0001", "EIPO from 0.01", "EIPO from 0.02"
SEARCHED = "PPO(0.002)", "PPO(0.005)", "PPO(0.01)"
TICKS = -0.5, -0.2, -0.1, -0.05, -0.03, 0, 0.03, 0.05  # of the figure


def rivals(kinds):
    """Yields (left, right), two kinds of runs, for every comparison of the promise on a task.

    Whether a kind lands is a matter of the first one: EIPO against its own pi', PPO against PPO(0).
    """
    for kind in sorted(kinds.keys() - {"PPO(0)"}):
        if kind.startswith("EIPO"):
            yield kind, f"pi' of {kind}"
            if kind == "EIPO":  # pi' knows no lambda_0, so from others the same seeds have the same
                yield f"pi' of {kind}", "PPO(0)"
            yield kind, "PPO(0)"
        elif kind.startswith("PPO"):
            yield kind, "PPO(0)"


def may_land(left, right):
    """Whether a comparison decides if the left side lands."""
    return left.startswith("PPO") or right.startswith("pi'")


def lands(no_worse, less):
    """Whether an arm lands, by the verdicts that its performance is no worse and its power less."""
    words = no_worse, less.split(",")[0]
    if "reversed" in words:
        return "fails"
    if "not tested" in words:
        return "not tested"
    return "holds" if words == ("holds", "holds") else "undecided"


def falls(runs):
    """The shares of falls of runs from random and from nominal starts, as text in percent."""
    rows = [record.scores(run) for run in runs]
    shares = ([row[name] for row in rows] for name in ("fell", "fell_nominal"))
    return " and ".join(f"{100 * np.mean(x):.1f}" for x in shares if x)


def sentence(landed, no_worse):
    """What becomes of "whatever lambda_0, EIPO lands where PPO lands only with a lambda that was
    searched for": carried, refuted, or undecided, and for want of what.

    landed: {kind: whether it lands}; no_worse: {kind: the verdict that EIPO is no worse than
    PPO(0)}
    """
    ppo = {landed.get(kind) for kind in SEARCHED}
    words = {f"{kind} lands": landed.get(kind) for kind in LAMBDA_0}
    words |= {f"{kind} is no worse than PPO(0)": no_worse.get(kind) for kind in LAMBDA_0}
    if {"fails", "reversed"} & {*words.values()} or ppo == {"holds"}:
        return "refuted"
    words |= {"one PPO lands": "holds" if "holds" in ppo else ""}
    words |= {"one PPO fails": "holds" if "fails" in ppo else ""}
    missing = [what for what, word in words.items() if word != "holds"]
    if not missing:
        return "carried"
    return f"undecided, because nobody can say yet that {', '.join(missing)}"


def promise_row(left, right, sides, tested, word):
    """A comparison as cells; tested: {name: what `decide` returns}; word: its verdict."""
    cells = [shown(x, name)[1] if x else why for name, (x, why) in tested.items()]
    if watts := tested["power"][0]:
        cells[1] += f", {shown(watts, 'power')[0]} W"
    rival = "its pi'" if right.startswith("pi'") else right
    what = f"{'pi of ' * left.startswith('EIPO')}{left} against {rival}"
    return what, str(len(sides[0])), *cells, *map(falls, sides), word


def promise_lines(arms):
    """Yields lines of Markdown: a table for each task, then the sentence and what it hides."""
    landed, no_worse = {}, {}
    for task, kinds in arms.items():
        claimed = {"performance": "no worse", "power": "<", "J/m": "<"}
        claimed |= {"peak": "no worse"} if task == "velocity" else {}
        if kinds:
            yield f"\n| {task} | seeds | {' | '.join(claimed)} | fell [%] | rival fell | verdict |"
            yield "|---" * (5 + len(claimed)) + "|"
        for left, right in rivals(kinds):
            sides = paired(kinds, left, right)
            tested = {name: decide(*sides, name, than) for name, than in claimed.items()}
            performance, power = tested["performance"][1], tested["power"][1]
            word = lands(performance, power) if may_land(left, right) else ""
            if task == "flat" and word:
                landed[left] = word
            elif task == "flat" and left.startswith("EIPO"):
                no_worse[left] = performance
                word = f"no worse: {performance}"
            word = "" if task == "velocity" else word  # alpha hardly moves there
            yield f"| {' | '.join(promise_row(left, right, sides, tested, word))} |"
    yield '\n"Whatever lambda_0, EIPO lands where PPO lands only with a lambda that was searched'
    yield f'for": {sentence(landed, no_worse)}.\n'
    yield "| power on flat ground | ratio |\n|---|---|"
    for rival in ("PPO(0.002)", "EIPO"):
        for kind in (kind for kind in LAMBDA_0 if kind != rival):
            compared, why = decide(*paired(arms["flat"], kind, rival), "power")
            yield f"| {kind} / {rival} | {shown(compared, 'power')[1] if compared else why} |"


# ---- the figure ----


def promise(arms):
    """Rows of all runs, and a Figure: difference of performance over ratio of power, a dot a run.

    On the left EIPO is compared with the pi_prime of its run, on the right all with PPO(0), a task
    in each row. Dotted is the margin.
    """
    tasks = [task for task, kinds in arms.items() if kinds]
    figure = Figure(figsize=(8, 4.5 * len(tasks)), layout="constrained")
    panels = figure.subplots(len(tasks), 2, squeeze=False, sharex=True, sharey="row")
    rows = []
    for task, (own, ppo) in zip(tasks, panels, strict=True):
        for left, right in rivals(arms[task]):
            if not left.startswith("pi'"):
                mine = differences(paired(arms[task], left, right))
                rows += [dict(task=task, kind=left, rival=right) | row for row in mine]
                dots(own if right.startswith("pi'") else ppo, left, mine)
        finish(own, task, "the pi' of its run")
        finish(ppo, task, "PPO(0)")
        own.set_ylabel("difference of task performance")
    return rows, figure


def differences(sides):
    """A row for each run of the left side, compared with that of its seed on the right."""
    performance, power = ([numbers(x, name) for x in sides] for name in ("performance", "power"))
    columns = sides[0], np.subtract(*performance), np.divide(*power)
    return [
        dict(run=run.name, performance_difference=difference, power_ratio=ratio)
        for run, difference, ratio in zip(*columns, strict=True)
    ]


def dots(axes, kind, rows):
    """A small dot for each run, and a large one for their mean, of ratios the geometric one."""
    x, y = np.transpose([(row["power_ratio"], row["performance_difference"]) for row in rows])
    look = style(kind)
    axes.scatter(x, y, 12, alpha=0.6, linewidths=0, **look)
    look |= dict(edgecolors="white", linewidths=0.5, label=f"{kind}, n = {len(rows)}")
    axes.scatter(np.exp(np.log(x).mean()), y.mean(), 50, **look)


def finish(axes, task, rival):
    """Give a panel its axes, and its lines of no difference."""
    if task != "velocity":
        axes.set_yscale("symlog", linthresh=0.05)  # runs that stand are far below the others
        ends = axes.get_ylim()
        axes.set_yticks(TICKS, [f"{x:+g}" if x else "0" for x in TICKS])
        axes.set_ylim(ends)
        axes.axhline(-MARGINS["performance"], color="black", linestyle=":")
    axes.axhline(0, color="black", linewidth=0.8)
    axes.axvline(1, color="black", linewidth=0.8)
    axes.set_title(f"{task}, against {rival}", fontsize=10)
    axes.set_xlabel("ratio of power")
    axes.tick_params(labelbottom=True)  # in each row
    axes.grid(alpha=0.3)
    figures.log_axis(axes, "x")
    figures.legend([axes])
