"""Look at a policy: `python play.py RUN` opens MuJoCo's viewer, `python play.py RUN --gif FILE` needs no display.

In the viewer the arrow keys set the command: up and down 0.1 m/s of v_x, left and right 0.1 rad/s of yaw rate;
backspace sets it to 0. With --follow the robot gets every new policy that a run saves while it trains.
"""

import argparse
import ctypes.util
import os
import sys
import threading
import time
from pathlib import Path

HEADLESS = sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
if HEADLESS:  # MuJoCo decides how to draw when it is imported
    backends = [name for name in ("EGL", "OSMesa") if ctypes.util.find_library(name)]
    os.environ.setdefault("MUJOCO_GL", backends[0].lower() if backends else "off")

import jax
import mujoco
import mujoco.viewer
import numpy as np

import networks
import run_folder
import scene

KEYS = {265: (0.1, 0, 0), 264: (-0.1, 0, 0), 263: (0, 0, 0.1), 262: (0, 0, -0.1)}  # up, down, left, right: GLFW's codes
BACKSPACE = 259


def play(env, folder, command, follow=False):
    """Run the deterministic policy of a run folder forever; yields the log of each control step (see Go1Env.step).

    command: (3,) [m/s, m/s, rad/s], which the caller may change in place; follow: load each new policy.npz
    """
    path, loaded = Path(folder) / "policy.npz", None
    mean = jax.jit(lambda params, obs: networks.policy(params, obs)[0])
    obs, _ = env.reset(0, command)
    while True:
        if loaded is None or (follow and path.stat().st_mtime_ns != loaded):
            loaded, params = path.stat().st_mtime_ns, run_folder.load_policy(path)[0]
        env.state.command[:] = env.state.given[:] = command
        obs, _, _, _, info = env.step(np.asarray(mean(params, obs)))
        yield info["log"]


def watch(env, steps, command):
    """The viewer, in real time, until its window is closed."""

    def on_key(key):
        command[:] = 0.0 if key == BACKSPACE else command + KEYS.get(key, 0.0)

    model, data = scene.make_scene(env)
    with mujoco.viewer.launch_passive(
        model, data, key_callback=on_key, show_left_ui=False, show_right_ui=False
    ) as viewer:
        scene.point(viewer.cam, env, model)
        while viewer.is_running():
            start = time.monotonic()
            log = next(steps)
            with viewer.lock():
                scene.show(env, model, data)
            viewer.set_texts((None, None, scene.caption(log, command), None))
            viewer.sync()
            time.sleep(max(0.0, env.period - (time.monotonic() - start)))
    for thread in set(threading.enumerate()) - {threading.current_thread()}:
        thread.join(5.0)  # the viewer's: GLFW may hang if Python ends before it


def main(argv):
    """Play or draw; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", help="run folder with a policy.npz")
    parser.add_argument("--gif", metavar="FILE", help="draw into a GIF instead of a window")
    parser.add_argument("--seconds", type=float, default=4.0, help="length of the GIF (default: 4)")
    parser.add_argument("--command", type=float, nargs=3, metavar=("VX", "VY", "YAW"),
                        help="m/s, m/s, rad/s (default: the task's greatest)")  # fmt: skip
    parser.add_argument("--roughness", type=float, help="m, of the ground (default: the greatest of the run)")
    parser.add_argument("--follow", action="store_true", help="load every new policy while training runs")
    args = parser.parse_args(argv)
    try:
        _, env_cfg = run_folder.load_policy(Path(args.run) / "policy.npz")
        env = scene.make_env(env_cfg, args.roughness)
        greatest = (1.0, 0.0, 0.0) if env.task.curriculum else env.task.command_high
        command = np.array(greatest if args.command is None else args.command, float)
        if not np.isfinite(command).all() or not 0.1 <= args.seconds <= 600:
            raise ValueError("--command takes three finite numbers, --seconds one from 0.1 to 600")
        steps = play(env, args.run, command, args.follow)
        if not args.gif and HEADLESS:
            raise ValueError("there is no display to open a window on: add --gif FILE")
        if args.gif and os.environ.get("MUJOCO_GL") == "off":
            raise ValueError("nothing to draw with: install libegl1 or libosmesa6")
        if args.gif:
            scene.save_gif(writable(args.gif), env, steps, args.seconds, command)
        else:
            watch(env, steps, command)
    except KeyboardInterrupt:
        return 130
    except (ImportError, AttributeError, mujoco.FatalError) as error:
        print(f"play.py: OpenGL does not work: {error}; install libegl1 or libosmesa6", file=sys.stderr)
        return 2
    except (ValueError, OSError, RuntimeError) as error:
        print(f"play.py: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    return 0


def writable(path):
    """The path of a GIF, once it is clear that it can be written. Raises ValueError or OSError."""
    if Path(path).suffix.lower() != ".gif":
        raise ValueError(f"{path} does not end in .gif")
    Path(path).touch()
    return path


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
