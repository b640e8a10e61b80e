"""Training in numbers: `python results/table.py RUN...` prints a Markdown table, a row per run.

Batch means, exploration noise included, over the last 50 iterations at the steps of the shortest run; the share of the
episodes ended there that ended in a fall, of pi and of pi', which means of the reward hide; and alpha. The last column
is the iteration from which the running mean of 20 stays above `--above` (1.0) until then, and alpha at that iteration.
With `--after 500 1000` a run has a row for each of these iterations instead. Also reads what collect.py kept, every
tenth iteration. When a run first passed a reward: `python results/speed.py reach RUN...`.
"""

import argparse
from pathlib import Path

import numpy as np

COLUMNS = ("reward", "prime_reward", "v_x", "power", "prime_power", "gap")


def stays_above(c, above):
    """From which iteration the running mean of 20 iterations is above `above` to the end, and alpha there."""
    width = max(1, 20 // int(np.median(np.diff(c["iteration"]))))
    mean = np.convolve(c["reward"], np.full(width, 1 / width), "valid")
    below = np.flatnonzero(mean <= above)
    if len(below) == 0 or below[-1] + 1 == len(mean):
        return "from the start" if len(below) == 0 else "not yet"
    at = width + below[-1]
    return f"{c['iteration'][at]:.0f} ({c['alpha'][at]:.0f})"


def fell(c, who=""):
    """Share of the ended episodes that ended in a fall; who: "" for pi, "prime_" for pi'."""
    ends = {name: c[name].sum() for name in c.dtype.names if name.startswith(f"{who}ended_")}
    return f"{ends[f'{who}ended_fall'] / max(1, sum(ends.values())):.0%}" if ends else ""


def row(c, above):
    """The cells of a run up to the last of its columns c."""
    recent = c[c["iteration"] > c["iteration"][-1] - 50]
    means = [f"{recent[name].mean():.4g}" if name in c.dtype.names else "" for name in COLUMNS]
    area = f"{c['command_area'][-1]:.4f}" if "command_area" in c.dtype.names else ""
    falls = [fell(recent), fell(recent, "prime_")]
    return [f"{c['iteration'][-1]:.0f}", *means, *falls, f"{c['alpha'][-1]:.0f}", area, stays_above(c, above)]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--after", nargs="+", type=int, metavar="ITERATION", default=[])
    parser.add_argument("--above", type=float, default=1.0)
    args = parser.parse_args()
    if missing := [str(run) for run in args.runs if not (run / "metrics.csv").exists()]:
        parser.error(f"no metrics.csv in {', '.join(missing)}: give the folders of runs")
    runs = {run.name: np.genfromtxt(run / "metrics.csv", delimiter=",", names=True) for run in args.runs}
    last = min(c["steps"][-1] for c in runs.values())
    header = ["run", "after iteration", *COLUMNS, "fell", "pi' fell", "alpha", "commands", f"stays above {args.above}"]
    print(f"| {' | '.join(header)} |\n{'|---' * len(header)}|")
    for name, c in runs.items():
        upto = [c["iteration"] <= x for x in args.after] or [c["steps"] <= last]
        for rows in (c[x] for x in upto if x.any()):
            print(f"| `{name}` | {' | '.join(row(rows, args.above))} |")
