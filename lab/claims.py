"""The paper's claims by the rules of results/rules.md: `python -m lab claims` prints its rows.

A row compares two kinds of runs by one number of each seed, from kept episodes. Runs count whose
seed is one of the rules, and all of them must be of one commit.
"""

import numpy as np

from lab import record, sweep
from lab.figures import TABLE1
from lab.statistics import NUMBERS, compare, verdict

SEEDS = range(10, 18)  # of rules.md; runs of others were seen before it was written
TASKS = "flat", "rough", "velocity"
# A margin is of a difference, or of the logarithm of a ratio.
MARGINS = {"performance": 0.03, "peak": 0.37, "power": np.log(1.25), "J/m": np.log(1.25)}
DIGITS = {"performance": 4, "peak": 2, "power": 0, "J/m": 0}
RATIOS = "power", "J/m"
PPO = sweep.KINDS[1:]
ALL, EVERY = (0, 1), "every command"  # of v_x [m/s]: from, to; or each of them by itself
# the number in rules.md, the task, the statistic, the commands, left, right, what is claimed
CLAIMS = [
    (1, "flat", "performance", ALL, "EIPO", "PPO(0.005)", ">"),
    (2, "flat", "performance", ALL, "EIPO", "PPO(0)", ">"),
    (3, "flat", "performance", EVERY, "EIPO", "PPO(0.005)", ">"),
    (3, "flat", "performance", EVERY, "EIPO", "PPO(0)", ">"),
    (4, "flat", "J/m", ALL, "EIPO", "PPO(0)", "<"),
    (5, "flat", "J/m", ALL, "PPO(0.005)", "PPO(0)", "<"),
    (6, "flat", "J/m", ALL, "EIPO", "PPO(0.005)", ">"),
    (7, "flat", "J/m", (0.1, 0.5), "EIPO", "PPO(0.005)", ">"),
    (8, "flat", "J/m", (0.6, 1), "EIPO", "PPO(0.005)", "similar"),
    (9, "flat", "power", ALL, "EIPO", "PPO(0.005)", "similar"),
    (10, "rough", "performance", (0.5, 1), "EIPO", "PPO(0.005)", ">"),
    (11, "rough", "performance", EVERY, "EIPO", "PPO(0.005)", "no worse"),
    (12, "rough", "performance", EVERY, "EIPO", "PPO(0)", "no worse"),
    (13, "rough", "performance", ALL, "EIPO", "PPO(0.005)", ">"),
    (14, "rough", "performance", ALL, "EIPO", "PPO(0)", ">"),
    (15, "rough", "performance", ALL, "PPO(0.005)", "PPO(0)", ">"),
    (16, "rough", "J/m", ALL, "EIPO", "PPO(0.005)", "<"),
    (17, "rough", "J/m", ALL, "EIPO", "PPO(0)", "<"),
    (18, "rough", "power", ALL, "EIPO", "PPO(0.005)", "similar"),
    *((19, "flat", "performance", ALL, "EIPO", ppo, ">") for ppo in PPO),
    *((20, "flat", "performance", EVERY, "EIPO", ppo, ">") for ppo in PPO),
    *((21, "rough", "performance", (0, 0.3), "EIPO", ppo, "similar") for ppo in PPO),
    *((22, "rough", "performance", (0.4, 1), "EIPO", ppo, ">") for ppo in PPO),
    *((23, "velocity", "peak", ALL, "EIPO", ppo, ">") for ppo in PPO),
    *((24, "velocity", "peak", ALL, ppo, "PPO(0)", "<") for ppo in PPO[1:]),
    (25, "velocity", "power", ALL, "EIPO", "PPO(0)", "similar"),
]


def counted(results=record.RESULTS, commit=""):
    """The runs that count, by task and kind: {task: {kind: {seed: Run}}}.

    commit: how the commit begins, of which they are. Raises ValueError if they are of several.
    """
    places = [results / task for task in TASKS if (results / task / record.RUNS).exists()]
    runs = [run for run in record.runs(place / "*" for place in places) if run.episodes]
    runs = [run for run in runs if run.settings["seed"] in SEEDS]
    runs = [run for run in runs if run.row["commit"].startswith(commit)]
    if len(commits := {run.row["commit"] for run in runs}) > 1:
        raise ValueError(f"no comparison mixes commits: give one of {', '.join(sorted(commits))}")
    arms = {task: {} for task in TASKS}
    for run in runs:
        kinds = arms[run.settings["task"]]
        kinds.setdefault(sweep.kind(run.settings), {})[run.settings["seed"]] = run
    return arms


def numbers(arm, name, commands=ALL, policy="pi"):
    """One of NUMBERS of each seed: {seed: number}.

    arm: {seed: Run}; commands: (from, to) [m/s], the commands v_x that count
    """
    low, high = commands
    found = {}
    for seed, run in arm.items():
        e = record.evaluation(run, policy)
        mine = (e["asked_v_x"] > low - 0.01) & (e["asked_v_x"] < high + 0.01)
        if mine.any():
            found[seed] = NUMBERS[name]({column: x[mine] for column, x in e.items()})
    return found


def decide(left, right, name, claimed):
    """The Comparison of two arms {seed: number} and its verdict by the rules."""
    common = left.keys() & right.keys()
    if not np.isfinite([arm[seed] for arm in (left, right) for seed in common]).all():
        return None, "no verdict, a run stands"
    if (compared := compare(left, right, name in RATIOS)) is None:
        return None, "not tested"
    return compared, verdict(compared, claimed, MARGINS[name])


def at_every_command(left, right, name, claimed):
    """The verdict on a claim about each of the eleven commands, and where it is what."""
    words = []
    for v_x in np.arange(11) / 10:
        sides = (numbers(arm, name, (v_x, v_x)) for arm in (left, right))
        words.append(decide(*sides, name, claimed)[1].split(",")[0])
    counts = {word: words.count(word) for word in dict.fromkeys(words)}
    if "not tested" in counts:
        return "not tested"
    whole = "reversed" if "reversed" in counts else "undecided"
    whole = "holds" if counts == {"holds": 11} else whole
    return f"{whole} ({', '.join(f'{word} at {n}' for word, n in counts.items())})"


def shown(compared, name):
    """A Comparison as cells: means, difference and its interval, Welch's interval."""
    digits = DIGITS[name]
    means = " and ".join(f"{x:.{digits}f}" for x in compared.means)
    if name in RATIOS:
        center, *ends = np.exp([compared.difference, *compared.wide, *compared.welch])
        center, (low, high, *welch) = f"x {center:.2f}", (f"{x:.2f}" for x in ends)
    else:
        center, *ends = (
            f"{x:+.{digits}f}" for x in (compared.difference, *compared.wide, *compared.welch)
        )
        low, high, *welch = ends
    return means, f"{center} [{low}, {high}]", f"[{', '.join(welch)}]"


def printed(number, left, right, compared):
    """Whether the paper's own difference lies in our interval, where it prints one; as text."""
    if number not in (23, 24):
        return ""
    size = TABLE1[left][0] - TABLE1[right][0]
    inside = compared.wide[0] <= size <= compared.wide[1]
    return f"; the paper's {size:+.2f} is {'inside' if inside else 'outside'}"


def lines(arms):
    """Yields the rows of the claims as lines of Markdown; arms: of `counted`."""
    yield "| no. | what | claimed | seeds | means | difference [95 %] | Welch | verdict |"
    yield "|---" * 8 + "|"
    for number, task, name, commands, left, right, claimed in CLAIMS:
        sides = [arms[task].get(kind, {}) for kind in (left, right)]
        where = f", {commands}" if commands == EVERY else f", {commands[0]} to {commands[1]} m/s"
        where = "" if commands == ALL else where
        what = f"{task}, {name}{where}: {left} {'/' if name in RATIOS else '-'} {right}"
        cells = ["", "", "", ""]
        if commands == EVERY:
            word = at_every_command(*sides, name, claimed)
        else:
            sides = [numbers(arm, name, commands) for arm in sides]
            compared, word = decide(*sides, name, claimed)
            if compared:
                cells = [f"{compared.seeds}", *shown(compared, name)]
                word += printed(number, left, right, compared)
                least = compared.visible
                seen = f"x {np.exp(least):.2f}" if name in RATIOS else f"{least:.2g}"
                word = word.replace("undecided", f"undecided, would see {seen}")
        yield f"| {number} | {what} | {claimed} | {' | '.join(cells)} | {word} |"
    yield "\nRows 26 to 31 are not tested: no run of the curriculum counts."


def table(runs):
    """Yields a line of Markdown for each kind of run, from kept episodes: means over seeds.

    The score is the peak on velocity, and elsewhere task performance.
    """
    yield "| task | kind | seeds | score: mean; each seed | fell | from nominal | power | energy |"
    yield "|---" * 8 + "|"
    runs = [run for run in runs if run.episodes]
    for task in dict.fromkeys(run.settings["task"] for run in runs):
        score = NUMBERS["peak" if task == "velocity" else "performance"]
        for kind, seeds in sweep.by_kind(runs, task).items():
            random = [record.evaluation(run) for run in seeds]
            nominal = [record.evaluation(run, nominal=True) for run in seeds]
            each = [score(e) for e in random]
            shares = (100 * np.mean([e["fell"].mean() for e in x]) for x in (random, nominal))
            means = (np.mean([NUMBERS[name](e) for e in random]) for name in ("power", "J/m"))
            cells = [task, kind, str(len(seeds))]
            cells += [f"{np.mean(each):.3f}; {', '.join(f'{x:.3f}' for x in each)}"]
            cells += [f"{x:.1f} %" for x in shares]
            cells += [f"{x:.0f} {unit}" for x, unit in zip(means, ("W", "J/m"), strict=True)]
            yield f"| {' | '.join(cells)} |"
