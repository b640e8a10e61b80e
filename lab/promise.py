"""The promise of Eq. (3), by the rules of results/rules.md: `python -m lab promise`.

pi is compared with the pi' of its own run, and what says whether pi' was needed stands beside it:
pi' against PPO(0), and PPO(lambda) against PPO(0). Runs count as for `python -m lab claims`.
"""

import numpy as np
from matplotlib.figure import Figure

from lab import claims, record, sweep

NAMES = "performance", "power", "J/m", "peak"
MARGIN = claims.MARGINS["performance"]
# the arms of the sentence
LAMBDA_0 = "EIPO", "EIPO from 0.0001", "EIPO from 0.01", "EIPO from 0.02"
SEARCHED = "PPO(0.002)", "PPO(0.005)", "PPO(0.01)"


def comparisons(arms):
    """Yields (task, kind, policy, rival) for every comparison; rival: "its pi'" or "PPO(0)".

    arms: of claims.counted
    """
    for task, kinds in arms.items():
        for kind in sorted(kinds.keys() - {"PPO(0)"}):
            yield task, kind, "pi", own_rival(kind)
            if kind.startswith("EIPO"):
                yield task, kind, "prime", "PPO(0)"
                yield task, kind, "pi", "PPO(0)"


def own_rival(kind):
    """The rival against which a kind of run lands or fails."""
    return "its pi'" if kind.startswith("EIPO") else "PPO(0)"


def sides(arms, task, kind, policy, rival):
    """The two sides of a comparison: ({seed: Run}, policy) each, of the seeds that both have."""
    left = arms[task][kind]
    right = left if rival == "its pi'" else arms[task].get("PPO(0)", {})
    common = sorted(left.keys() & right.keys())
    policies = policy, "prime" if rival == "its pi'" else "pi"
    return [
        ({seed: arm[seed] for seed in common}, of)
        for arm, of in zip((left, right), policies, strict=True)
    ]


def lands(performance, power):
    """Whether an arm lands, by the Comparisons of its performance and of its power."""
    if performance is None or power is None:
        return "not tested"
    low, high = performance.wide
    least, most = power.wide
    word = "holds" if low > -MARGIN and most < 0 else "undecided"
    return "fails" if high < -MARGIN or least > 0 else word


def test(left, right):
    """{name: (Comparison, or None and why not)} of two sides, by NAMES."""
    found = {}
    for name in NAMES:
        numbers = [claims.numbers(arm, name, policy=policy) for arm, policy in (left, right)]
        found[name] = claims.decide(*numbers, name, "similar")
    return found


def falls(side):
    """The shares of falls of a side from random and from nominal starts, as text in percent."""
    arm, policy = side
    if not arm:
        return ""
    shares = [
        100
        * np.mean([record.evaluation(run, policy, nominal)["fell"].mean() for run in arm.values()])
        for nominal in (False, True)
    ]
    return " and ".join(f"{x:.1f}" for x in shares)


def sentence(words, against):
    """What becomes of "whatever lambda_0, EIPO lands where PPO lands only with a lambda that was
    searched for": carried, refuted, or undecided by which arms.

    words: {kind: whether it lands}; against: {kind: 95 % interval of its performance less PPO(0)'s}
    """
    ppo = {words.get(kind) for kind in SEARCHED}
    worse = [kind for kind, (_, high) in against.items() if kind in LAMBDA_0 and high < -MARGIN]
    if "fails" in [words.get(kind) for kind in LAMBDA_0] or worse or ppo == {"holds"}:
        return "refuted"
    open_ = [kind for kind in LAMBDA_0 if words.get(kind) != "holds"]
    nowhere = -np.inf, np.inf
    for kind in LAMBDA_0:
        if against.get(kind, nowhere)[0] <= -MARGIN:
            open_.append(f"{kind} against PPO(0)")
    open_ += [f"PPO, of which none {word}" for word in ("holds", "fails") if word not in ppo]
    return f"undecided, by {', '.join(open_)}" if open_ else "carried"


def lines(arms):
    """Yields a line of Markdown for each comparison, then the sentence and what it hides."""
    yield f"| task | what | seeds | {' | '.join(NAMES)} | falls [%] | of the rival | lands |"
    yield "|---" * 10 + "|"
    words, against = {}, {}
    for comparison in comparisons(arms):
        task, kind, policy, rival = comparison
        both = sides(arms, *comparison)
        tested = test(*both)
        performance, power = (tested[name][0] for name in ("performance", "power"))
        word = ""
        if policy == "pi" and rival == own_rival(kind) and task != "velocity":
            word = lands(performance, power)
        if task == "flat" and word:
            words[kind] = word
        if task == "flat" and policy == "pi" and rival == "PPO(0)" and performance:
            against[kind] = performance.wide
        side = "pi' of " if policy == "prime" else "pi of " if kind.startswith("EIPO") else ""
        cells = [task, f"{side}{kind} against {rival}", str(len(both[0][0]))]
        cells += [claims.shown(x, name)[1] if x else why for name, (x, why) in tested.items()]
        if task != "velocity":
            cells[-1] = ""  # nobody asks for a peak there
        yield f"| {' | '.join([*cells, *map(falls, both), word])} |"
    yield '\n"Whatever lambda_0, EIPO lands where PPO lands only with a lambda that was searched'
    yield f'for": {sentence(words, against)}.\n'
    yield "| power on flat ground | ratio |\n|---|---|"
    power = {kind: claims.numbers(arm, "power") for kind, arm in arms["flat"].items()}
    for rival in ("PPO(0.002)", "EIPO"):
        for kind in (kind for kind in LAMBDA_0 if kind != rival):
            pair = power.get(kind, {}), power.get(rival, {})
            compared, word = claims.decide(*pair, "power", "similar")
            shown = claims.shown(compared, "power")[1] if compared else word
            yield f"| {kind} / {rival} | {shown} |"


def rows(arms):
    """A row for each run against its own rival, of one seed."""
    found = []
    for comparison in comparisons(arms):
        task, kind, policy, rival = comparison
        if policy == "prime" or rival != own_rival(kind):
            continue
        both = sides(arms, *comparison)
        columns = {
            name: [claims.numbers(arm, name, policy=of) for arm, of in both] for name in NAMES
        }
        for seed, run in both[0][0].items():
            row = dict(task=task, run=run.name, kind=kind, seed=seed)
            for name, (x, y) in columns.items():
                ratio = name in claims.RATIOS
                row[f"{name}_{'ratio' if ratio else 'difference'}"] = float(
                    x[seed] / y[seed] if ratio else x[seed] - y[seed]
                )
            for side, (arm, of) in zip(("", "_rival"), both, strict=True):
                row[f"falls{side}"] = falls(({seed: arm[seed]}, of))
            found.append(row)
    return found


def promise(arms):
    """Rows of all runs, and a Figure: difference of performance over ratio of power, a dot a run.

    EIPO is compared with the pi_prime of its run, and PPO with PPO(0). Dotted is the margin.
    """
    every = rows(arms)
    tasks = list(dict.fromkeys(row["task"] for row in every))
    if not tasks:
        raise ValueError("no run of these tables has a rival")
    figure = Figure(figsize=(5 * len(tasks), 4.2), layout="constrained")
    for axes, task in zip(figure.subplots(1, len(tasks), squeeze=False)[0], tasks, strict=True):
        kinds = dict.fromkeys(row["kind"] for row in every if row["task"] == task)
        for i, kind in enumerate(kinds):
            mine = [row for row in every if (row["task"], row["kind"]) == (task, kind)]
            at = [[row[x] for row in mine] for x in ("power_ratio", "performance_difference")]
            style = dict(color=sweep.color(kind), alpha=0.8, linewidths=0)
            style |= dict(marker="Dv^s<>"[i % 6] if kind.startswith("EIPO") else "o")
            axes.scatter(
                *at, 30, label=f"{kind} against {own_rival(kind)}, n = {len(mine)}", **style
            )
        axes.axhline(0, color="black", linewidth=0.8)
        axes.axvline(1, color="black", linewidth=0.8)
        if task != "velocity":
            axes.axhline(-MARGIN, color="black", linestyle=":", linewidth=0.8)
        axes.set(title=task, xlabel="ratio of power", ylabel="difference of task performance")
        axes.set_xscale("log")
        axes.set_xticks(ticks := (0.1, 0.2, 0.5, 1, 2), ticks)
        axes.minorticks_off()
        axes.grid(alpha=0.3)
        axes.legend(fontsize=7)
    return every, figure
