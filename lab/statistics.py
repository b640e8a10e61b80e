"""Statistics of episodes, as in Sections IV-D and V-D of the paper.

Numbers are means, or in Table I interquartile means, with two 95 % bootstrap intervals. One
resamples the episodes of all seeds, as the paper does. The other resamples the seeds, and so shows
how much trainings differ. With two or three seeds it reaches from the lowest seed to the highest,
which is less than 95 %.
"""

import numpy as np
from scipy import stats

from evaluate import energy_per_metre, interval


def iqm(x, axis=None):
    """Interquartile mean of x. It ignores the lowest and the highest quarter."""
    return stats.trim_mean(x, 0.25, axis=axis)


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


def energy(e):
    """Energy per metre [J/m] of a run's episodes, of those that ask for 0.1 m/s or more, if any."""
    moving = (e["asked_v_x"] >= 0.1) | (e["asked_v_x"].max() == 0)
    return energy_per_metre(e["power"][moving], e["v_x"][moving])


# the number of a run by which runs are compared, of columns of its episodes
NUMBERS = {
    "performance": lambda e: e["performance"].mean(),  # [-] Section V-A
    "fell": lambda e: e["fell"].mean(),  # share of episodes that ended early
    "v_x": lambda e: e["v_x"].mean(),  # [m/s]
    "peak": lambda e: iqm(e["peak"]),  # [m/s] as in Table I
    "power": lambda e: e["power"].mean(),  # [W] Eq. (9) without its bonus
    "J/m": energy,
}
