"""What play.py shows: one robot of a run, and a world to draw it in that goes on as far as one can see."""

from dataclasses import replace

import mujoco
import numpy as np

import go1
import go1_env
import terrain

AROUND = 7  # periods of the ground that are drawn in x and in y, the robot is on the middle one


def make_env(config, roughness=None):
    """One robot whose episode does not end by time, on a single tile; roughness: [m], None for the run's greatest."""
    level = config.roughness[1] if roughness is None else roughness
    changes = dict(roughness=(level, level), tiles=1, episode_steps=10**9, stagger=False)
    return go1_env.Go1Env(1, replace(config, **changes), threads=1)


def make_scene(env):
    """Model and data to draw env with: the ground goes on as far as one can see, but only the robot's tile is real."""
    ground = env.ground
    if ground is not None:
        margin = round(terrain.APRON / terrain.SPACING)
        ground = ground._replace(heights=np.tile(ground.heights[margin:-margin, margin:-margin], (AROUND, AROUND)))
    model = go1.build_model(env.config.timestep, ground)
    return model, mujoco.MjData(model)


def show(env, model, data):
    """Put the drawn robot where the simulated one is."""
    data.qpos[:], data.qvel[:] = env.qpos[0], env.qvel[0]
    if env.ground is not None:
        data.qpos[:2] += AROUND // 2 * terrain.TILE - terrain.origin(env.tile[0])
    mujoco.mj_forward(model, data)


def point(camera, env, model):
    """Let a camera follow the trunk, from the front right of where the robot heads now."""
    w, x, y, z = env.qpos[0, 3:7]
    camera.type, camera.trackbodyid = mujoco.mjtCamera.mjCAMERA_TRACKING, model.body("trunk").id
    camera.distance, camera.elevation = 1.7, -20.0
    camera.azimuth = 125.0 + np.degrees(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
