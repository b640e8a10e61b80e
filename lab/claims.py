"""The paper's claims by rule: `python -m lab claims` prints the table of results/README.md, and
`python -m lab claims table1` that of results/velocity/README.md, with every lambda of Table I.

Each claim compares two kinds of runs by one number of each seed, computed from the episodes that
results/ keeps. The difference of the means has a 95 % interval over seeds, by Welch's t. The rule:

    yes        the whole interval is on the side that the paper claims
    no         the whole interval is on the other side
    undecided  the interval holds 0, or one kind has a single seed and so no interval
"""

import numpy as np
from scipy import stats

from lab import record, sweep
from lab.statistics import NUMBERS

FLAT, ROUGH, FAST = (
    "flat/flat-eipo-lam0.005",
    "rough/rough-eipo-lam0.0002",
    "velocity/velocity-eipo-lam0.0002",
)
# where the paper claims it, what, by which of NUMBERS, whose runs are (TASK/NAME without a seed),
# and whether they are above (+1) or below (-1) whose
CLAIMS = [
    (
        "Fig. 2a",
        "EIPO performs better than PPO(0.005)",
        "performance",
        FLAT,
        1,
        "flat/flat-ppo-lam0.005",
    ),
    ("Fig. 2a", "EIPO performs better than PPO(0)", "performance", FLAT, 1, "flat/flat-ppo-lam0"),
    ("Fig. 2b", "EIPO needs less energy than PPO(0)", "J/m", FLAT, -1, "flat/flat-ppo-lam0"),
    (
        "Fig. 3a",
        "EIPO performs better than PPO(0.005)",
        "performance",
        ROUGH,
        1,
        "rough/rough-ppo-lam0.005",
    ),
    (
        "Fig. 3a",
        "EIPO performs better than PPO(0), which fails",
        "performance",
        ROUGH,
        1,
        "rough/rough-ppo-lam0",
    ),
    (
        "Fig. 3b",
        "EIPO needs less energy than PPO(0.005)",
        "J/m",
        ROUGH,
        -1,
        "rough/rough-ppo-lam0.005",
    ),
    ("Fig. 3b", "EIPO needs less energy than PPO(0)", "J/m", ROUGH, -1, "rough/rough-ppo-lam0"),
    (
        "Fig. 4",
        "EIPO performs better than every PPO, so than PPO(0.002)",
        "performance",
        FLAT,
        1,
        "flat/flat-ppo-lam0.002",
    ),
    ("Table I", "EIPO peaks above PPO(0)", "peak", FAST, 1, "velocity/velocity-ppo-lam0"),
    ("Table I", "EIPO peaks above PPO(0.0002)", "peak", FAST, 1, "velocity/velocity-ppo-lam0.0002"),
    ("Table I", "EIPO peaks above PPO(0.01)", "peak", FAST, 1, "velocity/velocity-ppo-lam0.01"),
    ("Table I", "EIPO peaks above PPO(0.0001)", "peak", FAST, 1, "velocity/velocity-ppo-lam0.0001"),
    (
        "Section I",
        "no lambda_0 is too large: EIPO from 0.01 peaks above PPO(0.01)",
        "peak",
        "velocity/binding1000-eipo-lam0.01",
        1,
        "velocity/velocity-ppo-lam0.01",
    ),
    (
        "Fig. 5",
        "EIPO draws no more than the shaped reward",
        "power",
        "curriculum/curriculum-eipo-lam0.005",
        -1,
        "curriculum/curriculum-ppo-lam0-shaped",
    ),
]
TABLE1 = [
    (
        "Table I",
        f"EIPO peaks above PPO({lam:g})",
        "peak",
        FAST,
        1,
        f"velocity/velocity-ppo-lam{lam:g}",
    )
    for lam in sweep.LAMBDAS
]
UNITS = {"performance": ("", 4), "power": (" W", 0), "J/m": (" J/m", 0), "peak": (" m/s", 2)}


def verdict(ours, rivals, sign):
    """The difference of two means, its 95 % interval, and yes, no or undecided.

    ours, rivals: (n,), (m,) a number of each seed; sign: of the difference that is claimed
    """
    difference = np.mean(ours) - np.mean(rivals)
    if min(len(ours), len(rivals)) < 2:
        return difference, (np.nan, np.nan), "undecided"
    low, high = stats.ttest_ind(ours, rivals, equal_var=False).confidence_interval(0.95)
    word = "undecided" if low <= 0 <= high else "yes" if sign * difference > 0 else "no"
    return difference, (low, high), word


def of_kind(run, name):
    """Whether the tables have episodes of a run of TASK/NAME."""
    return run.episodes and run.name.split("-seed")[0] == name.split("/")[1]


def lines(claims=CLAIMS, results=record.RESULTS):
    """Yields the lines of the table of claims, and their tally."""
    names = {f"{name}-seed*" for claim in claims for name in (claim[3], claim[5])}
    runs = record.runs(results / name for name in sorted(names))
    words = []
    yield "| paper | claim | ours | rival | difference [95 %] | seeds | verdict |"
    yield "|---" * 7 + "|"
    for where, what, number, ours, sign, rivals in claims:
        task, _ = ours.split("/")
        ours, rivals = (
            [NUMBERS[number](record.evaluation(run)) for run in runs if of_kind(run, name)]
            for name in (ours, rivals)
        )
        difference, (low, high), word = verdict(ours, rivals, sign)
        unit, digits = UNITS[number]
        over = "no interval" if np.isnan(low) else f"{low:+.{digits}f}, {high:+.{digits}f}"
        means = (f"{np.mean(x):.{digits}f}{unit}" for x in (ours, rivals))
        cells = [f"{where}, {task}", what, *means, f"{difference:+.{digits}f} [{over}]"]
        yield f"| {' | '.join([*cells, f'{len(ours)}, {len(rivals)}', word])} |"
        words.append(word)
    tally = ", ".join(f"{words.count(word)} {word}" for word in ("yes", "no", "undecided"))
    yield f"\nIn all: {tally}."


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
