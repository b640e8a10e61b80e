"""Figure 5 by region: `python -m lab regions results/curriculum/fig5.csv` prints the table of
that folder's README.md.

A cell has the means of task performance, of power and of the share of early ends over the commands
of a region. The last two rows count the commands at which a run performs better and draws less
power than the shaped reward.
"""

import csv

import numpy as np

REGIONS = {  # by commands of v_x [m/s] and of the yaw rate [rad/s]
    "straight ahead, 0 to 1.5 m/s": lambda x, yaw: (x >= 0) & (x <= 1.5) & (yaw == 0),
    "straight ahead, 2 to 4 m/s": lambda x, yaw: (x >= 2) & (yaw == 0),
    "backwards, 0.5 and 1 m/s": lambda x, yaw: (x < 0) & (yaw == 0),
    "0 to 1 m/s ahead, turning at 1 or 2 rad/s": lambda x, yaw: (
        (x >= 0) & (x <= 1) & (yaw >= 1) & (yaw <= 2)
    ),
    "0 to 1 m/s ahead, turning at 3 to 5 rad/s": lambda x, yaw: (x >= 0) & (x <= 1) & (yaw >= 3),
    "all": lambda x, yaw: np.full(len(x), True),
}


def table(rows, rival="PPO(0) shaped"):
    """Lines of a Markdown table from rows of fig5.csv: regions, then comparisons with the rival."""
    names = ("v_x_asked", "yaw_asked", "performance", "power", "fell")
    runs = {run: None for run in (row["run"] for row in rows)}
    for run in runs:
        runs[run] = np.array(
            [[float(row[name]) for name in names] for row in rows if row["run"] == run]
        ).T
    yield f"| commands | how many | {' | '.join(runs)} |"
    yield "|---" * (len(runs) + 2) + "|"
    for region, contains in REGIONS.items():
        inside = contains(runs[rival][0], abs(runs[rival][1]))
        means = [run[2:, inside].mean(1) for run in runs.values()]
        cells = (
            f"{performance:.2f}, {power:.0f} W, {fell:.0%}".replace("%", " %")
            for performance, power, fell in means
        )
        yield f"| {region} | {inside.sum()} | {' | '.join(cells)} |"
    for title, column, sign in (("performs better", 2, 1), ("draws less", 3, -1)):
        counts = ((sign * run[column] > sign * runs[rival][column]).sum() for run in runs.values())
        yield f"| {title} than {rival} | | {' | '.join(map(str, counts))} |"


def lines(path):
    """The lines of the table of a fig5.csv."""
    with open(path) as file:
        return [*table(list(csv.DictReader(file)))]
