"""Statistics of episodes, as in Sections IV-D and V-D of the paper, and of runs by rules.md.

Numbers are means, or in Table I interquartile means, with two 95 % bootstrap intervals. One
resamples the episodes of all seeds, as the paper does. The other resamples the seeds, and so shows
how much trainings differ. With two or three seeds it reaches from the lowest seed to the highest,
which is less than 95 %.
"""

from typing import NamedTuple

import numpy as np
from scipy import optimize, stats

from evaluate import energy_per_metre, interval, iqm


def summarise(name, by_seed, statistic=np.mean):
    """Columns of a CSV: a statistic, its intervals over episodes and seeds, the number of episodes.

    by_seed:   one array per seed, (episodes,), or (k, episodes) for a statistic of k numbers of an
               episode; an episode with a number that is not finite does not count
    statistic: of k arrays (..., episodes), with an argument axis: np.mean, iqm, energy_per_metre
    """
    by_seed = [np.atleast_2d(x) for x in by_seed]
    by_seed = [x[:, np.isfinite(x).all(0)] for x in by_seed]
    by_seed = [x for x in by_seed if x.size]
    columns = [f"{name}{part}" for part in ("", "_low", "_high", "_seeds_low", "_seeds_high")]
    if not by_seed:
        return dict.fromkeys(columns, np.nan) | {f"{name}_n": 0}

    def of_seeds(drawn):
        return statistic(*np.hstack([by_seed[i] for i in drawn]), axis=-1)

    seeds = np.arange(len(by_seed))
    pooled = np.hstack(by_seed)
    over_episodes = interval(pooled, statistic, batch=100)
    over_seeds = interval([seeds], of_seeds, vectorized=False)
    numbers = float(of_seeds(seeds)), *over_episodes, *over_seeds
    return dict(zip(columns, numbers, strict=True)) | {f"{name}_n": pooled.shape[1]}


# ---- runs are compared by one number of each seed ----


def energy(e):
    """Energy per metre [J/m] of a run's episodes, of those that ask for 0.1 m/s or more, if any."""
    moving = (e["asked_v_x"] >= 0.1) | (e["asked_v_x"].max() == 0)
    return energy_per_metre(e["power"][moving], e["v_x"][moving])


# the number of a run by which runs are compared, from columns of its episodes
NUMBERS = {
    "performance": lambda e: e["performance"].mean(),  # [-] Section V-A
    "fell": lambda e: e["fell"].mean(),  # share of episodes that ended early
    "v_x": lambda e: e["v_x"].mean(),  # [m/s]
    "peak": lambda e: iqm(e["peak"]),  # [m/s] as in Table I
    "power": lambda e: e["power"].mean(),  # [W] Eq. (9) without its bonus
    "J/m": energy,
}


class Comparison(NamedTuple):
    """Two arms by one number of each seed. If it is a ratio, all but `means` are of logs."""

    seeds: int
    means: tuple  # of the left and of the right arm, geometric ones if it is a ratio
    difference: float  # mean of left less right
    wide: tuple  # its 95 % interval by Student's t, paired by seed
    narrow: tuple  # its 90 % interval
    welch: tuple  # the 95 % interval by Welch's t, which decides nothing
    visible: float  # the smallest difference that as many seeds show with 80 % power


def compare(x, y, ratio=False):
    """The Comparison of two arms by numbers (n,) each, of the same seeds in the same order."""
    x, y = (np.log(x), np.log(y)) if ratio else (x, y)
    n, difference = len(x), np.mean(x - y)
    error = stats.sem(x - y)
    wide, narrow = (
        (difference - t * error, difference + t * error) for t in stats.t.ppf((0.975, 0.95), n - 1)
    )
    welch = tuple(stats.ttest_ind(x, y, equal_var=False).confidence_interval(0.95))
    means = np.exp([x.mean(), y.mean()]) if ratio else (x.mean(), y.mean())
    return Comparison(n, tuple(means), difference, wide, narrow, welch, error * shift(n))


def shift(n):
    """How many standard errors a difference has that n pairs show with 80 % power, at 5 %."""
    f = stats.f.ppf(0.95, 1, n - 1)  # the square of t
    return optimize.brentq(lambda x: stats.ncf.sf(f, 1, n - 1, x**2) - 0.8, 0.1, 15.0)


def verdict(compared, claimed, margin):
    """What results/rules.md says of a Comparison.

    claimed: ">" or "<" (left is above right, or below), "similar", or "no worse" (left is not below
             right by more than the margin)
    margin:  of the difference, or of the log of the ratio
    """
    low, high = compared.wide
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
