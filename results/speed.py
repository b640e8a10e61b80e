"""What a run costs: `python results/speed.py` measures, and writes speed.csv and speed.png beside this file.

Runs `tests/bench.py --only iteration` with 64 to 4096 environments on one core and on two, each in a process of its
own, so that memory is that of one run. Leave the machine alone meanwhile.

    python results/speed.py reach RUN...   a Markdown row for each run folder: million steps, and minutes of training,
                                           until its batch mean first passed the aims of its task
"""

import csv
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

HERE = Path(__file__).parent
BENCH = HERE.parent / "tests" / "bench.py"
NUM_ENVS = (64, 128, 256, 512, 1024, 2048, 4096)
AIMS = dict(flat=("reward", (1.2, 1.35)), rough=("reward", (0.9, 1.0)), velocity=("v_x", (1.5, 2.0)))
WINDOW = 20  # iterations, of the running mean


def measure(num_envs, cores):
    """Steps/s of PPO and of EIPO, and memory [GB] of a process that ran both, on so many cores."""
    allowed = sorted(os.sched_getaffinity(0))[:cores]
    command = [sys.executable, BENCH, "--only", "iteration", "--num-envs", str(num_envs)]
    done = subprocess.run(command, capture_output=True, text=True, check=True,
                          preexec_fn=lambda: os.sched_setaffinity(0, allowed))  # fmt: skip
    ppo, eipo = (float(x) for x in re.findall(r"(\d+) steps/s", done.stdout))
    memory = float(re.search(r"memory\s+([\d.]+)", done.stdout)[1])
    return dict(num_envs=num_envs, cores=cores, ppo=ppo, eipo=eipo, memory=memory)


def draw(rows, path):
    """Steps/s and memory over the number of environments."""
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for cores, style in ((1, "--"), (2, "-")):
        some = [row for row in rows if row["cores"] == cores]
        x = [row["num_envs"] for row in some]
        for algo, colour in (("ppo", "#0072b2"), ("eipo", "#d55e00")):
            y = [row[algo] for row in some]
            left.plot(x, y, "o" + style, color=colour, label=f"{algo.upper()}, {cores} core{'s' * (cores > 1)}")
        right.plot(x, [row["memory"] for row in some], "o" + style, color="#000000")
    left.set(ylabel="environment steps per second", ylim=(0, None))
    right.set(ylabel="memory of the process [GB]", ylim=(0, None))
    for axes in (left, right):
        axes.set_xscale("log", base=2)
        axes.set(xlabel="environments")
        axes.grid(alpha=0.3)
    left.legend(fontsize=8)
    figure.savefig(path, dpi=110)


def reach(run):
    """The Markdown row of a run."""
    rows = np.genfromtxt(run / "metrics.csv", delimiter=",", names=True)
    name, aims = AIMS[run.name.split("-")[0]]
    seconds = np.diff(rows["time_s"], prepend=0.0)
    seconds = np.where(seconds < 0, np.median(seconds), seconds).cumsum()  # a resumed run counts from 0 again
    mean = np.convolve(rows[name], np.full(WINDOW, 1 / WINDOW), "valid")
    cells = []
    for aim in aims:
        at = WINDOW - 1 + np.argmax(mean > aim)
        when = f"{rows['steps'][at] / 1e6:.2f} M, {seconds[at] / 60:.1f} min"
        cells.append(when if (mean > aim).any() else "-")
    return f"| `{run.name}` | {name} | {' | '.join(f'{aim}: {x}' for aim, x in zip(aims, cells, strict=True))} |"


if __name__ == "__main__":
    if sys.argv[1:2] == ["reach"]:
        print("\n".join(reach(Path(run)) for run in sys.argv[2:]))
    else:
        rows = [measure(num_envs, cores) for num_envs in NUM_ENVS for cores in (1, 2)]
        with open(HERE / "speed.csv", "w", newline="") as file:
            writer = csv.DictWriter(file, rows[0])
            writer.writeheader()
            writer.writerows(rows)
        draw(rows, HERE / "speed.png")
