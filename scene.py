"""What play.py shows: one robot of a run, in a world that goes on as far as one can see; and a GIF of it."""

import itertools
from dataclasses import replace

import mujoco
import numpy as np
from PIL import Image, ImageDraw

import go1
import go1_env
import terrain

AROUND = 7  # periods of the ground that are drawn in x and in y, the robot is on the middle one
SIZE, STEPS_PER_FRAME, COLOURS = (320, 216), 3, 64  # of a GIF: two megabytes are four seconds on rough ground


def make_env(env_cfg, roughness=None):
    """One robot whose episode does not end by time, on a single tile; roughness: [m], None for the run's greatest."""
    level = env_cfg.roughness[1] if roughness is None else roughness
    changes = dict(roughness=(level, level), tiles=1, episode_steps=10**9, stagger=False)
    return go1_env.Go1Env(1, replace(env_cfg, **changes), threads=1)


def make_scene(env):
    """Model and data to draw env with: the ground goes on as far as one can see, but only the robot's tile is real."""
    ground = env.ground
    if ground is not None:
        margin = round(terrain.APRON / terrain.SPACING)
        ground = ground._replace(heights=np.tile(ground.heights[margin:-margin, margin:-margin], (AROUND, AROUND)))
    model = go1.build_model(env.env_cfg.timestep, ground)
    return model, mujoco.MjData(model)


def show(env, model, data):
    """Put the drawn robot where the simulated one is."""
    data.qpos[:], data.qvel[:] = env.qpos[0], env.qvel[0]
    if env.ground is not None:
        data.qpos[:2] += AROUND // 2 * terrain.TILE - terrain.origin(env.state.tile[0])
    mujoco.mj_forward(model, data)


def point(camera, env, model):
    """Let a camera follow the trunk, from the front right of where the robot heads now."""
    w, x, y, z = env.qpos[0, 3:7]
    camera.type, camera.trackbodyid = mujoco.mjtCamera.mjCAMERA_TRACKING, model.body("trunk").id
    camera.distance, camera.elevation = 1.7, -20.0
    camera.azimuth = 125.0 + np.degrees(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))


def caption(log, command):
    """What the robot is asked to do and does, in one line."""
    asked = "  ".join(f"{x:.1f} {unit}" for x, unit in zip(command, ("m/s", "m/s aside", "rad/s"), strict=True) if x)
    return f"{'asked ' + asked + '   ' if asked else ''}v_x {log['v_x'][0]:.1f} m/s   {log['power'][0]:.0f} W"


def save_gif(path, env, steps, seconds, command):
    """Draw `seconds` of steps (an iterator of `play`) into a GIF, after one second that is not shown."""
    model, data = make_scene(env)
    images, camera = [], mujoco.MjvCamera()
    next(itertools.islice(steps, round(1 / env.period) - 1, None))
    point(camera, env, model)
    with mujoco.Renderer(model, SIZE[1], SIZE[0]) as renderer:
        for log in itertools.islice(steps, 0, round(seconds / env.period), STEPS_PER_FRAME):
            show(env, model, data)
            renderer.update_scene(data, camera)
            image = Image.fromarray(renderer.render())
            ImageDraw.Draw(image).text((8, 6), caption(log, command), fill=(20, 20, 20))
            palette = dict(palette=images[0]) if images else dict(colors=COLOURS)  # one for all frames: smaller
            images.append(image.quantize(dither=Image.Dither.NONE, **palette))
    duration = round(1000 * env.period * STEPS_PER_FRAME)
    images[0].save(path, save_all=True, append_images=images[1:], duration=duration, loop=0)
