"""The paper's claims by rule: `python -m lab claims` prints the table of results/README.md, and
`python -m lab claims table1` that of results/velocity/README.md, with every lambda of Table I.

Each claim compares two kinds of runs by one number of each seed, computed from the episodes that
results/ keeps. The difference of the means has a 95 % interval over seeds, by Welch's t. The rule:

    yes        the whole interval is on the side that the paper claims
    no         the whole interval is on the other side
    undecided  the interval holds 0, or one kind has a single seed and so no interval
"""

from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import stats

import evaluate
from lab import episodes, record, sweep
from lab.statistics import iqm

# where the paper claims it | what | by which of NUMBERS | kinds of runs, as TASK/NAME without seed
CLAIMS = """
Fig. 2a | EIPO performs better than PPO(0.005) | performance
        flat/flat-eipo-lam0.005 > flat/flat-ppo-lam0.005
Fig. 2a | EIPO performs better than PPO(0) | performance
        flat/flat-eipo-lam0.005 > flat/flat-ppo-lam0
Fig. 2b | EIPO needs less energy than PPO(0) | J/m
        flat/flat-eipo-lam0.005 < flat/flat-ppo-lam0
Fig. 3a | EIPO performs better than PPO(0.005) | performance
        rough/rough-eipo-lam0.0002 > rough/rough-ppo-lam0.005
Fig. 3a | EIPO performs better than PPO(0), which fails | performance
        rough/rough-eipo-lam0.0002 > rough/rough-ppo-lam0
Fig. 3b | EIPO needs less energy than PPO(0.005) | J/m
        rough/rough-eipo-lam0.0002 < rough/rough-ppo-lam0.005
Fig. 3b | EIPO needs less energy than PPO(0) | J/m
        rough/rough-eipo-lam0.0002 < rough/rough-ppo-lam0
Fig. 4 | EIPO performs better than every PPO, so than PPO(0.002) | performance
        flat/flat-eipo-lam0.005 > flat/flat-ppo-lam0.002
Table I | EIPO peaks above PPO(0) | peak
        velocity/velocity-eipo-lam0.0002 > velocity/velocity-ppo-lam0
Table I | EIPO peaks above PPO(0.0002) | peak
        velocity/velocity-eipo-lam0.0002 > velocity/velocity-ppo-lam0.0002
Table I | EIPO peaks above PPO(0.01) | peak
        velocity/velocity-eipo-lam0.0002 > velocity/velocity-ppo-lam0.01
Table I | EIPO peaks above PPO(0.0001) | peak
        velocity/velocity-eipo-lam0.0002 > velocity/velocity-ppo-lam0.0001
Section I | no lambda_0 is too large: EIPO from 0.01 peaks above PPO(0.01) | peak
        velocity/binding1000-eipo-lam0.01 > velocity/velocity-ppo-lam0.01
Fig. 5 | EIPO draws no more than the shaped reward | power
        curriculum/curriculum-eipo-lam0.005 < curriculum/curriculum-ppo-lam0-shaped
"""


TABLE1 = "\n".join(
    f"Table I | EIPO peaks above PPO({lam:g}) | peak\n"
    f"velocity/velocity-eipo-lam0.0002 > velocity/velocity-ppo-lam{lam:g}"
    for lam in sweep.LAMBDAS
)


class Claim(NamedTuple):
    """One claim of the paper: by a number, the runs `ours` are above (>) or below (<) `rivals`."""

    where: str
    what: str
    number: str
    ours: str
    sign: str
    rivals: str


def claims(text=CLAIMS):
    """The Claims of a text like CLAIMS."""
    rows = text.strip().split("\n")
    for head, kinds in zip(rows[::2], rows[1::2], strict=True):
        yield Claim(*(x.strip() for x in head.split("|")), *kinds.split())


# ---- one number of each seed ----


def performance(e):
    """Task performance [-], Section V-A."""
    return e["performance"].mean()


def power(e):
    """Power [W] of Eq. (9) without its bonus."""
    return e["power"].mean()


def energy(e):
    """Energy per metre [J/m], of commands from 0.1 m/s on."""
    moving = e["asked_v_x"] >= 0.1
    return evaluate.energy_per_metre(e["power"][moving], e["v_x"][moving])


def peak(e):
    """Peak velocity [m/s]: the interquartile mean, as in Table I."""
    return iqm(e["peak"])


NUMBERS = {
    "performance": (performance, "", 4),
    "power": (power, " W", 0),
    "J/m": (energy, " J/m", 0),
    "peak": (peak, " m/s", 2),
}


tables = lru_cache(record.groups)  # read once for all claims of a task


def seeds(kind, number, results=None):
    """The number of each seed of a kind, TASK/NAME: a list over the runs NAME-seedN."""
    task, name = kind.split("/")
    place = (results or record.RESULTS) / task
    by_run = tables(place / record.EPISODES)
    runs = [run for run in by_run if run.removeprefix(f"{name}-seed").isdecimal()]
    return [NUMBERS[number][0](random_starts(by_run[run], task)) for run in runs]


def random_starts(rows, task):
    """The columns of the episodes with random starts, on the ground of the task's evaluation."""
    columns = {name: np.array([float(row[name]) for row in rows]) for name in episodes.COLUMNS}
    roughness = evaluate.ROUGHNESS.get(task, columns["roughness"].max())
    usual = (columns["start_spread"] > 0) & (columns["roughness"] == roughness)
    return {name: x[usual] for name, x in columns.items()}


# ---- verdicts ----


def verdict(ours, rivals, less=False):
    """The difference of two means, its 95 % interval, and yes, no or undecided.

    ours, rivals: (n,), (m,) a number of each seed; less: whether ours is claimed to be below
    """
    difference = np.mean(ours) - np.mean(rivals)
    if min(len(ours), len(rivals)) < 2:
        return difference, (np.nan, np.nan), "undecided"
    low, high = stats.ttest_ind(ours, rivals, equal_var=False).confidence_interval(0.95)
    if low <= 0 <= high:
        return difference, (low, high), "undecided"
    return difference, (low, high), "yes" if (difference < 0) == less else "no"


def lines(text=CLAIMS, results=None):
    """The lines of the table of a text like CLAIMS."""
    yield "| paper | claim | ours | rival | difference [95 %] | seeds | verdict |"
    yield "|---" * 7 + "|"
    for claim in claims(text):
        ours, rivals = (seeds(kind, claim.number, results) for kind in (claim.ours, claim.rivals))
        if not ours or not rivals:
            missing = claim.rivals if ours else claim.ours
            raise ValueError(f"{results or record.RESULTS} has no episodes of {missing}-seed*")
        difference, (low, high), word = verdict(ours, rivals, claim.sign == "<")
        _, unit, digits = NUMBERS[claim.number]
        over = "no interval" if np.isnan(low) else f"{low:+.{digits}f}, {high:+.{digits}f}"
        means = (f"{np.mean(x):.{digits}f}{unit}" for x in (ours, rivals))
        cells = [f"{claim.where}, {claim.ours.split('/')[0]}", claim.what, *means]
        cells += [f"{difference:+.{digits}f} [{over}]", f"{len(ours)}, {len(rivals)}", word]
        yield f"| {' | '.join(cells)} |"


def table(which="", path=None):
    """What `python -m lab claims WHICH` prints; path: of the folder of results, if not ours.

    Raises ValueError if which is not "table1" or "".
    """
    if which not in ("", "table1"):
        raise ValueError(f"claims takes table1 or nothing, not {which}")
    rows = [*lines(TABLE1 if which else CLAIMS, Path(path) if path else None)]
    words = [row.split(" | ")[-1].removesuffix(" |") for row in rows[2:]]
    tally = ", ".join(f"{words.count(word)} {word}" for word in ("yes", "no", "undecided"))
    return [*rows, "", f"In all: {tally}."]
