"""Look at a policy: `python play.py RUN` opens MuJoCo's viewer.

Without a display, --web shows it in a browser (MuJoCo 4) and --gif FILE draws a moving picture.
`python play.py RUN RUN RUN --gif FILE` draws several side by side, all asked for the same. Legs of
one colour are diagonal, so they move together in a trot.

In the viewer the arrow keys set the command: up and down 0.1 m/s of v_x, left and right 0.1 rad/s
of yaw rate; backspace sets it to 0. In the browser there are sliders.
"""

import math
import os
import subprocess
import sys
from dataclasses import replace


def way_to_draw():
    """How MuJoCo can draw without a display: egl, osmesa or off.

    EGL is often there without its driver, and a process can load only one of them, so child
    processes try.
    """
    code = "import mujoco; mujoco.GLContext(8, 8).make_current()"
    for way in ("egl", "osmesa"):
        trial = dict(env=os.environ | dict(MUJOCO_GL=way), capture_output=True)
        if subprocess.run([sys.executable, "-c", code], **trial).returncode == 0:
            return way
    return "off"


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # its threads only wait
    if sys.platform == "linux":  # MuJoCo reads it on import, which fails if this way does not work
        os.environ.pop("MUJOCO_GL", None)
        if "--gif" in " ".join(sys.argv):
            os.environ["MUJOCO_GL"] = way_to_draw()

import numpy as np

import evaluate
import go1_env
import tasks
from runtime import run_folder, viewer
from runtime.cli import A_SEED, Parser, Refused, a_path, is_place_for, misfit, program
from runtime.kinds import Kind

LIMITS = dict(
    port={"at least": 0, "at most": 65535},
    seed=A_SEED,
    seconds={"above": 0, "at most": 600},  # a run's pictures of ten minutes take 12 GB
    command={"at least": -100, "at most": 100},
    slow={"above": 0, "at most": 100},
)


def make_env(env_cfg, asked):
    """One robot on the roughest tile, without a time limit, which starts from the nominal pose.

    asked: (3,) [m/s, m/s, rad/s], which the caller may change in place: the robot hears at once
    """
    changes = dict(tiles=1, episode_steps=10**9, command_steps=1, stagger=False, start_spread=0.0)
    changes |= dict(clip=evaluate.CLIP)  # power by one formula, whatever a run learned from (D3)
    return go1_env.Go1Env(1, replace(env_cfg, **changes), commands=tasks.Given(asked[None]))


def play(env, pi, seed=0):
    """Let a Policy drive the robot for ever. Yields the log of each control step.

    seed: of all draws but the ground, whose seed is that of training
    """
    obs, _ = env.reset(seed)
    while True:
        obs, _, _, _, info = env.step(pi.mean(obs))
        yield info["log"]


def names_of(folders, policies):
    """The names of runs side by side: their kinds, or their folders if two kinds are alike."""
    said = [pi.about | pi.config for pi in policies]
    kinds = [str(Kind(x["algo"], x["lam"], x["aux"], x["reward"])) for x in said]
    for names in (kinds, [folder.resolve().name for folder in folders]):
        if len({*names}) == len(folders):
            return names
    return folders


def draw(args, policies, envs, asked):
    """Draw what policies do in their envs, side by side, into the GIF of `main`'s args.

    asked: (3,) [m/s, m/s, rad/s], of all of them
    """
    env, alone = envs[0], len(envs) == 1
    # of whole hundredths of a second, and at least two, since browsers show one as ten
    hundredths = max(2, round(100 * max(1.0, args.slow or 4.0) * env.dt))
    slow = hundredths / (100 * env.dt)
    pace = "in real time" if slow == 1 else f"{slow:.3g} times slower"
    # of several runs, pictures that last less than 60 ms would make a large file
    size, every = (viewer.SIZE, 1) if alone else (viewer.PANEL, math.ceil(6 / hundredths))
    films = [
        viewer.film(env, play(env, pi, args.seed), args.seconds or 1.0, size, every)
        for env, pi in zip(envs, policies, strict=True)
    ]
    panels, means = zip(*films, strict=True)
    if alone:
        did = viewer.caption(env, means[0][-1], asked)
        captions = [[f"{args.runs[0].resolve().name}, {pace}\n{did}"] * len(means[0])]
        foot = ""
    else:
        names = names_of(args.runs, policies)
        captions = [
            [f"{name}\n{viewer.did(mean)}" for mean in mine]
            for name, mine in zip(names, means, strict=True)
        ]
        foot = f"{viewer.asked(env, asked)}   {pace}".strip()
    viewer.save_gif(args.gif, panels, captions, foot, 10 * hundredths * every)


@program("play.py")
def main(argv):
    """Play or draw; returns the exit status."""
    parser = Parser("play.py", __doc__)
    add = parser.add_argument
    add("runs", metavar="RUN", nargs="+", type=a_path, help="run folder with a policy.npz")
    add("--gif", metavar="FILE", type=a_path, help="draw the runs into a GIF instead of a window")
    add("--web", action="store_true", help="show it in a browser, without a display")
    add("--port", type=int, help="of --web (default: free, from 8080 on)")
    add("--seed", type=int, default=0, help="of all draws but the ground (default: 0)")
    add("--seconds", type=float, help="of the robot's time in a GIF (default: 1)")
    three = dict(nargs=3, metavar=("VX", "VY", "YAW"), type=float)
    add("--command", **three, help="m/s, m/s, rad/s (default: the example of the first run's task)")
    add("--slow", type=float, help="times slower than real, a GIF at least 1 (default: 1, a GIF 4)")
    args = parser.parse_args(argv)
    if line := misfit(vars(args), LIMITS):
        parser.error(line)
    if args.web and args.gif:
        parser.error("--web shows a run and --gif draws it: give one of them")
    for flag, given, needs in (("seconds", args.gif, "gif"), ("port", args.web, "web")):
        if vars(args)[flag] is not None and not given:
            parser.error(f"--{flag} needs --{needs}")
    if len(args.runs) > 1 and (args.web or not args.gif):
        parser.error("a window or a browser shows one RUN: draw several with --gif FILE")
    if args.gif and not is_place_for(args.gif, ".gif"):
        what = "it must end in .gif, in a folder that exists and can be written to"
        raise Refused(f"--gif is {args.gif}: {what}")
    loaded = [run_folder.load_policy(run / "policy.npz") for run in args.runs]
    policies, configs = zip(*loaded, strict=True)
    examples = [tasks.TASKS[env_cfg.task].commands().example for env_cfg in configs]
    for run, env_cfg, example in zip(args.runs, configs, examples, strict=True):
        if args.command and not example.any():
            raise Refused(f"{run} is of {env_cfg.task}, whose robots are not asked for a speed")
    asked = np.array(args.command or examples[0], float)
    envs = [make_env(env_cfg, asked) for env_cfg in configs]
    if len({(env.dt, x.any()) for env, x in zip(envs, examples, strict=True)}) > 1:
        what = "all must be asked for a command or none, and have control steps of one length"
        raise Refused(f"these runs do not go side by side: {what}")
    env, steps = envs[0], play(envs[0], policies[0], args.seed)
    if args.web:
        viewer.browser(env, steps, asked, args.port or 0, args.slow or 1.0)
    elif args.gif:
        draw(args, policies, envs, asked)
    else:
        viewer.window(env, steps, asked, args.slow or 1.0)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
