"""The paper's claims, by the rules of results/rules.md.

A claim compares two kinds of runs by one number of each seed, from kept episodes. Runs count whose
seed is one of the rules, and those of a task must be of one commit.
"""

import numpy as np

from lab import figures, record
from lab.kinds import KINDS, by_kind
from lab.statistics import NUMBERS, compare, verdict
from runtime.command import Refused

SEEDS = range(10, 18)  # of rules.md; runs of others were seen before it was written
TASKS = "flat", "rough", "velocity"
# A margin is of a difference, or of the logarithm of a ratio.
MARGINS = {"performance": 0.03, "peak": 0.37, "power": np.log(1.25), "J/m": np.log(1.25)}
RATIOS = "power", "J/m"
PPO = KINDS[1:]
OTHERS = [ppo for ppo in PPO if ppo not in ("PPO(0)", "PPO(0.005)")]  # these two are rows 1 to 3
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
    *((19, "flat", "performance", ALL, "EIPO", ppo, ">") for ppo in OTHERS),
    *((20, "flat", "performance", EVERY, "EIPO", ppo, ">") for ppo in OTHERS),
    *((21, "rough", "performance", (0, 0.3), "EIPO", ppo, "similar") for ppo in PPO),
    *((22, "rough", "performance", (0.4, 1), "EIPO", ppo, ">") for ppo in PPO),
    *((23, "velocity", "peak", ALL, "EIPO", ppo, ">") for ppo in PPO),
    *((24, "velocity", "peak", ALL, ppo, "PPO(0)", "<") for ppo in PPO[1:]),
    (25, "velocity", "power", ALL, "EIPO", "PPO(0)", "similar"),
]
NUMBERED = [number for number, *_ in CLAIMS]


def counted(results=record.RESULTS):
    """The runs that count, by task and kind: {task: {kind: [Run, ...]}}. "pi' of EIPO" is a kind.

    Refused if those of a task are of several commits, or if there are none at all.
    """
    arms = {}
    for task in TASKS:
        place = results / task
        runs = record.runs([place / "*"]) if (place / record.RUNS).exists() else []
        runs = [run for run in runs if run.episodes and run.settings["seed"] in SEEDS]
        commits = {commit for run in runs for commit in record.commits(run.row)}
        if len(commits) > 1:
            raise Refused(f"no comparison mixes commits: {', '.join(sorted(commits))}")
        kinds = by_kind(runs, task) if runs else {}
        arms[task] = kinds | {
            f"pi' of {kind}": [run._replace(episodes=run.prime) for run in arm if run.prime]
            for kind, arm in kinds.items()
        }
    if not any(arms.values()):
        raise Refused(f"{results} has no run with a seed from {SEEDS[0]} to {SEEDS[-1]}")
    return arms


# ---- comparisons ----


def paired(kinds, left, right):
    """The runs of two kinds with the seeds that both have: [Run, ...] each, in the same order."""
    left, right = (
        {run.settings["seed"]: run for run in kinds.get(kind, [])} for kind in (left, right)
    )
    seeds = sorted(left.keys() & right.keys())
    return [left[seed] for seed in seeds], [right[seed] for seed in seeds]


def numbers(runs, name, commands=ALL):
    """One of NUMBERS of each run (n,), of the commands v_x from ... to ... [m/s]."""
    low, high = commands
    found = []
    for e in map(record.evaluation, runs):
        mine = (e["asked_v_x"] > low - 0.01) & (e["asked_v_x"] < high + 0.01)
        found.append(NUMBERS[name](record.where(mine, e)))
    return np.array(found)


def decide(left, right, name, claimed="similar", commands=ALL):
    """The Comparison of two arms, [Run, ...] with the same seeds, and its verdict by the rules."""
    x, y = (numbers(runs, name, commands) for runs in (left, right))
    if len(x) < 3:
        return None, "not tested"
    if not np.isfinite([x, y]).all():
        return None, "no verdict, a run stands"
    compared = compare(x, y, name in RATIOS)
    return compared, verdict(compared, claimed, MARGINS[name])


def at_every_command(left, right, name, claimed):
    """The verdict on a claim about each of the eleven commands, and where it is what."""
    words = [decide(left, right, name, claimed, (x / 10, x / 10))[1] for x in range(11)]
    words = [word.split(",")[0] for word in words]
    counts = {word: words.count(word) for word in dict.fromkeys(words)}
    if "not tested" in counts:
        return "not tested"
    whole = "reversed" if "reversed" in counts else "undecided"
    whole = "holds" if counts == {"holds": 11} else whole
    return f"{whole} (of 11 commands: {', '.join(f'{n} {word}' for word, n in counts.items())})"


def shown(compared, name):
    """A Comparison as cells: means, difference and its interval, Welch's interval."""
    ratio = name in RATIOS
    digits = {"performance": 4, "peak": 2}.get(name, 0)
    means = " and ".join(f"{x:.{digits}f}" for x in compared.means)
    ends = np.array([compared.difference, *compared.wide, *compared.welch])
    ends = [f"{x:.2f}" for x in np.exp(ends)] if ratio else [f"{x:+.{digits}f}" for x in ends]
    center, low, high, *welch = ends
    return means, f"{'x ' * ratio}{center} [{low}, {high}]", f"[{', '.join(welch)}]"


# ---- the claims ----


def claim_lines(arms):
    """Yields the rows of the claims as lines of Markdown, and which ones are not tested.

    arms: of `counted`
    """
    untested = {}
    yield "| no. | what | claimed | seeds | means | difference [95 %] | Welch | verdict |"
    yield "|---" * 8 + "|"
    for number, task, name, commands, left, right, claimed in CLAIMS:
        where = f", {commands}" if commands == EVERY else f", {commands[0]} to {commands[1]} m/s"
        where = "" if commands == ALL else where
        what = f"{task}, {name}{where}: {left} {'/' if name in RATIOS else '-'} {right}"
        sides = paired(arms[task], left, right)
        if commands == EVERY:
            compared, word = None, at_every_command(*sides, name, claimed)
        else:
            compared, word = decide(*sides, name, claimed, commands)
        if word == "not tested":
            untested[number] = untested.get(number, 0) + 1
            continue
        cells = [str(compared.seeds), *shown(compared, name)] if compared else [""] * 4
        if word == "undecided" and compared:
            seen = compared.visible
            word += f", would see {f'x {np.exp(seen):.2f}' if name in RATIOS else f'{seen:.2g}'}"
        if number in (23, 24) and compared:  # the paper prints a difference
            size = figures.TABLE1[left] - figures.TABLE1[right]
            inside = compared.wide[0] <= size <= compared.wide[1]
            word += f"; the paper's {size:+.2f} is {'inside' if inside else 'outside'}"
        yield f"| {number} | {what} | {claimed} | {' | '.join(cells)} | {word} |"
    whole = [f"{n}" for n, rows in untested.items() if rows == NUMBERED.count(n)] + ["26 to 31"]
    some = [f"{rows} lambdas of {n}" for n, rows in untested.items() if rows < NUMBERED.count(n)]
    yield f"\nNot tested, for want of three common seeds: {', '.join([*whole, *some])}."


def table(runs):
    """Yields a line of Markdown for each kind of run, from kept episodes: means over seeds.

    The score is the peak [m/s] on velocity, and elsewhere task performance.
    """
    runs = [run for run in runs if run.episodes]
    for task in dict.fromkeys(run.settings["task"] for run in runs):
        score = "peak" if task == "velocity" else "performance"
        names = "seeds", f"{score}: mean; each seed", "fell", "from nominal"
        yield f"| {' | '.join((task, *names, 'power', 'energy', 'last alpha'))} |"
        yield "|---" * 8 + "|"
        for kind, seeds in by_kind(runs, task).items():
            rows = [record.scores(run) for run in seeds]
            mean = {name: np.mean([row[name] for row in rows]) for name in rows[0]}
            each = ", ".join(f"{row[score]:.3f}" for row in rows)
            cells = [kind, str(len(seeds)), f"{mean[score]:.3f}; {each}"]
            cells += [f"{100 * mean[x]:.1f} %" for x in ("fell", "fell_nominal")]
            cells += [f"{mean['power']:.0f} W"]
            cells += [f"{mean['J/m']:.0f} J/m" if mean["J/m"] < np.inf else "stands"]
            alphas = [run.metrics["alpha"][-1] for run in seeds if run.settings["algo"] == "eipo"]
            yield f"| {' | '.join(cells)} | {', '.join(f'{x:.0f}' for x in alphas)} |"
