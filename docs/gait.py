"""How policies walk: `python -m docs.gait RUN... --v-x 0.5 1` draws when each foot stands, and
where, and prints a table. All are asked for the same speeds.

Sixteen robots of each run start from the nominal pose and walk for four seconds, on friction and
payload that are drawn as in training. The first second does not count, nor do robots whose episode
ends early.
"""

import os
import sys
from pathlib import Path

if __name__ == "__main__":
    os.environ["MUJOCO_GL"] = "off"  # no robot is drawn

import numpy as np
from matplotlib.figure import Figure

import evaluate
import go1
import tasks
from play import names_of
from runtime import run_folder
from runtime.cli import Parser, Refused, a_path, is_place_for, misfit, program, say

NUM_ROBOTS, SECONDS, SHOWN = 16, 3.0, 1.0  # SECONDS that count, SHOWN in the picture [s]
ROWS = ("FL", "FR", "RL", "RR")  # from the top of a picture of footfalls to its bottom
COLOURS = dict(FR="#D55E00", RL="#D55E00", FL="#0072B2", RR="#0072B2")  # diagonal legs, as in play
LIMITS = dict(v_x={"at least": -100, "at most": 100})
HEAD = "run", "asked", "moves", "power", "steps", "stands", "diagonals", "sides", "apart"


def walk(pi, env_cfg, v_x):
    """What robots do that are asked for v_x [m/s]: speed ahead [m/s] and power [W], (T, N) each,
    whether each foot stands, (T, N, 4) bool, and where it is, (T, N, 4, 2) [m] from the trunk's
    middle, ahead and to the left. N is the number of robots whose episodes did not end early.
    """
    env = evaluate.make_env(env_cfg, np.tile([v_x, 0.0, 0.0], (NUM_ROBOTS, 1)))
    obs, _ = env.reset(evaluate.SEED)
    over, before, seen = np.zeros(NUM_ROBOTS, bool), round(1 / env.period), []
    for t in range(before + round(SECONDS / env.period)):
        obs, _, terminated, _, info = env.step(pi.mean(obs))
        over |= terminated
        if t >= before:
            feet = go1.leg_points(env.qpos[:, 7:])[:, 1::2, :2]
            stands = env.contacts[:, go1.FEET] > 0
            seen.append((info["log"]["v_x"], info["log"]["power"], stands, feet))
    return [np.stack(x)[:, ~over] for x in zip(*seen, strict=True)]


def numbers(v_x, power, stands, feet):
    """Of what `walk` returns: speed [m/s], power [W], steps of a foot [1/s], the share of time for
    which a foot stands, those in which the two feet of a diagonal do the same, or the right foot
    and the left one next to it, and how far feet that stand are apart sideways [m].

    A trot has 100 % of diagonals and few sides, a bound the reverse, and a hop much of both.
    """
    steps = (stands[1:] & ~stands[:-1]).sum() / (stands[0].size * SECONDS)
    fr, fl, rr, rl = np.moveaxis(stands, -1, 0)
    diagonals, sides = np.mean([fr == rl, fl == rr]), np.mean([fr == fl, rr == rl])
    # of a foot that never stands there is no mean
    y = [np.mean(y[on]) if on.any() else np.nan for y, on in zip(feet.T[1], stands.T, strict=True)]
    apart = (y[1] + y[3] - y[0] - y[2]) / 2
    return v_x.mean(), power.mean(), steps, stands.mean(), diagonals, sides, apart


def draw(figure, title, stands, feet, period):
    """Draw footfalls of the first robot, and from above where its feet stand, into a SubFigure."""
    falls, above = figure.subplots(1, 2, width_ratios=(3, 1))
    figure.suptitle(title, fontsize=9, parse_math=False)
    shown = round(SHOWN / period)
    for row, leg in enumerate(ROWS):
        i = go1.LEGS.index(leg)
        at = np.flatnonzero(stands[:shown, 0, i]) * period
        falls.broken_barh([(t, period) for t in at], (3 - row - 0.4, 0.8), color=COLOURS[leg])
        x, y = feet[stands[:, 0, i], 0, i].T
        above.plot(-y, x, ".", markersize=2, color=COLOURS[leg])
    falls.set(xlim=(0, SHOWN), yticks=range(4), yticklabels=ROWS[::-1], xlabel="time [s]")
    above.set(xlim=(-0.25, 0.25), ylim=(-0.6, 0.4), aspect="equal", xticks=(-0.2, 0, 0.2))
    above.set(ylabel="ahead [m]", xlabel="to the right [m]")
    for axes in (falls, above):
        axes.tick_params(labelsize=7)
        axes.xaxis.label.set_size(7)
        axes.yaxis.label.set_size(7)


@program("docs.gait")
def main(argv):
    """Print the table and draw the picture of some RUNs; returns the exit status."""
    parser = Parser("docs.gait", __doc__.split("\n\n")[0])
    add = parser.add_argument
    add("runs", metavar="RUN", nargs="+", type=a_path, help="run folder with a policy.npz")
    add("--v-x", type=float, nargs="+", default=[0.5], help="m/s, asked for (default: 0.5)")
    add("--out", metavar="FILE", type=a_path, default=Path("gait.png"), help="(default: gait.png)")
    args = parser.parse_args(argv)
    if line := misfit(dict(v_x=args.v_x), LIMITS):
        parser.error(line)
    if not is_place_for(args.out, ".png"):
        parser.error(f"--out is {args.out}: it must end in .png, and its folder must exist")
    loaded = [evaluate.load(run, nominal=True) for run in args.runs]
    for run, (_, env_cfg) in zip(args.runs, loaded, strict=True):
        if not tasks.TASKS[env_cfg.task].commands().example.any():
            raise Refused(f"{run} is of {env_cfg.task}, whose robots are not asked for a speed")
    names = names_of(args.runs, [pi for pi, _ in loaded])
    figure = Figure(figsize=(5 * len(args.v_x), 2.1 * len(loaded)), layout="constrained")
    panels = figure.subfigures(len(loaded), len(args.v_x), squeeze=False)
    say("| " + " | ".join(HEAD) + " |\n" + "|---" * len(HEAD) + "|")
    for name, (pi, env_cfg), line in zip(names, loaded, panels, strict=True):
        for v_x, panel in zip(args.v_x, line, strict=True):
            walked = walk(pi, env_cfg, v_x)
            if not walked[0].size:
                say(f"| {name} | {v_x:g} m/s | every episode ends early" + 6 * " | " + " |")
                title = f"{name}, asked for {v_x:g} m/s: every episode ends early"
                panel.suptitle(title, fontsize=9, parse_math=False)
                continue
            moves, power, steps, *shares, apart = numbers(*walked)
            cells = [f"{v_x:g} m/s", f"{moves:.2f} m/s", f"{power:.0f} W", f"{steps:.1f} / s"]
            cells += [f"{share:.0%}" for share in shares] + [f"{100 * apart:.0f} cm"]
            say(f"| {name} | {' | '.join(cells)} |")
            title = f"{name}, asked for {v_x:g} m/s: {moves:.1f} m/s on {power:.0f} W"
            draw(panel, title, *walked[2:], env_cfg.timestep * env_cfg.physics_steps)
    run_folder.replace_file(args.out, lambda file: figure.savefig(file, dpi=150, format="png"))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
