"""The paper's Figures 2 to 6 and Table I from our own runs, on the simulator that trained them.

    python evaluate.py RUN...                    a line per run folder: task performance, falls, speed, power
    python evaluate.py fig2 RUN... --out DIR     fig2.png, and fig2.csv with its numbers; also fig3 to fig6 and table1
    python evaluate.py --commands table1         the train.py command of every run that table1 still lacks

How policies are measured is in `measure.py`.
"""

import argparse
import csv
import shlex
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import measure
import run_folder
import train

LAMBDAS = (0, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2)  # Eq. (10)
TABLE1 = dict(zip(("EIPO", *(f"PPO({lam:g})" for lam in LAMBDAS)),
                  (2.86, 2.12, 1.55, 1.49, 1.58, 1.64, 1.58, 1.62, 1.45, 1.37), strict=True))  # m/s  # fmt: skip
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#7F7F7F", "#8C6D31", "#BCBD22")
ROUGHNESS = {"rough": 0.15}  # m, of the ground on which a task is evaluated, if it is not that of training [V-B]
FORWARD = np.array([(x / 10, 0.0, 0.0) for x in range(11)])  # m/s, commands of Figs. 2 to 4


def by_label(folders, task):
    """Run folders of one task by what they are called in a figure: {"EIPO": [folder of a seed, ...], "PPO(0)": ...}."""
    groups = {}
    for folder in folders:
        env_config, learner = run_folder.load_config(Path(folder))
        if env_config.task == task:
            name = "EIPO" if learner.algo == "eipo" else f"PPO({learner.lam:g})"
            seeds = groups.setdefault(name, {})
            if learner.seed in seeds:
                raise ValueError(
                    f"{folder} and {seeds[learner.seed]} are both {name} with seed {learner.seed}: give one"
                )
            seeds[learner.seed] = folder
    if not groups:
        raise ValueError(f"none of the run folders is of the task {task}")
    order = sorted(groups, key=lambda name: list(TABLE1).index(name) if name in TABLE1 else len(TABLE1))
    return {name: list(groups[name].values()) for name in order}


def by_command(folders, task, commands, columns, args):
    """Rows of a CSV: for each kind of run and each command, IQM and intervals of the named columns of Episodes.

    commands: (n, 3); every run plays about args.episodes episodes, equally many of each command
    """
    each = max(1, args.episodes // len(commands))
    roughness = ROUGHNESS.get(task) if args.roughness is None else args.roughness
    rows = []
    for name, runs in by_label(folders, task).items():
        loaded = [measure.load(folder, each * len(commands), args.clip, roughness) for folder in runs]
        played = [measure.run_episodes(*policy_env, np.repeat(commands, each, 0)) for policy_env in loaded]
        for i, command in enumerate(commands):
            row = dict(task=task, run=name, v_x_asked=command[0], yaw_asked=command[2], seeds=len(runs), episodes=each)
            for column in columns:
                row |= measure.summarise(column, [getattr(e, column)[i * each : (i + 1) * each] for e in played])
            rows.append(row)
    return rows


def draw_lines(axes, rows, x, column, title):
    """A line for each kind of run, with the interval of the pooled episodes as a band."""
    names = list(dict.fromkeys(row["run"] for row in rows))
    for name in names:
        mine = [row for row in rows if row["run"] == name]
        at, y, low, high = (
            np.array([row[c] for row in mine], float) for c in (x, column, f"{column}_low", f"{column}_high")
        )
        color = COLORS[list(TABLE1).index(name) % len(COLORS)] if name in TABLE1 else COLORS[-1]
        axes.plot(at, y, color=color, label=name, marker="o", markersize=3, linewidth=2 if name == "EIPO" else 1.2)
        axes.fill_between(at, low, high, color=color, alpha=0.2, linewidth=0)
    axes.set(title=title, xlabel="command v_x [m/s]")
    axes.grid(alpha=0.3)


def draw_panels(rows, panels):
    """A figure of one panel for each (rows' filter, column, title) of panels."""
    figure = Figure(figsize=(5 * len(panels), 3.6), layout="constrained")
    for axes, (task, column, title) in zip(figure.subplots(1, len(panels), squeeze=False).flat, panels, strict=True):
        draw_lines(axes, [row for row in rows if row["task"] == task], "v_x_asked", column, title)
    figure.axes[0].legend(fontsize=8)
    return figure


def fig2(folders, args):
    """Task performance and energy per velocity on flat ground, by command. Section V-A."""
    rows = by_command(folders, "flat", FORWARD, ("performance", "energy"), args)
    return rows, draw_panels(rows, [("flat", "performance", "task performance"), ("flat", "energy", "energy [J/m]")])


def fig3(folders, args):
    """The same on rough ground of 15 cm. Section V-B."""
    rows = by_command(folders, "rough", FORWARD, ("performance", "energy"), args)
    return rows, draw_panels(rows, [("rough", "performance", "task performance"), ("rough", "energy", "energy [J/m]")])


def fig4(folders, args):
    """Task performance of every lambda on flat and on rough ground, as far as there are runs. Section V-C."""
    present = {run_folder.load_config(Path(folder))[0].task for folder in folders} & {"flat", "rough"}
    rows = []
    for task in sorted(present):
        rows += by_command(folders, task, FORWARD, ("performance",), args)
    return rows, draw_panels(rows, [(task, "performance", f"task performance, {task}") for task in sorted(present)])


def fig5(folders, args):
    """Task reward and energy over commands of v_x and yaw rate. Section V-E."""
    task = run_folder.load_config(Path(folders[0]))[0].task
    commands = np.array([(x, 0.0, yaw) for x in np.linspace(-1, 4, 11) for yaw in np.linspace(-5, 5, 11)])
    rows = by_command(folders, task, commands, ("performance", "power"), args)
    names = list(dict.fromkeys(row["run"] for row in rows))
    figure = Figure(figsize=(3.2 * len(names) + 1, 5.6), layout="constrained")
    panels = figure.subplots(2, len(names), squeeze=False, sharex=True, sharey=True)
    for i, column in enumerate(("performance", "power")):
        values = np.array([[row[column] for row in rows if row["run"] == name] for name in names]).reshape(-1, 11, 11)
        for axes, name, value in zip(panels[i], names, values, strict=True):
            image = axes.pcolormesh(commands[:11, 2], commands[::11, 0], value, vmin=values.min(), vmax=values.max())
            axes.set(title=f"{name}: {'task performance' if column == 'performance' else 'power [W]'}")
        figure.colorbar(image, ax=panels[i])
    figure.supxlabel("command yaw rate [rad/s]")
    figure.supylabel("command v_x [m/s]")
    return rows, figure


def fig6(folders, args):
    """Velocity over time, from standing. Section VI; the paper's is of the hardware, this of the simulation."""
    rows = []
    for name, runs in by_label(folders, "velocity").items():
        series = []
        for folder in runs:
            played = measure.steps(*measure.load(folder, args.episodes, args.clip, args.roughness))
            series.append([np.where(alive, log["v_x"], np.nan) for _, log, alive, _ in played][4::10])
        rows += [dict(task="velocity", run=name, time=0.1 + 0.2 * i, seeds=len(runs), episodes=args.episodes)
                 | measure.summarise("v_x", at) for i, at in enumerate(zip(*series, strict=True))]  # fmt: skip
    figure = Figure(figsize=(5, 3.6), layout="constrained")
    draw_lines(axes := figure.subplots(), rows, "time", "v_x", "body velocity [m/s]")
    axes.set(xlabel="time [s]")
    axes.legend(fontsize=8)
    return rows, figure


def table1(folders, args):
    """Peak velocity of every lambda, beside what the paper prints. Table I."""
    rows = by_command(folders, "velocity", np.zeros((1, 3)), ("peak", "peak_mean", "v_x", "v_x_late", "power"), args)
    rows = [row | dict(paper=TABLE1.get(row["run"], np.nan)) for row in rows]
    at, figure = np.arange(len(rows))[::-1], Figure(figsize=(5, 0.4 * len(rows) + 1.2), layout="constrained")
    axes = figure.subplots()
    y, low, high, paper = (np.array([row[c] for row in rows]) for c in ("peak", "peak_low", "peak_high", "paper"))
    axes.errorbar(y, at, xerr=np.nan_to_num([y - low, high - y]), fmt="o", color=COLORS[0], capsize=3, label="ours")
    axes.plot(paper, at, "D", markerfacecolor="none", color=COLORS[1], label="the paper's Table I")
    axes.set(
        yticks=at, yticklabels=[row["run"] for row in rows], xlabel="peak velocity [m/s]", ylim=(-0.5, len(rows) - 0.5)
    )
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    return rows, figure


FIGURES = {f.__name__: f for f in (fig2, fig3, fig4, fig5, fig6, table1)}
EVERY, TUNED = ((None, *LAMBDAS), (None, 0.005, 0))  # None is EIPO
SWEEPS = dict(fig2=[("flat", TUNED)], fig3=[("rough", TUNED)], fig4=[("flat", EVERY), ("rough", EVERY)],
              table1=[("velocity", EVERY)], fig6=[("velocity", (None, 0.01))])  # fmt: skip


def commands(what, flags):
    """The train.py commands that a figure or the table still lacks, three seeds each; flags: to be added to each."""
    if what not in SWEEPS:
        raise ValueError(f"--commands takes one of {', '.join(SWEEPS)}, and flags of train.py")
    for task, lambdas in SWEEPS[what]:
        for lam in lambdas:
            for seed in range(3):
                algo = ["--algo", "eipo"] if lam is None else ["--algo", "ppo", "--lam", f"{lam:g}"]
                argv = ["--task", task, *algo, "--seed", str(seed), *flags]
                if (so_far := progress(argv)) != "done":
                    yield shlex.join(["python", "train.py", *argv, *(["--resume"] if so_far else [])])


def progress(argv):
    """How far the run of these train.py arguments is: "", "started" or "done"."""
    options, given_env, given_learner = train.parse(argv)
    env_config, config = train.settle(given_env, given_learner)
    folder = train.run_path(train.Options(**options), env_config, config)
    if not (folder / "checkpoint.npz").exists():
        return ""
    return "done" if len((folder / "metrics.csv").read_text().splitlines()) > config.iterations else "started"


def save(out, what, rows, figure):
    """Write what.csv and what.png into the folder out."""
    out.mkdir(parents=True, exist_ok=True)
    with open(out / f"{what}.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, rows[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows({k: f"{x:.5g}" if isinstance(x, float) else x for k, x in row.items()} for row in rows)
    figure.savefig(out / f"{what}.png", dpi=150)
    print(f"{out / what}.csv and .png")


def print_table(folders, args):
    """A row of a Markdown table for each run folder."""
    print("| run | task performance | fell | v_x [m/s] | power [W] | energy [J/m] |\n|---|---|---|---|---|---|")
    for folder in folders:
        e = measure.run_episodes(*measure.load(folder, args.episodes, args.clip, args.roughness))
        print(f"| {folder} | {e.performance.mean():.3f} | {100 * e.fell.mean():.1f} % | {e.v_x.mean():.3f} "
              f"| {e.power.mean():.1f} | {e.power.mean() / e.v_x.mean():.0f} |", flush=True)  # fmt: skip


def main(argv):
    """Evaluate, draw or list; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="*", help=f"run folders, after one of {', '.join(FIGURES)} if that is wanted")
    parser.add_argument("--commands", nargs=argparse.REMAINDER, metavar="FIGURE [FLAG ...]",
                        help="print the train.py commands that a figure or table1 lacks, with those flags")  # fmt: skip
    parser.add_argument("--out", default=".", type=Path, help="folder for the PNG and the CSV (default: here)")
    parser.add_argument("--episodes", type=int, default=1000, help="episodes per run (default: 1000)")
    parser.add_argument("--clip", choices=("torque", "power"), help="what Eq. (9) clips (default: as in training, D3)")
    parser.add_argument(
        "--roughness", type=float, help="m, of the ground (default: as in training, but 0.15 for figures of rough)"
    )
    args = parser.parse_args(argv)
    try:
        if args.commands is not None:
            print(*commands("".join(args.commands[:1]), args.commands[1:]), sep="\n")
        elif args.runs and args.runs[0] in FIGURES:
            what, *folders = args.runs
            if not folders:
                raise ValueError(f"{what} of which runs? Give run folders")
            save(args.out, what, *FIGURES[what](folders, args))
        elif args.runs:
            print_table(args.runs, args)
        else:
            parser.print_help()
    except (ValueError, OSError) as error:
        print(f"evaluate.py: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
