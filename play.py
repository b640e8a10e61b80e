"""Look at a policy: `python play.py RUN` opens MuJoCo's viewer.

Without a display, --web shows it in a browser (MuJoCo 4) and --gif FILE draws a moving picture, of
several runs side by side. With --follow the robot gets every new policy that a run saves while it
trains. Legs of one colour are diagonal, so they move together in a trot.

In the viewer the arrow keys set the command: up and down 0.1 m/s of v_x, left and right 0.1 rad/s
of yaw rate; backspace sets it to 0. In the browser there are sliders.
"""

import ctypes.util
import os
import socket
import sys
import threading
import time
from dataclasses import replace
from itertools import islice
from pathlib import Path

DISPLAY = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
if sys.platform == "linux" and ("--gif" in " ".join(sys.argv) or not DISPLAY):
    # MuJoCo decides on import how it will draw
    found = [name.lower() for name in ("EGL", "OSMesa") if ctypes.util.find_library(name)]
    os.environ.setdefault("MUJOCO_GL", found[0] if found else "off")

import mujoco
import mujoco.viewer
import numpy as np
from PIL import Image, ImageDraw, ImageFont

import go1
import go1_env
import terrain
from runtime import deploy, run_folder
from runtime.command import Parser, Refused, command, finite, positive

# up, down, left, right: GLFW's codes
KEYS = {265: (0.1, 0, 0), 264: (-0.1, 0, 0), 263: (0, 0, 0.1), 262: (0, 0, -0.1)}
BACKSPACE = 259
SIZE = (480, 270)  # pixels of a GIF, for each run
AROUND = 7  # tiles of ground that are drawn in x and in y; the robot is on the middle one
ORANGE, BLUE = (0.95, 0.35, 0.0, 1.0), (0.1, 0.3, 0.9, 1.0)
LEGS = dict(FR=ORANGE, RL=ORANGE, FL=BLUE, RR=BLUE)


def make_env(env_cfg):
    """One robot on one tile, without a time limit, which starts from the nominal pose."""
    changes = dict(tiles=1, episode_steps=10**9, stagger=False, start_spread=0.0)
    return go1_env.Go1Env(1, replace(env_cfg, **changes))


# ---- one robot as MuJoCo draws it ----


def make_scene(env):
    """Model and data to draw env with. The robot's tile is repeated, as far as one sees."""
    ground = env.ground
    if ground is not None:
        margin = round(terrain.APRON / terrain.SPACING)
        ground = np.tile(ground[margin:-margin, margin:-margin], (AROUND, AROUND))
    model = go1.build_model(env.env_cfg.timestep, ground)
    for geom in range(model.ngeom):
        leg = model.body(model.geom_bodyid[geom]).name[:2]
        if model.geom_group[geom] == 2 and leg in LEGS:
            model.geom_matid[geom] = -1
            model.geom_rgba[geom] = LEGS[leg]
    return model, mujoco.MjData(model)


def show(env, model, data):
    """Put the drawn robot where the simulated one is, on the middle tile."""
    data.qpos[:] = env.qpos[0]
    if env.ground is not None:
        data.qpos[:2] += AROUND // 2 * terrain.TILE - terrain.origin(env.state.tile[0])
    mujoco.mj_forward(model, data)


def point(camera, env, model):
    """Let a camera follow the trunk, from the front right of where the robot heads now."""
    camera.type = mujoco.mjtCamera.mjCAMERA_TRACKING
    camera.trackbodyid = model.body("trunk").id
    x, y, _ = go1.motion(env.qpos, env.qvel).to_world[0, :, 0]  # the trunk's forward axis
    camera.distance, camera.elevation = 1.2, -20.0
    camera.azimuth = np.degrees(np.arctan2(y, x)) + 110.0


def caption(env, log, command):
    """One line that says what env's robot does, and what it is asked to do if its task asks."""
    x, y, yaw = command
    done = f"v_x {np.mean(log['v_x']):z.1f} m/s   {np.mean(log['power']):.0f} W"
    if not env.task_commands.high.any():
        return done
    return f"asked {x:.1f} m/s, {y:.1f} m/s aside, {yaw:.1f} rad/s   {done}"


# ---- the policy at work ----


def play(env, pi, command, seed=0, follow=None):
    """Let a Policy drive the robot for ever. Yields the log of each control step.

    command: (3,) [m/s, m/s, rad/s], which the caller may change in place
    seed:    of friction, payload, heading and ground under the robot
    follow:  path of a policy.npz; its policy takes over whenever training has written a new one
    """
    written = follow and follow.stat().st_mtime_ns
    for _, log in deploy.drive(pi, env, command, seed):
        yield log
        if follow and (now := follow.stat().st_mtime_ns) != written:
            written, (new, _) = now, deploy.load(follow)
            pi.actor, pi.estimator = new.actor, new.estimator  # and it goes on from what pi saw


def paced(steps, period):
    """Yields what steps do, but one in each period [s] at most."""
    start = time.monotonic()
    for log in steps:
        yield log
        time.sleep(max(0.0, start + period - time.monotonic()))
        start = time.monotonic()


def watch(env, steps, command, slow=1.0):
    """Show steps (an iterator of `play`) in the viewer, `slow` times slower, until it is closed."""

    def on_key(key):
        command[:] = 0.0 if key == BACKSPACE else command + KEYS.get(key, 0.0)

    if sys.platform == "linux" and not DISPLAY:  # the viewer would end the process
        raise Refused("there is no display: give --web or --gif FILE")
    model, data = make_scene(env)
    with mujoco.viewer.launch_passive(
        model, data, key_callback=on_key, show_left_ui=False, show_right_ui=False
    ) as viewer:
        point(viewer.cam, env, model)
        for log in paced(steps, slow * env.period):
            if not viewer.is_running():
                break
            with viewer.lock():
                show(env, model, data)
            viewer.set_texts((None, None, caption(env, log, command), None))
            viewer.sync()
    for thread in set(threading.enumerate()) - {threading.current_thread()}:
        thread.join(5.0)  # wait for the viewer's: GLFW may hang if Python ends first


def launch_web(env, model, command, said, port):
    """MuJoCo's viewer for browsers, in a thread of its own: a handle, to be used in a with block.

    command: (3,) that its sliders change; said: a list with the line that it shows
    """
    try:
        from mujoco.studio import launch_thread, messages, plugin, viewer_protocol, web_viewer
        from mujoco.studio.dear_imgui import dear_imgui as gui
    except ImportError:
        raise Refused(f"--web needs MuJoCo 4.0, and this is {mujoco.__version__}") from None
    low, high = env.task_commands.low, env.task_commands.high

    class Viewer(web_viewer.WebViewer):
        # to answer this machine alone: the viewer itself would set all interfaces
        _host = property(lambda self: "127.0.0.1", lambda self, _: None)

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


def serve(env, steps, command, port=0, slow=1.0):
    """Show steps (an iterator of `play`) in browsers of this machine, until Ctrl-C.

    port: 0 takes the first free one from 8080 on
    """
    socket.create_server(("127.0.0.1", port)).close()  # MuJoCo's error would name no port
    model, data = make_scene(env)
    said = [""]
    with launch_web(env, model, command, said, port) as handle:
        handle.set_model(model, data=data)
        for log in paced(steps, slow * env.period):
            if not handle.is_running():
                break
            show(env, model, data)
            said[0] = caption(env, log, command)
            handle.sync()


# ---- a moving picture ----


def draw(env, steps, seconds):
    """Pictures of each control step, `seconds` of them, (height, width, 3) uint8; and the logs.

    The first second is not drawn.
    """
    model, data = make_scene(env)
    camera = mujoco.MjvCamera()
    next(islice(steps, round(1 / env.period) - 1, None))
    point(camera, env, model)
    pictures, logs = [], []
    try:
        renderer = mujoco.Renderer(model, SIZE[1], SIZE[0])
    except Exception as error:  # MuJoCo's, or that of whichever library it draws with
        raise Refused(f"OpenGL does not work here: {error!r}") from None
    with renderer:
        for log in islice(steps, max(1, round(seconds / env.period))):
            show(env, model, data)
            renderer.update_scene(data, camera)
            # on a height field the ground's own shadows would be specks
            renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = env.ground is None
            pictures.append(renderer.render())
            logs.append(log)
    return pictures, logs


def save_gif(path, pictures, captions, milliseconds):
    """Write pictures of several robots, (robots, T, height, width, 3), side by side into a GIF.

    captions: of each robot; milliseconds: that each picture lasts
    """
    font = ImageFont.load_default(17)
    images = [Image.fromarray(np.hstack(row)) for row in zip(*pictures, strict=True)]
    for image in images:
        for i, text in enumerate(captions):
            ImageDraw.Draw(image).text((SIZE[0] * i + 10, 6), text, (10, 10, 10), font)
    # one palette without dithering: colours that change would flicker
    palette = images[0].quantize(40, Image.Quantize.MAXCOVERAGE)
    first, *others = (x.quantize(dither=Image.Dither.NONE, palette=palette) for x in images)
    gif = dict(save_all=True, append_images=others, duration=milliseconds, loop=0)
    run_folder.replace_file(path, lambda file: first.save(file, "GIF", **gif))


# ---- the command ----


def parse(argv):
    """The arguments of the command line."""
    parser = Parser("play.py", __doc__.splitlines()[0])
    add = parser.add_argument
    add("runs", nargs="+", metavar="RUN", help="run folder with a policy.npz; several for a GIF")
    add("--gif", metavar="FILE", type=Path, help="draw into a GIF instead of a window")
    add("--web", action="store_true", help="show it in a browser, without a display")
    add("--port", type=int, default=0, help="of --web (default: free, from 8080 on)")
    add("--seed", type=int, default=0, help="of the world (default: 0)")
    add("--seconds", type=positive, default=1.0, help="of the robot's time in a GIF (default: 1)")
    asked = dict(nargs=3, metavar=("VX", "VY", "YAW"), type=finite)
    add("--command", **asked, help="m/s, m/s, rad/s (default: the task's greatest)")
    add("--slow", type=positive, help="times slower than real (default: 1, of a GIF 4)")
    add("--follow", action="store_true", help="load every new policy while training runs")
    args = parser.parse_args(argv)
    if len(args.runs) > 1 and not args.gif:
        parser.error("a window or a browser shows one run: give --gif FILE for several")
    if not 0 <= args.port < 2**16:
        parser.error(f"--port is {args.port}: it must be from 0 to 65535")
    return args


def begin(run, args):
    """The environment of a run, the iterator of `play` over it, and its command."""
    path = Path(run) / "policy.npz"
    pi, env_cfg = deploy.load(path)
    env = make_env(env_cfg)
    command = np.array(args.command or env.task_commands.example, float)
    return env, play(env, pi, command, args.seed, path if args.follow else None), command


def film(args, slow):
    """Draw the GIF of the command line."""
    if os.environ.get("MUJOCO_GL") == "off":
        raise Refused("a GIF needs OpenGL: install libegl1 or libosmesa6")
    robots, captions = [], []
    for run in args.runs:
        env, steps, command = begin(run, args)
        pictures, logs = draw(env, steps, args.seconds)
        mean = {name: np.mean([log[name] for log in logs]) for name in logs[0]}
        captions.append(
            f"{Path(run).resolve().name}, {slow:g} times slower\n{caption(env, mean, command)}"
        )
        robots.append(pictures)
    save_gif(args.gif, robots, captions, round(1000 * slow * env.period))


@command("play.py")
def main(argv):
    """Play or draw; returns the exit status."""
    args = parse(argv)
    if args.gif:
        film(args, args.slow or 4.0)
        return 0
    seen = begin(args.runs[0], args)
    if args.web:
        serve(*seen, args.port, args.slow or 1.0)
    else:
        watch(*seen, args.slow or 1.0)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
