"""Look at a policy: `python play.py RUN` opens MuJoCo's viewer.

Without a display, --web shows it in a browser (MuJoCo 4) and --gif FILE draws a moving picture.
With --follow the robot gets every new policy that a run saves while it trains. --slow 4 shows it
four times slower, and --forces draws the forces of the ground on the feet.

In the viewer the arrow keys set the command: up and down 0.1 m/s of v_x, left and right 0.1 rad/s
of yaw rate; backspace sets it to 0. In the browser there are sliders.
"""

import argparse
import ctypes.util
import itertools
import os
import sys
import threading
import time
import warnings
from dataclasses import replace
from pathlib import Path

HEADLESS = sys.platform == "linux" and not (
    os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
)
if HEADLESS:  # MuJoCo decides on import how it will draw
    backends = [name for name in ("EGL", "OSMesa") if ctypes.util.find_library(name)]
    os.environ.setdefault("MUJOCO_GL", backends[0].lower() if backends else "off")

try:
    import mujoco
    import mujoco.viewer
# MuJoCo does not know a value, or lacks its library
except (RuntimeError, AttributeError, OSError) as error:
    print(
        f"play.py: MUJOCO_GL={os.environ.get('MUJOCO_GL')} does not work, so unset it: {error}",
        file=sys.stderr,
    )
    sys.exit(2)
import numpy as np
from PIL import Image, ImageDraw, ImageFont

import evaluate
import go1_env
import tasks
import terrain
from runtime import policy_file, run_folder

# up, down, left, right: GLFW's codes
KEYS = {265: (0.1, 0, 0), 264: (-0.1, 0, 0), 263: (0, 0, 0.1), 262: (0, 0, -0.1)}
BACKSPACE = 259
SIZE = (480, 270)  # pixels of a GIF; four seconds on rough ground take 2 MB
STEPS_PER_FRAME = 3
COLOURS = 64
LETTERS = 17  # pixels, height
NEWTON = 0.004  # m per newton of the arrows for contact forces
ORANGE = (255, 115, 0)  # their colour
AROUND = 7  # tiles of ground that are drawn in x and in y; the robot is on the middle one


def make_env(env_cfg, roughness=None, world=go1_env.Go1Env):
    """One robot on one tile, without a time limit, which starts from the nominal pose.

    roughness: [m], or None for the greatest of the run; world(num_envs, env_cfg) makes it
    """
    level = env_cfg.roughness[1] if roughness is None else roughness
    changes = dict(roughness=(level, level), tiles=1, episode_steps=10**9, stagger=False)
    changes |= dict(start_spread=0.0)
    env_cfg = replace(env_cfg, **changes)
    return world(1, env_cfg)


# ---- one robot as MuJoCo draws it ----


def make_scene(env):
    """Model and data to draw env with. The robot's tile is repeated, as far as one sees."""
    ground = env.ground
    if ground is not None:
        margin = round(terrain.APRON / terrain.SPACING)
        ground = np.tile(ground[margin:-margin, margin:-margin], (AROUND, AROUND))
    model = env.build_model(ground)
    model.vis.map.force = NEWTON
    model.vis.rgba.contactforce[:3] = np.array(ORANGE) / 255
    return model, mujoco.MjData(model)


def show(env, model, data):
    """Put the drawn robot where the simulated one is, on the middle tile, with its torques."""
    state = env.state
    model.body_mass[:] = state.mass[0]
    model.body_ipos[:] = state.com[0]
    model.geom_friction[:] = state.friction[0]
    # of the trunk and its legs: the camera looks at their centre
    model.body_subtreemass[1] = state.mass[0].sum()
    model.opt.gravity[:] = state.gravity[0]
    data.qpos[:] = env.qpos[0]
    data.qvel[:] = env.qvel[0]
    data.ctrl[:] = env.ctrl[0]
    if env.ground is not None:
        data.qpos[:2] += AROUND // 2 * terrain.TILE - terrain.origin(state.tile[0])
    mujoco.mj_forward(model, data)


def point(camera, env, model):
    """Let a camera follow the trunk, from the front right of where the robot heads now."""
    w, x, y, z = env.qpos[0, 3:7]
    camera.type = mujoco.mjtCamera.mjCAMERA_TRACKING
    camera.trackbodyid = model.body("trunk").id
    camera.distance = 1.5
    camera.elevation = -18.0
    camera.azimuth = 125.0 + np.degrees(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))


def caption(log, command):
    """One line that says what the robot is asked to do and what it does."""
    asked = "  ".join(
        f"{x:.1f} {unit}"
        for x, unit in zip(command, ("m/s", "m/s aside", "rad/s"), strict=True)
        if x
    )
    asked = f"asked {asked}   " if asked else ""
    return f"{asked}v_x {log['v_x'][0]:.1f} m/s   {log['power'][0]:.0f} W"


# ---- the policy at work ----


def play(env, folder, command, follow=False, seed=0):
    """Run the policy of a run folder, without noise, for ever. Yields the log of each control step.

    command: (3,) [m/s, m/s, rad/s], which the caller may change in place
    follow:  whether to load policy.npz again whenever training has written a new one
    seed:    of friction, payload, heading and ground under the robot
    """
    path = Path(folder) / "policy.npz"
    loaded = None
    obs, _ = env.reset(seed, command)
    while True:
        if loaded is None or (follow and path.stat().st_mtime_ns != loaded):
            loaded = path.stat().st_mtime_ns
            policy = evaluate.deterministic(policy_file.load(path)[0])
        env.state.command[:] = env.state.given[:] = command
        obs, _, _, _, info = env.step(policy(obs))
        yield info["log"]


def watch(env, steps, command, slow=1.0, forces=False):
    """Show steps (an iterator of `play`) in the viewer, `slow` times slower, until it is closed."""

    def on_key(key):
        command[:] = 0.0 if key == BACKSPACE else command + KEYS.get(key, 0.0)

    model, data = make_scene(env)
    with mujoco.viewer.launch_passive(
        model, data, key_callback=on_key, show_left_ui=False, show_right_ui=False
    ) as viewer:
        point(viewer.cam, env, model)
        viewer.opt.flags[mujoco.mjtVisFlag.mjVIS_CONTACTFORCE] = forces
        while viewer.is_running():
            start = time.monotonic()
            log = next(steps)
            with viewer.lock():
                show(env, model, data)
            viewer.set_texts((None, None, caption(log, command), None))
            viewer.sync()
            time.sleep(max(0.0, slow * env.period - (time.monotonic() - start)))
    for thread in set(threading.enumerate()) - {threading.current_thread()}:
        thread.join(5.0)  # wait for the viewer's: GLFW may hang if Python ends first


def launch_web(env, model, command, said, port, host):
    """MuJoCo's viewer for browsers, in a thread of its own: a handle, to be used in a with block.

    command: (3,) that its sliders change; said: a list with the line that it shows
    Raises ValueError if this MuJoCo has no such viewer.
    """
    try:
        from mujoco.studio import launch_thread, messages, plugin, viewer_protocol, web_viewer
        from mujoco.studio.dear_imgui import dear_imgui as gui
    except ImportError:
        raise ValueError(f"--web needs MuJoCo 4.0, and this is {mujoco.__version__}") from None
    low, high = tasks.trained(env.env_cfg.task)

    class Viewer(web_viewer.WebViewer):
        _host = property(lambda self: host, lambda self, _: None)  # it would take all interfaces

    class Panel(plugin.ViewerPlugin):
        @messages.handler
        def build(self, event: messages.BuildGuiEvent):
            gui.SetNextWindowPos(gui.Vec2(10, 10))
            gui.Begin("command", True, int(gui.WindowFlags.AlwaysAutoResize))
            gui.Text(said[0])
            for i, name in enumerate(("v_x [m/s]", "v_y [m/s]", "yaw rate [rad/s]")):
                if low[i] < high[i]:
                    command[i] = gui.SliderFloat(name, command[i], low[i], high[i])[1]
            gui.End()

    def run(endpoint):
        camera = mujoco.MjvCamera()
        point(camera, env, model)
        config = viewer_protocol.ViewerConfig(title="EIPO", gfx="web", http_port=port)
        viewer = Viewer(config, endpoint, plugins=[Panel()], camera=camera)
        viewer_protocol.run_viewer_loop(viewer)

    return launch_thread.launch_thread(run)


def serve(env, steps, command, port=0, host="127.0.0.1", slow=1.0):
    """Show steps (an iterator of `play`) in browsers, until Ctrl-C.

    port: 0 takes the first free one from 8080 on; host: at which address browsers may ask
    Raises ValueError if this MuJoCo cannot, RuntimeError if the port is taken.
    """
    model, data = make_scene(env)
    said = [""]
    with launch_web(env, model, command, said, port, host) as handle:
        handle.set_model(model, data=data)
        while handle.is_running():
            start = time.monotonic()
            log = next(steps)
            show(env, model, data)
            said[0] = caption(log, command)
            handle.sync()
            time.sleep(max(0.0, slow * env.period - (time.monotonic() - start)))


def save_gif(path, env, steps, seconds, command, slow=1.0, forces=False):
    """Draw `seconds` of steps (an iterator of `play`) into a GIF, after one second unseen.

    Returns how often the robot fell in them.
    """
    model, data = make_scene(env)
    images = []
    camera = mujoco.MjvCamera()
    options = mujoco.MjvOption()
    falls = 0
    font = ImageFont.load_default(LETTERS)
    options.flags[mujoco.mjtVisFlag.mjVIS_CONTACTFORCE] = forces
    every = max(1, round(STEPS_PER_FRAME / slow))
    next(itertools.islice(steps, round(1 / env.period) - 1, None))
    point(camera, env, model)
    with mujoco.Renderer(model, SIZE[1], SIZE[0]) as renderer:
        for i, log in enumerate(itertools.islice(steps, round(seconds / env.period))):
            if log["ended_fall"][0]:
                falls += 1
                point(camera, env, model)  # the next episode may head elsewhere
            if i % every:
                continue
            show(env, model, data)
            renderer.update_scene(data, camera, options)
            image = Image.fromarray(renderer.render())
            ImageDraw.Draw(image).text((10, 6), caption(log, command), (20, 20, 20), font)
            if not images:  # one palette for all frames is smaller
                first = image.copy()
                if forces:  # the palette needs their colour, even if no foot is on the ground yet
                    ImageDraw.Draw(first).rectangle((0, 0, 30, 30), fill=ORANGE)
                palette = first.quantize(COLOURS, dither=Image.Dither.NONE)
            images.append(image.quantize(dither=Image.Dither.NONE, palette=palette))
    gif = dict(
        save_all=True,
        append_images=images[1:],
        duration=round(1000 * env.period * every * slow),
        loop=0,
    )
    run_folder.replace_file(path, lambda file: images[0].save(file, "GIF", **gif))
    return falls


def check_drawing(gif):
    """Raise ValueError or OSError if the file gif, or a window for None, cannot be drawn."""
    if gif is not None and Path(gif).suffix.lower() != ".gif":
        raise ValueError(f"--gif is {gif!r}: it must end in .gif")
    if sys.platform == "linux" and (
        gif is None or os.environ.get("MUJOCO_GL", "").lower() not in ("egl", "osmesa")
    ):
        with warnings.catch_warnings(action="ignore"):
            if not mujoco.viewer.glfw.init():  # the viewer would end the process
                raise ValueError(
                    "no display answers: give --gif FILE, with libegl1 and without DISPLAY "
                    "and MUJOCO_GL"
                )


def parse(argv):
    """The arguments of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.error = lambda message: parser.exit(2, f"play.py: {message} (-h lists every flag)\n")
    parser.add_argument("run", help="run folder with a policy.npz")
    parser.add_argument("--gif", metavar="FILE", help="draw into a GIF instead of a window")
    parser.add_argument(
        "--web", action="store_true", help="show it in a browser, without a display"
    )
    parser.add_argument(
        "--port", type=int, default=0, help="of --web (default: free, from 8080 on)"
    )
    parser.add_argument(
        "--host", default="127.0.0.1", help="of --web; 0.0.0.0: other machines, too"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the world (default: 0)")
    parser.add_argument("--seconds", type=float, default=4.0, help="length of the GIF (default: 4)")
    asked = dict(
        type=float,
        nargs=3,
        metavar=("VX", "VY", "YAW"),
        help="m/s, rad/s (default: the task's greatest)",
    )
    parser.add_argument("--command", **asked)
    parser.add_argument(
        "--roughness", type=float, help="m, of the ground (default: the greatest of the run)"
    )
    parser.add_argument(
        "--slow", type=float, default=1.0, help="show it so many times slower (default: 1)"
    )
    parser.add_argument(
        "--forces", action="store_true", help="draw the forces of the ground on the robot"
    )
    parser.add_argument(
        "--follow", action="store_true", help="load every new policy while training runs"
    )
    return parser.parse_args(argv)


def check_numbers(args, command):
    """Raise ValueError for numbers on the command line that make no sense."""
    shown = 0.1 <= args.seconds <= 600 and 0.1 <= args.slow <= 100
    if not (np.abs(command) <= 10).all() or not shown:
        raise ValueError(
            "--command takes numbers from -10 to 10, --seconds 0.1 to 600 and --slow 0.1 to 100"
        )
    if not 0 <= args.port < 2**16:
        raise ValueError(f"--port is {args.port}: it must be from 0 to 65535")
    if args.seed < 0:
        raise ValueError(f"--seed is {args.seed}: it must be 0 or more")


def main(argv, world=go1_env.Go1Env):
    """Play or draw; returns the exit status. world: see `make_env`."""
    args = parse(argv)
    try:
        env_cfg = policy_file.load(Path(args.run) / "policy.npz")[1]
        env = make_env(env_cfg, args.roughness, world)
        command = np.array(args.command, float) if args.command else tasks.example(env_cfg.task)
        check_numbers(args, command)
        if warning := tasks.untrained(env_cfg.task, command):
            print(f"play.py: {args.run}: {warning}", file=sys.stderr)
        if not args.web:
            check_drawing(args.gif)
        steps = play(env, args.run, command, args.follow, args.seed)
        if args.web:
            serve(env, steps, command, args.port, args.host, args.slow)
        elif args.gif is None:
            watch(env, steps, command, args.slow, args.forces)
        else:
            seen = args.seconds, command, args.slow, args.forces
            if falls := save_gif(Path(args.gif), env, steps, *seen):
                print(f"play.py: the robot falls {falls} times: try --seed", file=sys.stderr)
    except KeyboardInterrupt:
        return 130
    except (ImportError, AttributeError, mujoco.FatalError) as error:
        print(
            f"play.py: OpenGL does not work: {error}; install libegl1 or libosmesa6",
            file=sys.stderr,
        )
        return 2
    except (ValueError, OSError, RuntimeError) as error:
        print(f"play.py: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
