"""`python -m lab NAME ...`: figures and tables of trained robots. NAME is one of

    a figure  RUN...   fig2 fig3 fig4 fig5 fig6 table1 tradeoff lambdas, as PNG and CSV in --out
    footfalls FOLDER   which foot of a policy.npz is on the ground when, a robot each --command
    table     RUN...   a line for each kind of run
    claims             the paper's claims of runs in --results, each with a verdict by rule
    promise            pi beside the pi' of its own run, as a table, PNG and CSV
    sweep     FIGURE [FLAG...]  the train.py commands of a figure's runs, one for each of --seeds
    add       FOLDER...  play the policies of run folders and put them into the tables of --results

RUN is results/TASK for all runs there that train.py named, or 'results/TASK/NAME', in which NAME
may have * ? and [...]. Other runs are first put into tables of their own, by add.
"""

import argparse
import os
import sys
from pathlib import Path

if __name__ == "__main__":
    os.environ["MUJOCO_GL"] = "off"  # no robot is drawn

from lab import claims, figures, footfalls, promise, record, sweep

FIGURES = "fig2", "fig3", "fig4", "fig5", "fig6", "table1", "tradeoff", "lambdas"
OTHERS = "footfalls", "table", "claims", "promise", "sweep", "add"


def parse(argv):
    """The arguments of the command line, and the flags that `sweep` hands on to train.py."""
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        "python -m lab", description=__doc__, formatter_class=form, allow_abbrev=False
    )
    parser.error = lambda message: parser.exit(2, f"lab: {message} (-h lists every flag)\n")
    parser.add_argument("name", choices=[*FIGURES, *OTHERS], metavar="NAME")
    parser.add_argument("what", nargs="*", help="runs, folders or a figure, as NAME takes them")
    parser.add_argument("--out", type=Path, default=Path(), help="folder for PNG and CSV")
    parser.add_argument("--results", type=Path, default=record.RESULTS, help="folder of the tables")
    parser.add_argument("--episodes", type=int, help="to play, per policy and kind of start")
    parser.add_argument(
        "--command", type=float, nargs="+", default=[0.3, 0.6, 1.0], help="m/s of v_x"
    )
    parser.add_argument("--commit", default="", help="that claims and promise are of")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2], help="of sweep")
    args, flags = parser.parse_known_args(argv)
    if flags and args.name != "sweep":
        parser.error(f"unrecognized arguments: {' '.join(flags)}")
    if not args.what and args.name not in ("claims", "promise"):
        parser.error(f"{args.name} takes at least one argument")
    return args, flags


def run(args, flags):
    """Do what the command line says."""
    if args.name in FIGURES:
        rows, figure = getattr(figures, args.name)(record.runs(args.what))
        figures.save(args.out, args.name, figure, rows)
        if args.name == "fig5":
            print(*figures.regions(rows), sep="\n")
    elif args.name == "promise":
        arms = claims.counted(args.results, args.commit)
        rows, figure = promise.promise(arms)
        figures.save(args.out, args.name, figure, rows)
        print(*promise.lines(arms), sep="\n")
    elif args.name == "footfalls":
        figures.save(args.out, args.name, footfalls.footfalls(args.what[0], args.command))
    elif args.name == "table":
        print(*claims.table(record.runs(args.what)), sep="\n")
    elif args.name == "claims":
        print(*claims.lines(claims.counted(args.results, args.commit)), sep="\n")
    elif args.name == "sweep":
        print(*sweep.commands(args.what[0], args.seeds, flags), sep="\n")
    else:
        record.add(args.what, args.results, args.episodes)


def main(argv):
    """Run one of the names; returns the exit status."""
    try:
        run(*parse(argv))
        return 0
    except KeyboardInterrupt:
        return 130
    except (ValueError, OSError) as error:
        print(f"lab: {' '.join(str(error).split())}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
