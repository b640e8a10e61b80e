"""`python -m lab NAME ...`: figures and tables of trained robots. NAME is one of

    a figure  RUN...   fig2 fig3 fig4 fig5 fig6 table1, as PNG and CSV in --out
    footfalls FOLDER   which foot of a policy.npz is on the ground when, a robot each --command
    table     RUN...   a line for each kind of run
    claims             the paper's claims of runs in --results, each with a verdict by rule
    promise            pi beside the pi' of its own run, as a table, PNG and CSV
    add       FOLDER   play the policies of run folders, for the tables of --results

RUN is results/TASK for all runs there that train.py named, or 'results/TASK/NAME', in which NAME
may have * ? and [...]. Other runs are first put into tables of their own, by add.
"""

import os
import sys
from pathlib import Path

if __name__ == "__main__":
    os.environ["MUJOCO_GL"] = "off"  # no robot is drawn

from lab import claims, figures, footfalls, promise, record
from runtime.command import Parser, command

FIGURES = "fig2", "fig3", "fig4", "fig5", "fig6", "table1"
OTHERS = "footfalls", "table", "claims", "promise", "add"


def parse(argv):
    """The arguments of the command line."""
    parser = Parser("python -m lab", __doc__)
    add = parser.add_argument
    add("name", choices=[*FIGURES, *OTHERS], metavar="NAME")
    add("what", nargs="*", help="runs or folders, as NAME takes them")
    add("--out", type=Path, default=Path(), help="folder for PNG and CSV")
    add("--results", type=Path, default=record.RESULTS, help="folder of the tables")
    add("--episodes", type=int, help="to play, per policy and kind of start")
    add("--command", type=float, nargs="+", default=[0.3, 0.6, 1.0], help="m/s of v_x")
    args = parser.parse_args(argv)
    if not args.what and args.name not in ("claims", "promise"):
        parser.error(f"{args.name} takes at least one argument")
    if args.name == "footfalls" and len(args.what) > 1:
        parser.error("footfalls takes one folder")
    return args


def run(args):
    """Do what the command line says; returns lines to print."""
    if args.name == "add":
        record.add(args.what, args.results, args.episodes)
        return ()
    if args.name == "table":
        return claims.table(record.runs(args.what))
    if args.name == "claims":
        return claims.claim_lines(claims.counted(args.results))
    lines = rows = ()
    if args.name == "footfalls":
        figure = footfalls.footfalls(args.what[0], args.command)
    elif args.name == "promise":
        arms = claims.counted(args.results)
        rows, figure = promise.promise(arms)
        lines = promise.promise_lines(arms)
    else:
        rows, figure = getattr(figures, args.name)(record.runs(args.what))
        lines = figures.regions(rows) if args.name == "fig5" else ()
    figures.save(args.out, args.name, figure, rows)
    return lines


@command("lab")
def main(argv):
    """Run one of the names; returns the exit status."""
    for line in run(parse(argv)):
        print(line)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
