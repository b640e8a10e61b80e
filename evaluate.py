"""The paper's Figures 2 to 6 and Table I from our own runs, in the simulator that trained them.

    python evaluate.py RUN...                    a line per run folder: task performance, falls, speed, power
    python evaluate.py fig2 RUN... --out DIR     fig2.png, and fig2.csv with its numbers; also fig3 to fig6 and table1
    python evaluate.py pareto RUN... --out DIR   speed against energy per metre on `velocity`, seed by seed
    python evaluate.py seeds RUN... --out DIR    how soon and how well the runs of one task learned, seed by seed
    python evaluate.py gait RUN... --out DIR     how each run's robot moves its feet; joints: and what its joints do
    python evaluate.py robust RUN... --out DIR   what each run loses where masses, friction, delays leave its training
    python evaluate.py --commands table1         the train.py command of every run that table1 still lacks

How policies are measured is in `measure.py`, and which runs a figure needs in `studies/sweep.py`.
"""

import argparse
import csv
import io
import os
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

if __name__ == "__main__":
    os.environ["MUJOCO_GL"] = "off"  # no robot is drawn, so what MuJoCo would draw with need not work

import measure
from runtime import run_folder
from studies import adopt, episodes, gait, joints, robust, seeds, statistics, sweep

TABLE1 = dict(zip(sweep.KINDS, ((2.86, 2.84, 2.89), (2.12, 2.12, 2.12), (1.55, 1.53, 1.56), (1.49, 1.48, 1.50),
                          (1.58, 1.57, 1.60), (1.64, 1.63, 1.65), (1.58, 1.55, 1.60), (1.62, 1.61, 1.62),
                          (1.45, 1.45, 1.46), (1.37, 1.37, 1.37)), strict=True))  # m/s, Table I  # fmt: skip
HARDWARE = (2.5, 1.5)  # m/s, peaks of EIPO and of PPO(0.01) on the real robot, Section VI (D45)


def by_command(folders, task, commands, columns, args, statistic=np.mean):
    """Rows of a CSV, one for each kind of run and each command: a statistic of columns of Episodes, with intervals.

    commands: (n, 3). Every run plays about args.episodes episodes, equally many of each command. Columns that end in
    _nominal are means of as many episodes that start from the nominal pose. All others are of random starts.
    """
    each = max(1, args.episodes // len(commands))
    rows = []
    for name, runs in sweep.by_label(folders, task).items():
        both = [episodes.both_starts(folder, task, commands, each, args) for folder in runs]
        played, nominal = zip(*both, strict=True)
        for i, command in enumerate(commands):
            mine = slice(i * each, (i + 1) * each)
            row = dict(task=task, run=name, v_x_asked=command[0], yaw_asked=command[2], seeds=len(runs), episodes=each)
            row |= dict(fell=np.mean([e.fell[mine] for e in played]))
            row |= dict(fell_nominal=np.mean([e.fell[mine] for e in nominal]))
            for column in columns:
                row |= statistics.summarise(column, [getattr(e, column)[mine] for e in played], statistic)
                row[f"{column}_nominal"] = statistics.finite_mean([getattr(e, column)[mine] for e in nominal])
            rows.append(row)
    return rows


def draw_lines(axes, rows, x, column):
    """Draw a line for each kind of run: means (D26), in their intervals over episodes and, lighter, over seeds."""
    names = list(dict.fromkeys(row["run"] for row in rows))
    for i, name in enumerate(names):
        mine = [row for row in rows if row["run"] == name]
        at, y = (np.array([row[c] for row in mine], float) for c in (x, column))
        color, alpha = sweep.color(name), 0.25 if len(names) < 4 else 0.1
        style = dict(linewidth=2.5, marker="o") if name == "EIPO" else dict(linewidth=1.2, marker="sv^D<>px*"[i % 9])
        axes.plot(at, y, color=color, label=name, markersize=4, markevery=max(1, len(at) // 10), **style)
        for over, shade in (("", alpha), ("_seeds", alpha / 2)):
            low, high = (np.array([row[f"{column}{over}_{end}"] for row in mine], float) for end in ("low", "high"))
            axes.fill_between(at, low, high, color=color, alpha=shade, linewidth=0)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=7)


def draw_panels(rows, panels):
    """A Figure with a panel over the command v_x for each (task, column, label of the y axis)."""
    figure = Figure(figsize=(5 * len(panels), 3.6), layout="constrained")
    for axes, (task, column, title) in zip(figure.subplots(1, len(panels), squeeze=False).flat, panels, strict=True):
        draw_lines(axes, [row for row in rows if row["task"] == task], "v_x_asked", column)
        axes.set(xlabel="command v_x [m/s]", ylabel=title, title=f"{task} ground")
        if column == "energy":
            axes.set_yscale("log")  # because a robot that is asked to stand spends much per metre
    return figure


def fig2(folders, args, task="flat"):
    """Task performance and energy per velocity (D27) on flat ground, by command. Section V-A."""
    rows = by_command(folders, task, measure.FORWARD, ("performance", "energy"), args)
    return rows, draw_panels(rows, [(task, "performance", "task performance"), (task, "energy", "energy [J/m]")])


def fig3(folders, args):
    """Task performance and energy per velocity on rough ground of 15 cm, by command. Section V-B."""
    return fig2(folders, args, "rough")


def fig4(folders, args):
    """Task performance of every lambda on flat and on rough ground, or on one of them if only it has runs. V-C."""
    tasks = {run_folder.load_config(Path(folder))[0].task for folder in folders}
    if not (tasks := [task for task in ("flat", "rough") if task in tasks]):
        raise ValueError("none of the run folders is of the task flat or rough")
    rows = [row for task in tasks for row in by_command(folders, task, measure.FORWARD, ("performance",), args)]
    return rows, draw_panels(rows, [(task, "performance", "task performance") for task in tasks])


def fig5(folders, args):
    """Task performance and power over commands of v_x and yaw rate. Section V-E."""
    commands = np.array([(x, 0.0, yaw) for x in np.linspace(-1, 4, 11) for yaw in np.linspace(-5, 5, 11)])
    rows = by_command(folders, "curriculum", commands, ("performance", "power"), args)
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
    """Mean velocity over time of the robots that have not fallen yet. Dotted: the paper's hardware (D45). Section VI.

    Each point is a mean over about a period of the clock, which smooths the strides.
    """
    rows = []
    for name, runs in sweep.by_label(folders, "velocity").items():
        series = []
        for folder in runs:
            policy, env = measure.load(folder, args.episodes, args.clip, args.roughness, robot=args.robot)
            played = measure.steps(policy, env)
            v_x = np.array([np.where(alive, log["v_x"], np.nan) for _, log, alive, _ in played])
            strides = max(1, int(len(v_x) * env.period * env.env_cfg.clock_hz))
            series.append([stride.mean(0) for stride in np.array_split(v_x, strides)])
        time = [env.period * stride.mean() for stride in np.array_split(np.arange(len(v_x)) + 0.5, strides)]
        rows += [dict(task="velocity", run=name, time=t, seeds=len(runs), episodes=args.episodes)
                 | statistics.summarise("v_x", at) for t, *at in zip(time, *series, strict=True)]  # fmt: skip
    figure = Figure(figsize=(5, 3.6), layout="constrained")
    draw_lines(axes := figure.subplots(), rows, "time", "v_x")
    for peak in HARDWARE:
        axes.axhline(peak, color="black", linestyle=":", linewidth=1)
    axes.set(xlabel="time [s]", ylabel="speed ahead [m/s]")
    return rows, figure


def table1(folders, args):
    """Peak velocity of every lambda as an interquartile mean, both intervals, beside what the paper prints. Table I."""
    columns = "peak", "peak_sustained", "v_x", "v_x_late", "power", "energy"
    rows = by_command(folders, "velocity", np.zeros((1, 3)), columns, args, statistics.iqm)  # D26
    for row in rows:
        printed = TABLE1.get(row["run"].split(",")[0], [np.nan] * 3)
        row |= zip(("paper", "paper_low", "paper_high"), printed, strict=True)
    at, figure = np.arange(len(rows))[::-1], Figure(figsize=(5, 0.4 * len(rows) + 1.2), layout="constrained")
    axes = figure.subplots()
    seeds_low, seeds_high = (np.array([row[f"peak_seeds_{end}"] for row in rows]) for end in ("low", "high"))
    axes.hlines(at, seeds_low, seeds_high, color="#0072B2", alpha=0.3, linewidth=5, label="ours, over seeds")
    ours = dict(label="ours", fmt="o", color="#0072B2")
    printed = dict(label="the paper's", fmt="D", color="#D55E00", markerfacecolor="none")
    for name, style in (("peak", ours), ("paper", printed)):
        mean, low, high = (np.array([row[c] for row in rows]) for c in (name, f"{name}_low", f"{name}_high"))
        axes.errorbar(mean, at, xerr=np.nan_to_num([mean - low, high - mean]), capsize=3, **style)
    axes.set(yticks=at, yticklabels=[row["run"] for row in rows], xlabel="peak velocity [m/s]")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside upper center", ncols=3, fontsize=8)
    return rows, figure


FIGURES = {
    f.__name__: f
    for f in (fig2, fig3, fig4, fig5, fig6, table1, seeds.pareto, seeds.seeds, gait.gait, joints.joints, robust.robust)
}
BATCHES = dict(fig6=1, robust=robust.BATCHES, gait=0, joints=0)  # of whole episodes for each run, where it is not 2


def run_folders(paths):
    """The run folders among paths. Others are named on stderr. ValueError if one does not exist, or if none is left."""
    paths, files = [Path(path) for path in paths], ("policy.npz", run_folder.EPISODES)
    if missing := [str(path) for path in paths if not path.exists()]:
        raise ValueError(f"{missing[0]} does not exist: give run folders, after one of {', '.join(FIGURES)} if wanted")
    folders = [x for x in paths if (x / "config.json").exists() and any((x / name).exists() for name in files)]
    others = ", ".join(str(path) for path in paths if path not in folders)
    if not folders:
        raise ValueError(f"nothing to evaluate: there is no run folder with a config.json and a policy.npz in {others}")
    if others:
        print(f"evaluate.py: left out, without a config.json or a policy.npz: {others}", file=sys.stderr)
    return folders


@contextmanager
def show_progress(batches):
    """Meanwhile a terminal shows how much of so many batches of episodes is played, and how long the rest will take."""
    start, done, left = time.monotonic(), 0, batches * measure.EPISODE_STEPS

    def watch(played):
        nonlocal done, left
        done, left = done + played, left - (1 if played else measure.EPISODE_STEPS)
        minutes = (time.monotonic() - start) / max(done, 1) * left / 60
        text = f"{done / (done + left):.0%} played, {minutes:.0f} min left" if left > 0 < done else ""
        print(f"{text}\x1b[K", end="\r", file=sys.stderr, flush=True)

    measure.watchers[:] = [watch] if batches and sys.stderr.isatty() else []
    try:
        yield
    finally:
        print("\x1b[K" * len(measure.watchers), end="", file=sys.stderr, flush=True)
        measure.watchers.clear()


def save(out, what, rows, figure):
    """Write what.csv and what.png into the folder out: both, or if that fails neither."""
    text, image = io.StringIO(newline=""), io.BytesIO()
    writer = csv.DictWriter(text, dict.fromkeys(name for row in rows for name in row), lineterminator="\n")
    writer.writeheader()
    writer.writerows({k: f"{x:.5g}" if isinstance(x, float) else x for k, x in row.items()} for row in rows)
    figure.savefig(image, dpi=150, format="png")

    def write(file):  # the PNG takes its place once the CSV is written, and before it takes its own
        file.write(text.getvalue().encode())
        file.flush()
        run_folder.replace_file(out / f"{what}.png", lambda png: png.write(image.getvalue()))

    run_folder.replace_file(out / f"{what}.csv", write)
    print(f"{out / what}.csv and .png")


def draw(what, folders, args):
    """Make a figure. Whether it and the runs can be written is tried before anything is played."""
    if args.out and len({folder.name for folder in folders}) < len(folders):
        raise ValueError(f"two run folders have the same name, under which {args.out} would keep both: rename one")
    out = args.out or Path()
    out.mkdir(parents=True, exist_ok=True)
    for suffix in ("csv", "png"):
        run_folder.check_writable(out / f"{what}.{suffix}")
    save(out, what, *FIGURES[what](folders, args))
    if args.out:
        sweep.keep_runs(out, folders)


def print_table(folders, args):
    """The `seeds.overview` of each run folder: a row of a Markdown table, with a new head where the columns change."""
    head = None
    for folder in folders:
        row = seeds.overview(folder, args)
        if list(row) != head:
            head = list(row)
            print("|", " | ".join(map(seeds.with_unit, head)), "|\n" + "|---" * len(head) + "|")
        print("|", " | ".join(f"{x:.4g}" if isinstance(x, float) else str(x) for x in row.values()), "|", flush=True)


def main(argv):
    """Evaluate, draw or list; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.error = lambda message: parser.exit(2, f"evaluate.py: {message} (-h lists every flag)\n")
    parser.add_argument("runs", nargs="*", help=f"run folders, after one of {', '.join(FIGURES)} if that is wanted")
    parser.add_argument("--commands", metavar="FIGURE [FLAG ...]",
                        help="print the train.py commands that a figure or table1 lacks, with those flags")  # fmt: skip
    parser.add_argument("--command", type=float, nargs="+", metavar="VX", help="m/s, that gait and joints ask for")
    parser.add_argument("--out", type=Path, help="folder for PNG, CSV and what to keep of the runs (default: here)")
    parser.add_argument("--episodes", type=int, default=1000, help="episodes per run (default: 1000)")
    parser.add_argument("--clip", choices=("torque", "power"), help="what Eq. (9) clips (default: as in training, D3)")
    parser.add_argument("--roughness", type=float, help="m (default: that of training; figures of rough: 0.15)")
    parser.add_argument("--model", metavar="FILE.xml", help="another MJCF of a Go1 (studies/adopt.py)")
    try:
        if argv[:1] == ["--commands"]:
            print(*sweep.missing_runs("".join(argv[1:2]), argv[2:]), sep="\n")
            return 0
        args = parser.parse_intermixed_args(argv)
        if not 1 <= args.episodes <= 50_000:
            raise ValueError(f"--episodes is {args.episodes}: it must be from 1 to 50000")
        if args.commands or not args.runs:
            raise ValueError("give run folders, or a figure and run folders, or --commands first and then a figure")
        args.robot = args.model and adopt.read_robot(args.model)
        what, *paths = args.runs if args.runs[0] in FIGURES else ("", *args.runs)
        if not paths:
            raise ValueError(f"{what} of which runs? Give run folders")
        if args.command and what not in ("gait", "joints"):
            raise ValueError("--command is for gait and joints: give one of them before the run folders")
        folders, tasks = run_folders(paths), {task for task, _ in sweep.SWEEPS.get(what, ())}
        played = [x for x in folders if not tasks or run_folder.load_config(x)[0].task in tasks]
        with show_progress(len(played) * BATCHES.get(what, 2)):
            draw(what, folders, args) if what else print_table(folders, args)
    except KeyboardInterrupt:
        return 130
    except (ValueError, OSError) as error:
        print(f"evaluate.py: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
