"""`python -m results NAME ...`: figures and tables of trained robots. NAME is one of

    a figure  RUN...   fig2 fig3 fig4 fig5 fig6 table1 tradeoff alpha, as PNG and CSV in --out
    weights   RUN...   a figure of PPO at each lambda and EIPO from each lambda_0, and tables that
                       say which are within the margin of the best
    summary   RUN...   a line for each kind of run: score, power, energy and falls
    table     RUN...   the same with more, for each seed, and on curriculum by region of commands
    claims             the paper's claims, each with a verdict by rule, of the runs in --results
                       that have seeds 10 to 17 and names that do not begin with new-
    add       FOLDER   play the policies of run folders, for the tables of --results

RUN is results/TASK for all runs there that train.py named, or 'results/TASK/NAME', in which NAME
may have * ? and [...]. Other runs are first put into tables of their own, by add.
"""

import io
import os
import sys
from pathlib import Path

if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # its threads only wait
    os.environ["MUJOCO_GL"] = "off"  # no robot is drawn
    os.environ["MPLBACKEND"] = "Agg"  # a notebook's is not valid outside of it

from PIL import Image

from results import claims, figures, tables, weights
from runtime import run_folder
from runtime.cli import COUNT, Parser, a_path, misfit, program

FIGURES = "fig2", "fig3", "fig4", "fig5", "fig6", "table1", "tradeoff", "alpha", "weights"
TABLES = "summary", "table"
TAKEN_BY = dict(out=FIGURES, results=("add", "claims"), episodes=("add",))


def save(figure, file):
    """Write a Figure as a PNG of 256 colours, which has a third of the bytes."""
    whole = io.BytesIO()
    figure.savefig(whole, dpi=150, format="png")
    with Image.open(whole) as image:
        few = image.convert("RGB").quantize(256, Image.Quantize.MAXCOVERAGE)
    few.save(file, "PNG", optimize=True)


@program("python -m results")
def main(argv):
    """Do what the command line says; returns the exit status."""
    parser = Parser("python -m results", __doc__)
    add = parser.add_argument
    add("name", choices=[*FIGURES, *TABLES, "claims", "add"], metavar="NAME")
    add("what", nargs="*", help="runs or folders, as NAME takes them")
    add("--out", type=a_path, help="folder for PNG and CSV of a figure (default: where you are)")
    add("--results", type=a_path, help="folder of the tables, for add and claims (default: ours)")
    add("--episodes", type=int, help="that add plays, per policy and kind of start")
    args = parser.parse_args(argv)
    if line := misfit(vars(args), dict(episodes=COUNT)):
        parser.error(line)
    if bool(args.what) == (args.name == "claims"):
        parser.error(f"{args.name} takes {'no' if args.what else 'at least one'} argument")
    for flag, names in TAKEN_BY.items():
        if vars(args)[flag] is not None and args.name not in names:
            parser.error(f"{args.name} takes no --{flag}")
    results = args.results or tables.RESULTS
    out = args.out or Path()
    if args.name == "add":
        tables.add(args.what, results, args.episodes)
    elif args.name in TABLES:
        print(*getattr(claims, args.name)(tables.runs(args.what)), sep="\n")
    elif args.name == "claims":
        print(*claims.claim_lines(claims.counted(results)), sep="\n")
    else:
        runs = tables.runs(args.what)
        rows, figure = getattr(weights if args.name == "weights" else figures, args.name)(runs)
        out.mkdir(parents=True, exist_ok=True)
        picture = out / f"{args.name}.png"
        run_folder.replace_file(picture, lambda file: save(figure, file))
        tables.write(picture.with_suffix(".csv"), rows)
        if args.name == "weights":
            print(*weights.answers(runs), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
