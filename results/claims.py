"""The paper's claims and the promise of Eq. (3), by the rules of audit/rules.md.

A claim compares two kinds of runs by one number of each seed, from kept episodes. Runs count whose
seed is one of the rules, and those of one task and length must be of one learner.
"""

import re
from typing import NamedTuple

import numpy as np
from scipy import stats

import evaluate
from results import tables
from results.figures import TABLE1
from results.tables import MARGINS, PPO, by_group, score_of, task_of
from runtime.cli import Refused

SEEDS = range(10, 18)  # of audit/rules.md; runs of others were seen before it was written
# commits whose learner has the same bits, so that one comparison may be of all of them, by the
# rules' section 6
ONE_LEARNER = "e48949e", "e7fdb0b", "52831f8", "3eb3a5e"
TASKS = "flat", "rough", "velocity", "curriculum"
RATIOS = "power", "J/m"
HEADINGS = dict(performance="score", peak="peak [m/s]")  # of the column with the score
OTHERS = [ppo for ppo in PPO if ppo not in ("PPO(0)", "PPO(0.005)")]  # these two are rows 1 to 3
ALL, EVERY = "", "every command"  # those of an evaluation together, or each by itself
BOX, FAST, TURNING = "start box", "high v_x", "high yaw rate"  # of curriculum, as in `asked`
SHAPED, SMOOTH = "PPO(0) shaped", "EIPO smooth"
# number in audit/rules.md, task, statistic, commands (or v_x from, to [m/s]), left, right, claim
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
    *((26, "curriculum", "performance", x, "PPO(0.005)", "EIPO", "<") for x in (ALL, BOX)),
    *((26, "curriculum", "performance", x, "PPO(0.005)", SHAPED, "<") for x in (ALL, BOX)),
    *((27, "curriculum", "performance", x, "EIPO", SHAPED, "similar") for x in (ALL, BOX)),
    *((27, "curriculum", "power", x, "EIPO", SHAPED, "no more") for x in (ALL, BOX)),
    (28, "curriculum", "performance", TURNING, "EIPO", SHAPED, "<"),
    (28, "curriculum", "performance", FAST, "EIPO", SHAPED, ">"),
    *((29, "curriculum", "performance", x, SMOOTH, SHAPED, "similar") for x in (ALL, BOX)),
    *((29, "curriculum", "power", x, SMOOTH, SHAPED, "<") for x in (ALL, BOX)),
    *((30, "curriculum", "power", x, SMOOTH, "EIPO", ">") for x in (ALL, BOX)),
]


def promise(task):
    """The promise of Eq. (3) in the form of CLAIMS: pi does the task as well as the pi' of its own
    run, on less power. On velocity alpha hardly moves, and it is no claim; of curriculum the rules
    say nothing.

    What follows claims nothing. pi' beside PPO(0) says how good a rival pi' is, and then come the
    ratios of power that no row of CLAIMS has.
    """
    if task == "curriculum":
        return
    score = score_of(task)
    same, less = ("", "") if task == "velocity" else ("no worse", "<")
    yield "(3)", task, score, ALL, "EIPO", "pi' of EIPO", same
    if score != "performance":
        yield "(3)", task, "performance", ALL, "EIPO", "pi' of EIPO", ""
    yield "(3)", task, "power", ALL, "EIPO", "pi' of EIPO", less
    known = {(on, *sides) for _, on, name, _, *sides, _ in CLAIMS if name == "power"}
    yield "-", task, score, ALL, "pi' of EIPO", "PPO(0)", ""
    for left, right in [("pi' of EIPO", "PPO(0)"), *(("EIPO", ppo) for ppo in PPO)]:
        if (task, left, right) not in known:
            yield "-", task, "power", ALL, left, right, ""
    for ppo in PPO[1:]:
        yield "-", task, "power", ALL, ppo, "PPO(0)", ""


def counted(results=tables.RESULTS):
    """The runs that count, by group and kind, in which "pi' of EIPO" is a kind, too. Of the groups
    of a task the one with the longest runs comes first.

    Refused if those of a group are of several learners or of unknown or changed source, or if there
    are none.
    """
    found = {}
    for place in (results / task for task in TASKS):
        runs = tables.runs([place / "*"]) if (place / tables.RUNS).exists() else []
        # "new-..." are runs of another learner that do not replace those of their kind yet
        runs = [run for run in runs if run.name[:4] != "new-" and run.settings["seed"] in SEEDS]
        runs.sort(key=lambda run: -run.settings["iterations"])
        found |= by_group(runs)
    for kinds in found.values():
        commits = tables.commits(kinds)
        unsure = [x for x in commits if x == "unknown" or x.endswith("+")]  # one may be several
        if len({ONE_LEARNER if x[:7] in ONE_LEARNER else x for x in commits}) > 1 or unsure:
            what = "a comparison is of one learner, known and unchanged, and not of the commits"
            raise Refused(f"{what}: {', '.join(sorted(commits))}")
    if not found:
        raise Refused(f"{results} has no run with a seed from {SEEDS[0]} to {SEEDS[-1]}")
    return {group: tables.with_primes(kinds) for group, kinds in found.items()}


# ---- two arms by one number of each seed ----


class Comparison(NamedTuple):
    """Two arms by one number of each seed. If it is a ratio, all but `means` are of logs."""

    means: tuple  # of the left and of the right arm, geometric ones if it is a ratio
    difference: float  # mean of left less right
    wide: tuple  # its 95 % interval by Student's t, paired by seed
    narrow: tuple  # its 90 % interval


def compare(x, y, ratio=False):
    """The Comparison of two arms by numbers (n,) each, of the same seeds in the same order."""
    x, y = (np.log(x), np.log(y)) if ratio else (x, y)
    n, difference, error = len(x), np.mean(x - y), stats.sem(x - y)
    wide, narrow = (
        (difference - t * error, difference + t * error) for t in stats.t.ppf((0.975, 0.95), n - 1)
    )
    means = np.exp([x.mean(), y.mean()]) if ratio else (x.mean(), y.mean())
    return Comparison(tuple(means), difference, wide, narrow)


def verdict(compared, claimed, margin):
    """What audit/rules.md says of a Comparison.

    claimed: ">" or "<" (left is above right, or below), "similar", "no worse" or "no more" (left is
             not below right, or not above it, by more than the margin), or "", which has no verdict
    margin:  of the difference, or of the log of the ratio
    """
    if not claimed:
        return ""
    low, high = compared.wide
    if claimed == "no more":  # which is "no worse" of right against left
        claimed, low, high = "no worse", -high, -low
    within = -margin < compared.narrow[0] and compared.narrow[1] < margin
    if claimed == "similar":
        outside = low > margin or high < -margin
        return "holds" if within else "reversed" if outside else "undecided"
    if claimed == "no worse":
        return "holds" if low > -margin else "reversed" if high < -margin else "undecided"
    if low <= 0 <= high:
        return "level" if within else "undecided"
    word = "holds" if (low > 0) == (claimed == ">") else "reversed"
    return f"{word}, within the margin" if within else word


def paired(kinds, left, right):
    """The runs of two kinds with the seeds that both have: [Run, ...] each, in the same order."""
    left, right = (
        {run.settings["seed"]: run for run in kinds.get(kind, [])} for kind in (left, right)
    )
    seeds = sorted(left.keys() & right.keys())
    return [left[seed] for seed in seeds], [right[seed] for seed in seeds]


def asked(e, commands):
    """Which episodes e ask for some commands, as CLAIMS has them, (n,) bool."""
    v_x = e["asked_v_x"]
    if commands in (BOX, FAST, TURNING):
        box = tables.inside(v_x, e["asked_yaw"], tables.start_box())
        fast, turning = v_x >= 2.5, np.abs(e["asked_yaw"]) >= 2.5
        return {BOX: box, FAST: fast & ~turning, TURNING: turning & ~fast}[commands]
    low, high = commands or (-np.inf, np.inf)
    return (v_x > low - 0.01) & (v_x < high + 0.01)


def decide(arms, name, claimed, commands=ALL):
    """The Comparison of two arms by one of evaluate.numbers, or None, and the verdict.

    arms: of `paired`; commands: as in CLAIMS
    """

    def number(run):
        e = tables.evaluation(run.episodes)
        return evaluate.numbers(tables.where(asked(e, commands), e))[name]

    if len(arms[0]) < 3:
        return None, "not tested"
    x, y = (np.array([number(run) for run in arm]) for arm in arms)
    if not np.isfinite([x, y]).all():
        return None, "no verdict, a run stands"
    compared = compare(x, y, name in RATIOS)
    return compared, verdict(compared, claimed, MARGINS[name])


def at_every_command(arms, name, claimed):
    """The verdict on a claim about each of the eleven commands, and where it is what."""
    words = [decide(arms, name, claimed, (x / 10, x / 10))[1] for x in range(11)]
    if "not tested" in words:
        return "not tested"
    plain = {word.split(",")[0] for word in words}
    whole = "holds" if plain == {"holds"} else "reversed" if "reversed" in plain else "undecided"
    counts = (f"{words.count(word)} {word}" for word in dict.fromkeys(words))
    return f"{whole} (of 11 commands: {'; '.join(counts)})"


# ---- rows ----


def claim_lines(groups):
    """Yields the claims that are tested, and the promise, as rows of Markdown; groups: `counted`"""
    yield "| no. | what | claimed | seeds | means | difference [95 %] | verdict |"
    yield "|---" * 7 + "|"
    for group, kinds in groups.items():
        yield from group_lines(group, kinds)


def group_lines(group, kinds):
    """Yields the rows of one group."""
    task = task_of(group)
    claims = [claim for claim in CLAIMS if claim[1] == task]
    for number, _, name, commands, left, right, claimed in [*claims, *promise(task)]:
        words = commands if isinstance(commands, str) else "{} to {} m/s".format(*commands)
        where = words and f", {words}"
        what = f"{group}, {name}{where}: {left} {'/' if name in RATIOS else '-'} {right}"
        arms = paired(kinds, left, right)
        if commands == EVERY:
            compared, word = None, at_every_command(arms, name, claimed)
        else:
            compared, word = decide(arms, name, claimed, commands)
        if word == "not tested":
            continue
        cells = shown(compared, name) if compared else ("", "")
        if compared and name == "peak" and {left, right} <= TABLE1.keys():
            size = TABLE1[left] - TABLE1[right]
            inside = compared.wide[0] <= size <= compared.wide[1]
            word += f"; the paper's {size:+.2f} is {'inside' if inside else 'outside'}"
        yield f"| {number} | {what} | {claimed} | {len(arms[0])} | {' | '.join(cells)} | {word} |"


def shown(compared, name):
    """A Comparison as two cells: means, and the difference with its interval."""
    digits = {"performance": 4, "peak": 2}.get(name, 0)
    means = " and ".join(f"{x:.{digits}f}" for x in compared.means)
    ends = np.array([compared.difference, *compared.wide])
    if name in RATIOS:
        center, low, high = (f"{x:.2f}" for x in np.exp(ends))
        return means, f"x {center} [{low}, {high}]"
    center, low, high = (f"{x:+.{digits}f}" for x in ends)
    return means, f"{center} [{low}, {high}]"


def per_metre(each):
    """Energy per metre of an arm as text; each: its `tables.means`, of each run"""
    walking = each["J/m"] < np.inf
    if walking.all():
        return f"{each['J/m'].mean():.0f} J/m"
    n = int((~walking).sum())
    return f"{n} of {len(walking)} stand{'s' * (n == 1)}" if walking.any() else "stands"


def summary(runs):
    """Yields a line of Markdown for each kind of run, with what one can keep in mind."""
    for group, kinds in by_group(runs).items():
        yield f"| {group} | {HEADINGS[score_of(group)]} | power | energy | fell | seeds |"
        yield "|---" * 6 + "|"
        for kind, arm in kinds.items():
            each, mean = tables.means(arm)
            cells = [f"{mean[score_of(group)]:.2f}", f"{mean['power']:.0f} W", per_metre(each)]
            yield f"| {kind} | {' | '.join(cells)} | {100 * mean['fell']:.1f} % | {len(arm)} |"
        yield ""


def table(runs):
    """Yields a line of Markdown for each kind of run, from kept episodes: means over seeds, and the
    score and the last alpha of each. After EIPO comes its pi' where it is another one. On
    curriculum there are two tables more, of the commands of `tables.by_region`.
    """
    for group, kinds in tables.by_region(by_group(runs)).items():
        names = "power", "fell", "from nominal", "energy", "last alpha", "each seed"
        yield f"| {' | '.join((group, HEADINGS[score_of(group)], *names))} |"
        yield "|---" * 8 + "|"
        for kind, arm in tables.with_primes(kinds).items():
            # pi' knows no energy, so from any lambda_0 it is the same, unless both share a grid
            if task_of(group) != "curriculum" and re.fullmatch("pi' of EIPO from [^,]+", kind):
                continue
            each, mean = tables.means(arm)
            scores = each[score_of(group)]
            cells = [kind, f"{scores.mean():.3f}", f"{mean['power']:.0f} W"]
            cells += [f"{100 * mean[x]:.1f} %" for x in ("fell", "fell_nominal")]
            cells += [per_metre(each)]
            alphas = [run.metrics["alpha"][-1] for run in arm] if kind.startswith("EIPO") else []
            cells += [", ".join(f"{x:.0f}" for x in alphas)]
            yield f"| {' | '.join(cells)} | {', '.join(f'{x:.3f}' for x in scores)} |"
        yield ""
