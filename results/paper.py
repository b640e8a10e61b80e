"""What the paper says of its methods, and what our runs say of that.

A sentence compares two kinds of runs by one number of each seed. By Welch's 95 % interval of their
difference, or of the ratio of their geometric means, it *agrees*, if the interval lies where the
sentence says, *disagrees*, if it lies wholly outside, and is *open* otherwise.
"""

import warnings
from collections import Counter
from typing import NamedTuple

import numpy as np
from scipy import stats

import evaluate
from results.runs import by_group, read_all, where, with_primes
from runtime.cli import Refused
from runtime.kinds import Kind
from tasks import LAMBDAS, TASKS, Grid

SEEDS = range(10, 18)  # that count: nobody had seen them when the sentences were chosen
# commits whose learner is the same up to last digits, so that one comparison may be of all of them
ONE_LEARNER = "e48949e", "e7fdb0b", "52831f8", "3eb3a5e", "905d604", "cc4f7ed"
# fixed before the runs, of a difference or of the logarithm of a ratio
MARGINS = {"score": 0.03, "peak": 0.37, "power": np.log(1.25), "J/m": np.log(1.25)}
RATIOS = "power", "J/m"
TABLE1 = 2.86, 2.12, 1.55, 1.49, 1.58, 1.64, 1.58, 1.62, 1.45, 1.37  # m/s, of EIPO, PPO(LAMBDAS)


def ppo(*lams):
    """The kinds PPO(lam)."""
    return [Kind("ppo", lam) for lam in lams]


def eipo(task, **changes):
    """The kind of EIPO from the start that the paper names, in a list."""
    lam = TASKS[task].learner["lam"]
    return [Kind("eipo", lam, **changes)]


P0, TUNED, SWEEP = ppo(0), ppo(0.005), ppo(*LAMBDAS)
FLAT, ROUGH, FAST = eipo("flat"), eipo("rough"), eipo("velocity")
# the kept runs of curriculum have another step of alpha than today's default, until newer ones come
STEP = dict(other=("lr_alpha 0.5", "momentum_alpha 0.99"))
WIDE, SMOOTH = eipo("curriculum", **STEP), eipo("curriculum", aux="smooth", **STEP)
SHAPED = [Kind("ppo", 0, reward="shaped")]
SCORE, PEAK, POWER, PER_METRE = "score", "peak", "power", "J/m"
ALL, EACH = (-np.inf, np.inf), "each"  # commands: v_x [m/s] from and to, or each by itself
BOX, SPEED, TURNING = "start box", "high v_x", "high yaw rate"  # of curriculum


class Sentence(NamedTuple):
    """A sentence of the paper, which compares kinds of runs: each on the left with each right."""

    place: str  # in the paper
    says: str  # shortened
    statistic: str  # of evaluate.numbers
    left: list  # of kinds
    claimed: str  # >, <, similar (within the margin), no worse, no more (than by the margin)
    right: list
    commands: object = ALL
    printed: tuple = ()  # the differences that the paper prints, one for each pair


def rival(kinds):
    """The kinds of pi' of these kinds of EIPO."""
    return [kind._replace(prime=True) for kind in kinds]


FASTER = [TABLE1[0] - x for x in TABLE1[1:]]
SLOWER = [x - TABLE1[1] for x in TABLE1[2:]]
PAPER = dict(
    flat=[
        ("V-A", "EIPO outperforms tuned PPO", SCORE, FLAT, ">", TUNED),
        ("V-A", "EIPO outperforms PPO(0)", SCORE, FLAT, ">", P0),
        ("V-A", "EIPO outperforms both at every command", SCORE, FLAT, ">", P0 + TUNED, EACH),
        ("V-A", "EIPO spends less than PPO(0)", PER_METRE, FLAT, "<", P0),
        ("V-A", "Tuned PPO spends less than PPO(0)", PER_METRE, TUNED, "<", P0),
        ("Fig. 2", "EIPO spends more than tuned PPO", PER_METRE, FLAT, ">", TUNED),
        ("V-A", "EIPO spends more up to 0.5 m/s", PER_METRE, FLAT, ">", TUNED, (0.1, 0.5)),
        ("V-A", "EIPO spends as much from 0.6 m/s on", PER_METRE, FLAT, "similar", TUNED, (0.6, 1)),
        ("abstract", "EIPO draws power like tuned PPO", POWER, FLAT, "similar", TUNED),
        ("V-C", "EIPO outperforms PPO at every lambda", SCORE, FLAT, ">", SWEEP),
        ("V-C", "EIPO does so at every command", SCORE, FLAT, ">", SWEEP, EACH),
        ("Eq. (3)", "pi is as good as pi'", SCORE, FLAT, "no worse", rival(FLAT)),
        ("Eq. (3)", "pi draws less power than pi'", POWER, FLAT, "<", rival(FLAT)),
    ],
    rough=[
        ("V-B", "EIPO beats tuned PPO above 0.4 m/s", SCORE, ROUGH, ">", TUNED, (0.5, 1)),
        ("Fig. 3", "EIPO is never below PPO", SCORE, ROUGH, "no worse", P0 + TUNED, EACH),
        ("abstract", "EIPO outperforms tuned PPO", SCORE, ROUGH, ">", TUNED),
        ("V-B", "EIPO works where PPO(0) fails", SCORE, ROUGH, ">", P0),
        ("V-B", "Tuned PPO outperforms PPO(0)", SCORE, TUNED, ">", P0),
        ("V-B", "EIPO spends less than tuned PPO", PER_METRE, ROUGH, "<", TUNED),
        ("Fig. 3", "EIPO spends less than PPO(0)", PER_METRE, ROUGH, "<", P0),
        ("abstract", "EIPO draws power like tuned PPO", POWER, ROUGH, "similar", TUNED),
        ("V-C", "EIPO matches PPO up to 0.3 m/s", SCORE, ROUGH, "similar", SWEEP, (0, 0.3)),
        ("V-C", "EIPO outperforms PPO from 0.4 m/s on", SCORE, ROUGH, ">", SWEEP, (0.4, 1)),
        ("Eq. (3)", "pi is as good as pi'", SCORE, ROUGH, "no worse", rival(ROUGH)),
        ("Eq. (3)", "pi draws less power than pi'", POWER, ROUGH, "<", rival(ROUGH)),
    ],
    velocity=[
        ("V-D", "EIPO is faster than PPO(0)", PEAK, FAST, ">", P0, ALL, FASTER[:1]),
        ("V-D", "EIPO is faster than PPO at every lambda", PEAK, FAST, ">", SWEEP, ALL, FASTER),
        ("V-D", "Every weight makes PPO slower", PEAK, SWEEP[1:], "<", P0, ALL, SLOWER),
        ("abstract", "EIPO draws power like PPO(0)", POWER, FAST, "similar", P0),
    ],
    curriculum=[
        ("V-E", "Tuned PPO does worse than EIPO", SCORE, TUNED, "<", WIDE),
        ("V-E", "Tuned PPO does worse than shaped PPO", SCORE, TUNED, "<", SHAPED),
        ("V-E", "EIPO does as well as shaped PPO", SCORE, WIDE, "similar", SHAPED),
        ("V-E", "EIPO does so in the start box", SCORE, WIDE, "similar", SHAPED, BOX),
        ("V-E", "EIPO draws no more than shaped PPO", POWER, WIDE, "no more", SHAPED),
        ("V-E", "EIPO draws no more in the start box", POWER, WIDE, "no more", SHAPED, BOX),
        ("V-E", "EIPO is worse from 2.5 rad/s, below 2.5 m/s", SCORE, WIDE, "<", SHAPED, TURNING),
        ("V-E", "EIPO is better from 2.5 m/s, below 2.5 rad/s", SCORE, WIDE, ">", SHAPED, SPEED),
        ("V-E", "Smooth EIPO does as well as shaped PPO", SCORE, SMOOTH, "similar", SHAPED),
        ("V-E", "Smooth EIPO does so in the start box", SCORE, SMOOTH, "similar", SHAPED, BOX),
        ("V-E", "Smooth EIPO draws less than shaped PPO", POWER, SMOOTH, "<", SHAPED),
        ("V-E", "Smooth EIPO draws less in the start box", POWER, SMOOTH, "<", SHAPED, BOX),
        ("V-E", "Smooth EIPO draws more than EIPO", POWER, SMOOTH, ">", WIDE),
    ],
)


# ---- two kinds by one number of each seed ----


class Comparison(NamedTuple):
    """Two arms by one number of each seed: a difference of means, or a ratio of geometric ones."""

    left: float  # the means
    right: float
    difference: float  # of a ratio this, low and high are logarithms
    low: float  # of Welch's 95 % interval
    high: float
    is_ratio: bool

    def __str__(self):
        ends = self.difference, self.low, self.high
        if not np.isfinite(ends).all():
            return f"{self.left:.3g} and {self.right:.3g}"
        if self.is_ratio:
            center, low, high = (f"{x:.2f}" for x in np.exp(ends))
            return f"x {center} [{low}, {high}]"
        center, low, high = (f"{x:+.3f}" for x in ends)
        return f"{center} [{low}, {high}]"


def compare(x, y, is_ratio=False):
    """The Comparison of two arms by the numbers (seeds,) of each. Its ends are NaN if they have
    fewer than three seeds, or numbers that are not finite.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # seeds that are alike, or a watt of 0
        x, y = (np.log(x), np.log(y)) if is_ratio else (np.asarray(x), np.asarray(y))
        ends = np.nan, np.nan
        if min(len(x), len(y)) >= 3 and np.isfinite([*x, *y]).all():
            ends = stats.ttest_ind(x, y, equal_var=False).confidence_interval(0.95)
        means = np.exp([x.mean(), y.mean()]) if is_ratio else (x.mean(), y.mean())
        return Comparison(*means, x.mean() - y.mean(), *ends, is_ratio)


def verdict(low, high, claimed, margin):
    """agrees, disagrees or open; low, high: of an interval, in which NaN decides nothing."""
    where_it_says = {
        ">": (0, np.inf),
        "<": (-np.inf, 0),
        "similar": (-margin, margin),
        "no worse": (-margin, np.inf),
        "no more": (-np.inf, margin),
    }
    least, greatest = where_it_says[claimed]
    if least < low and high < greatest:
        return "agrees"
    return "disagrees" if high < least or greatest < low else "open"


def asked(did, commands):
    """Which rows of `did` ask for some commands, as Sentence has them, (n,) bool."""
    v_x, yaw = did["asked_v_x"], np.abs(did["asked_yaw"])
    if commands == BOX:
        return (np.abs(v_x) <= Grid.START) & (yaw <= Grid.START)
    if commands in (SPEED, TURNING):
        fast, turning = v_x >= 2.5, yaw >= 2.5
        return fast & ~turning if commands == SPEED else turning & ~fast
    low, high = commands
    return (v_x > low - 0.01) & (v_x < high + 0.01)


def number(run, statistic, commands):
    """One of evaluate.numbers of a Run, at some commands; NaN if it was asked for none of them."""
    mine = asked(run.did, commands)
    return evaluate.numbers(where(mine, run.did))[statistic] if mine.any() else np.nan


# ---- the rows ----


def counted(places):
    """The runs of SEEDS by group and kind, of which "pi' of EIPO ..." is one, too.

    Refused if those of a group are of several learners, or of unknown or changed source.
    """
    groups = by_group(run for run in read_all(places) if run.settings["seed"] in SEEDS)
    if not groups:
        raise Refused(f"none of these runs has a seed from {SEEDS[0]} to {SEEDS[-1]}")
    for kinds in groups.values():
        commits = {start["commit"] for arm in kinds.values() for x in arm for start in x.starts}
        unsure = [x for x in commits if x == "unknown" or x.endswith("+")]  # one may be several
        if len({ONE_LEARNER if x[:7] in ONE_LEARNER else x for x in commits}) > 1 or unsure:
            what = "a comparison needs runs of one learner, known and unchanged; these are of"
            raise Refused(f"{what} {', '.join(sorted(commits))}")
    return {group: with_primes(kinds) for group, kinds in groups.items()}


def paper(places):
    """Yields a row of Markdown for each sentence of the paper, by group of our runs."""
    groups = counted(places)
    yield "| paper | says | came out [95 %] | verdict |"
    yield "|---|---|---|---|"
    for task, sentences in PAPER.items():
        lengths = [group for group in groups if group.task == task]
        for group in sorted(lengths, key=lambda group: -group.iterations):
            yield f"| **{group}** | | | |"
            for sentence in (Sentence(*parts) for parts in sentences):
                if cells := outcome(sentence, groups[group]):
                    yield f"| {sentence.place} | {sentence.says} | {' | '.join(cells)} |"


def outcome(sentence, kinds):
    """What came out of the kinds of a group, and the verdict; None if a side has no runs, or only
    one of the several weights that the sentence is about.

    A sentence about several weights or commands says at how many it agrees, and has no verdict.
    """
    pairs = [(left, right) for left in sentence.left for right in sentence.right]
    printed = dict(zip(pairs, sentence.printed, strict=False))
    fewest = min(len(pairs), 2)
    pairs = [(left, right) for left, right in pairs if left in kinds and right in kinds]
    if len(pairs) < fewest:
        return None
    ranges = [sentence.commands]
    if sentence.commands == EACH:
        ranges = [(x / 10, x / 10) for x in range(11)]
    statistic, words, excluded, shown = sentence.statistic, [], 0, None
    for left, right in pairs:
        for commands in ranges:
            x, y = ([number(run, statistic, commands) for run in kinds[k]] for k in (left, right))
            shown = compare(x, y, statistic in RATIOS)
            ends = shown.low, shown.high
            words.append(verdict(*ends, sentence.claimed, MARGINS[statistic]))
            if printed:
                excluded += printed[left, right] < ends[0] or ends[1] < printed[left, right]
    n = len(words)
    if fewest == len(ranges) == 1:
        more = "".join(f"; printed {difference:+.2f}" for difference in sentence.printed)
        return f"{statistic} {shown}{more}", words[0]
    more = f"; {excluded} of {n} printed differences excluded" * bool(printed)
    count = Counter(words)
    counts = f"agrees at {count['agrees']} of {n}, disagrees at {count['disagrees']}"
    return f"{statistic} {counts}{more}", ""
