"""`python -m results NAME RUN...`: figures and tables of runs that are kept. NAME is one of

    a figure   fig2 fig3 fig4 fig5 fig6 table1 strides alpha weights, as PNG and CSV in --out
    table      a line for each kind of run: score, power, falls, energy, and the score of each seed
    short      the same with fewer columns, as our pages show it
    readme     the table of README.md
    paper      a line for each sentence of the paper that compares methods, with a verdict
    add        play the policies of run folders, and keep each in a file of --results

RUN is a file such as results/flat/NAME.json, or a folder of them; of add it is a run folder.
"""

import csv
import io
import os
import sys

if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # its threads only wait
    os.environ["MUJOCO_GL"] = "off"  # no robot is drawn
    os.environ["MPLBACKEND"] = "Agg"  # a notebook's is not valid outside of it
from pathlib import Path

import matplotlib
from PIL import Image

from results import figures, paper, runs, tables
from runtime import run_folder
from runtime.cli import COUNT, Parser, a_path, misfit, program

FIGURES = "fig2", "fig3", "fig4", "fig5", "fig6", "table1", "strides", "alpha", "weights"
TABLES = dict(table=tables.table, short=tables.short, readme=tables.readme, paper=paper.paper)
TAKEN_BY = dict(out=FIGURES, results=("add",), episodes=("add",))


def save_picture(figure, file):
    """Write a Figure as a PNG of 256 colours, which has a third of the bytes."""
    whole = io.BytesIO()
    figure.savefig(whole, dpi=150, format="png")
    with Image.open(whole) as image:
        few = image.convert("RGB").quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=1)
    few.save(file, "PNG", optimize=True)


def save_rows(rows, file):
    """Write rows, dicts with the same keys, as CSV, with five digits of each number."""
    short = [[f"{x:.5g}" if isinstance(x, float) else x for x in row.values()] for row in rows]
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([rows[0], *short])
    file.write(text.getvalue().encode())


@program("python -m results")
def main(argv):
    """Do what the command line says; returns the exit status."""
    parser = Parser("python -m results", __doc__)
    add = parser.add_argument
    add("name", choices=[*FIGURES, *TABLES, "add"], metavar="NAME")
    add("runs", nargs="+", type=a_path, metavar="RUN", help="runs, as NAME takes them")
    add("--out", type=a_path, help="folder for PNG and CSV of a figure (default: where you are)")
    add("--results", type=a_path, help="folder in which add keeps runs (default: ours)")
    add("--episodes", type=int, help="that add plays, per policy and kind of start")
    args = parser.parse_args(argv)
    if line := misfit(vars(args), dict(episodes=COUNT)):
        parser.error(line)
    for flag, names in TAKEN_BY.items():
        if vars(args)[flag] is not None and args.name not in names:
            parser.error(f"{args.name} takes no --{flag}")
    if args.name == "add":
        runs.add(args.runs, args.results or runs.RESULTS, args.episodes)
    elif args.name in TABLES:
        print(*TABLES[args.name](args.runs), sep="\n")
    else:
        draw(args.name, runs.read_all(args.runs), args.out or Path())
    return 0


def draw(name, some, out):
    """Draw a figure of Runs into the folder `out`, in our style, whatever the user's is."""
    matplotlib.rcdefaults()
    rows, figure = getattr(figures, name)(some)
    out.mkdir(parents=True, exist_ok=True)
    picture = out / f"{name}.png"
    run_folder.replace_file(picture, lambda file: save_picture(figure, file))
    run_folder.replace_file(picture.with_suffix(".csv"), lambda file: save_rows(rows, file))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
