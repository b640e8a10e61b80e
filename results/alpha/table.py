"""Readings of alpha at equal steps: `python results/alpha/table.py RUN...` prints a Markdown table.

All at the steps of the shortest run: batch means, exploration noise included, over the last 50 iterations before that,
and alpha there. When a run first passed a reward: `python results/speed.py reach RUN...`.
"""

import sys
from pathlib import Path

import numpy as np

COLUMNS = ("reward", "prime_reward", "v_x", "power", "prime_power", "gap")


def row(c, last):
    """The cells of a run with columns c, whose steps end at `last`."""
    upto = c["steps"] <= last
    means = [f"{c[name][upto][-50:].mean():.4g}" if name in c.dtype.names else "" for name in COLUMNS]
    return [*means, f"{c['alpha'][0]:.0f}", f"{c['alpha'][upto][-1]:.0f}"]


if __name__ == "__main__":
    runs = {Path(run).name: np.genfromtxt(Path(run, "metrics.csv"), delimiter=",", names=True) for run in sys.argv[1:]}
    last = min(c["steps"][-1] for c in runs.values())
    header = ["run", *COLUMNS, "alpha at the start", "alpha"]
    print(f"At {last / 1e6:.2f} M steps:\n\n| {' | '.join(header)} |\n{'|---' * len(header)}|")
    for name, c in runs.items():
        print(f"| `{name}` | {' | '.join(row(c, last))} |")
