"""`python -m lab NAME ...`: what we asked of trained robots, beyond training and evaluating them.

RUN is a run folder, or results/TASK for all runs there that train.py named, or 'results/TASK/NAME',
where NAME may have * ? and [...].
"""

import argparse
import os
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

if __name__ == "__main__" and sys.argv[1:2] != ["play"]:
    os.environ["MUJOCO_GL"] = "off"  # no robot is drawn

import evaluate
import go1_env
from lab import (
    adopt,
    claims,
    episodes,
    figures,
    gait,
    gap,
    objective,
    overview,
    readings,
    record,
    regions,
    robust,
)
from lab import sweep as sweeps
from runtime import run_folder

FIGURES = {
    "fig2": (figures.fig2, "task performance and J/m by command, flat ground"),
    "fig3": (figures.fig3, "the same on rough ground of 15 cm"),
    "fig4": (figures.fig4, "task performance of every lambda on flat and rough ground"),
    "fig5": (figures.fig5, "task performance and power over commands of v_x and yaw rate"),
    "fig6": (figures.fig6, "speed over time on velocity"),
    "table1": (figures.table1, "peak velocity of every lambda beside what the paper prints"),
    "tradeoff": (overview.tradeoff, "score over power of all runs, a dot for each seed"),
    "lambdas": (overview.lambdas, "score, power and the last alpha over lambda"),
    "gait": (gait.gait, "how each run's robot moves its feet"),
    "robust": (robust.robust, "what is lost where masses, friction, delays leave training"),
}
OTHERS = {
    "add": "RUN...: put runs into the tables of results/; --results DIR for others",
    "table": "RUN...: a line for each run, as evaluate.py prints it, from kept episodes",
    "claims": "the paper's claims, each with a difference over seeds and a verdict by rule",
    "missing": "FIGURE [FLAG ...]: train.py commands of the runs that a figure still lacks",
    "readings": "READING [FLAG ...]: train.py with another reading of the paper",
    "gap": "RUN...: pi beside pi' with exploration noise and without, from a checkpoint",
    "objective": "RUN...: which policy on velocity Eq. (2) prefers at each lambda",
    "regions": "FIG5.csv: Figure 5 by region, as a table",
    "play": "RUN --model FILE.xml ...: play.py with another MJCF of a Go1",
}


def usage():
    """What `-h` prints."""
    about = {name: about for name, (_, about) in FIGURES.items()}
    lines = [f"  {name:<10} {text}" for name, text in about.items()]
    return "\n".join(
        [
            __doc__,
            "figures, python -m lab NAME RUN... [--out DIR], a PNG and a CSV:",
            *lines,
            "",
            "others:",
            *(f"  {name:<10} {text}" for name, text in OTHERS.items()),
        ]
    )


def parse(name, argv):
    """The arguments of a figure or of the table."""
    parser = argparse.ArgumentParser(prog=f"lab {name}", description=FIGURES.get(name, ("", ""))[1])
    parser.error = lambda message: parser.exit(2, f"lab: {message} (-h lists every flag)\n")
    parser.add_argument(
        "runs", nargs="+", help="run folders, or results/TASK, or results/TASK/NAME"
    )
    parser.add_argument("--out", type=Path, default=Path(), help="folder of PNG and CSV")
    if name == "gait":
        parser.add_argument("--command", type=float, nargs="+", metavar="VX", help="m/s")
    parser.add_argument("--model", metavar="FILE.xml", help="another MJCF of a Go1 (lab/adopt.py)")
    evaluate.add_flags(parser)
    args = parser.parse_intermixed_args(argv)
    evaluate.check_flags(args)
    args.robot = None if args.model is None else adopt.read_robot(args.model)
    args.world = adopt.world(args.robot) if args.robot else go1_env.Go1Env
    return args


def run_folders(paths, into):
    """The run folders of paths. What results/ has is made a folder, in the folder `into`."""
    found, others = [], []
    for path in map(Path, paths):
        tables = [place / record.RUNS for place in (path, path.parent)]
        tables = [table for table in tables if table.exists()]
        if path.is_file() or (path / "config.json").exists() or not tables:
            others.append(path)
        elif taken := [*record.take_out(path, into)]:
            found += taken
        else:
            raise ValueError(f"{tables[0]} has no run {path.name}")
    files = "policy.npz", run_folder.EPISODES
    return found + (evaluate.run_folders(others, files) if others else [])


def draw(name, argv):
    """Make a figure."""
    args = parse(name, argv)
    args.out.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as into:
        figures.save(args.out, name, *FIGURES[name][0](run_folders(args.runs, into), args))


def add(argv):
    """Put runs into the tables of results/, or of another folder."""
    parser = argparse.ArgumentParser(prog="lab add", description=record.__doc__.split("\n\n")[0])
    parser.error = lambda message: parser.exit(2, f"lab: {message} (-h lists every flag)\n")
    parser.add_argument("runs", nargs="+", type=Path, help="run folders")
    parser.add_argument("--results", type=Path, help="folder of the tables (default: results)")
    args = parser.parse_args(argv)
    record.add(args.runs, args.results)


def other(name, argv):
    """What is no figure; returns the exit status, or None."""
    if name == "missing":
        print(*sweeps.missing_runs("".join(argv[:1]), argv[1:]), sep="\n")
    elif name == "readings":
        return readings.main("".join(argv[:1]), argv[1:])
    elif name == "add":
        add(argv)
    elif name == "claims":
        print(*claims.table(*argv[:1]), sep="\n")
    elif name == "regions":
        print(*regions.lines("".join(argv[:1])), sep="\n")
    elif name == "play":
        return adopt.play(argv)
    else:
        args = parse(name, argv)
        with TemporaryDirectory() as into:
            folders = run_folders(args.runs, into)
            if name == "gap":
                evaluate.print_rows(map(gap.row, folders))
            elif name == "objective":
                print(*objective.lines(folders), sep="\n")
            else:
                evaluate.print_rows(episodes.overview(folder, args) for folder in folders)


def main(argv):
    """Run one of the names; returns the exit status."""
    name = "".join(argv[:1])
    if name in ("", "-h", "--help"):
        print(usage())
        return 0 if name else 2
    try:
        if name in FIGURES:
            return draw(name, argv[1:]) or 0
        if name in OTHERS:
            return other(name, argv[1:]) or 0
        raise ValueError(f"there is no {name}: choose one of {', '.join([*FIGURES, *OTHERS])}")
    except KeyboardInterrupt:
        return 130
    except (ValueError, OSError) as error:
        print(f"lab: {' '.join(str(error).split())}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
