"""A robot as MuJoCo draws it: in a window, in a browser, or as a moving picture."""

import os
import socket
import sys
import threading
import time
import warnings
from collections import deque
from itertools import islice

import mujoco
import mujoco.viewer
import numpy as np
from mujoco.viewer import glfw
from PIL import Image, ImageDraw, ImageFont

import go1
import terrain
from runtime import run_folder
from runtime.cli import Refused

# up, down, left, right: GLFW's codes
KEYS = {265: (0.1, 0, 0), 264: (-0.1, 0, 0), 263: (0, 0, 0.1), 262: (0, 0, -0.1)}
BACKSPACE = 259
SIZE = (480, 270)  # pixels of a GIF
PANEL = (320, 180)  # pixels of each run in a GIF of several; three fill a README's width
AROUND = 7  # tiles of ground that are drawn in x and in y; the robot is on the middle one
ORANGE, BLUE = (0.95, 0.35, 0.0, 1.0), (0.1, 0.3, 0.9, 1.0)
COLOURS = dict(FR=ORANGE, RL=ORANGE, FL=BLUE, RR=BLUE)  # of the legs


def make_scene(env):
    """Model and data to draw env with. Its ground is one tile, repeated as far as one sees."""
    ground = env.ground
    if ground is not None:
        margin = round(terrain.APRON / terrain.SPACING)
        ground = np.tile(ground[margin:-margin, margin:-margin], (AROUND, AROUND))
    model = go1.build_model(env.env_cfg.timestep, ground)
    for geom in range(model.ngeom):
        leg = model.body(model.geom_bodyid[geom]).name[:2]
        if model.geom_group[geom] == 2 and leg in COLOURS:
            model.geom_matid[geom] = -1
            model.geom_rgba[geom] = COLOURS[leg]
    return model, mujoco.MjData(model)


def show(env, model, data):
    """Put the drawn robot where the simulated one is, on the middle tile."""
    data.qpos[:] = env.qpos[0]
    if env.ground is not None:
        data.qpos[:2] += AROUND // 2 * terrain.TILE - terrain.APRON
    mujoco.mj_forward(model, data)


def point(camera, env, model):
    """Let a camera follow the trunk, from the front right of where the robot heads now."""
    camera.type = mujoco.mjtCamera.mjCAMERA_TRACKING
    camera.trackbodyid = model.body("trunk").id
    x, y, _ = go1.motion(env.qpos, env.qvel).to_world[0, :, 0]  # the trunk's forward axis
    camera.distance, camera.elevation = 1.2, -20.0
    camera.azimuth = np.degrees(np.arctan2(y, x)) + 110.0


def asked(env, command):
    """What env's robot is asked to do, in words, or "" if its task asks for nothing."""
    x, y, yaw = command
    asks = env.task.commands().example.any()
    return f"asked {x:z.3g} m/s, {y:z.3g} m/s aside, {yaw:z.3g} rad/s" if asks else ""


def did(log):
    """What a robot does, in words."""
    return f"v_x {np.mean(log['v_x']):z.1f} m/s   {np.mean(log['power']):.0f} W"


def caption(env, log, command):
    """One line that says what env's robot does, and what it is asked to do if its task asks."""
    return f"{asked(env, command)}   {did(log)}".strip()


# ---- a window, a browser ----


def paced(steps, dt):
    """Yields what steps do, but one in each dt [s] at most."""
    start = time.monotonic()
    for log in steps:
        yield log
        time.sleep(max(0.0, start + dt - time.monotonic()))
        start = time.monotonic()


def has_display():
    """Whether a window can be opened, tried with the viewer's own library."""
    with warnings.catch_warnings(action="ignore"):  # what it says, our line says better
        works = glfw.init()
    glfw.terminate()
    return works


def window(env, steps, command, slow=1.0):
    """Show steps (an iterator of `play`) in the viewer, `slow` times slower, until it is closed."""

    def on_key(key):
        if env.task.commands().example.any():  # else it is never asked for anything
            command[:] = 0.0 if key == BACKSPACE else command + KEYS.get(key, 0.0)

    if sys.platform == "linux" and not has_display():  # the viewer would end the process
        raise Refused("there is no display: give --web or --gif FILE")
    model, data = make_scene(env)
    options = dict(key_callback=on_key, show_left_ui=False, show_right_ui=False)
    try:
        launched = mujoco.viewer.launch_passive(model, data, **options)
    except RuntimeError as error:  # it needs macOS's first thread, which only mjpython hands over
        raise Refused(f"on macOS a window needs mjpython in place of python: {error}") from None
    try:
        with launched as viewer:
            point(viewer.cam, env, model)
            for log in paced(steps, slow * env.dt):
                if not viewer.is_running():
                    break
                with viewer.lock():
                    show(env, model, data)
                viewer.set_texts((None, None, caption(env, log, command), None))
                viewer.sync()
    finally:  # also after Ctrl-C
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
    commands = env.task.commands()
    low, high = commands.low, commands.high

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


def browser(env, steps, command, port=0, slow=1.0):
    """Show steps (an iterator of `play`) to browsers on this machine, until Ctrl-C.

    port: 0 takes the first free one from 8080 on
    """
    socket.create_server(("127.0.0.1", port)).close()  # MuJoCo's error would name no port
    model, data = make_scene(env)
    said = [""]
    with launch_web(env, model, command, said, port) as handle:
        handle.set_model(model, data=data)
        for log in paced(steps, slow * env.dt):
            if not handle.is_running():
                break
            show(env, model, data)
            said[0] = caption(env, log, command)
            handle.sync()


# ---- a moving picture ----


def film(env, steps, seconds, size=SIZE, every=1):
    """Pictures (height, width, 3) uint8, of every `every`-th control step during `seconds` of the
    robot's time; and of each the means of v_x [m/s] and power [W] over the second up to it.

    size: (width, height) of the pictures
    """
    if os.environ.get("MUJOCO_GL") == "off":
        raise Refused("a GIF needs libosmesa6, or libegl1 and libgl1-mesa-dri: install one")
    model, data = make_scene(env)
    camera = mujoco.MjvCamera()
    second = round(1 / env.dt)
    logs = deque(islice(steps, second), second)  # the first second passes and is not drawn
    point(camera, env, model)
    pictures, means = [], []
    with mujoco.Renderer(model, size[1], size[0]) as renderer:
        for i, log in enumerate(islice(steps, max(1, round(seconds / env.dt)))):
            logs.append(log)
            if i % every:
                continue
            show(env, model, data)
            renderer.update_scene(data, camera)
            # on a height field the ground's own shadows would be specks
            renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = env.ground is None
            pictures.append(renderer.render())
            means.append({name: np.mean([x[name] for x in logs]) for name in ("v_x", "power")})
    return pictures, means


def save_gif(path, panels, captions, foot, milliseconds):
    """Write runs side by side into a GIF.

    panels: pictures of each run, (runs, T, height, width, 3); captions: a text for each of them;
    foot: a line below all of them; milliseconds: that each picture lasts
    """
    font = ImageFont.load_default(17)
    images = [Image.fromarray(np.concatenate(x, 1)) for x in zip(*panels, strict=True)]
    for image, texts in zip(images, zip(*captions, strict=True), strict=True):
        draw = ImageDraw.Draw(image)
        for i, text in enumerate(texts):
            draw.text((10 + i * image.width // len(texts), 6), text, (10, 10, 10), font)
        draw.text((10, image.height - 26), foot, (10, 10, 10), font)
    # one palette without dithering: colours that change would flicker
    palette = images[0].quantize(40, Image.Quantize.MAXCOVERAGE)
    first, *others = (x.quantize(dither=Image.Dither.NONE, palette=palette) for x in images)
    gif = dict(save_all=True, append_images=others, duration=milliseconds, loop=0)
    run_folder.replace_file(path, lambda file: first.save(file, "GIF", **gif))
