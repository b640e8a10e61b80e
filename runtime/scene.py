"""One robot of an environment as MuJoCo draws it, in a world that goes on as far as one can see."""

import mujoco
import numpy as np

import go1
import terrain

NEWTON, ORANGE = 0.004, (255, 115, 0)  # of the arrows for contact forces: m per newton, and colour
AROUND = 7  # tiles of ground that are drawn in x and in y; the robot is on the middle one


def make_scene(env):
    """Model and data to draw env with. The robot's tile is repeated, so that the ground goes on as far as one sees."""
    ground = env.ground
    if ground is not None:
        margin = round(terrain.APRON / terrain.SPACING)
        ground = np.tile(ground[margin:-margin, margin:-margin], (AROUND, AROUND))
    model = go1.build_model(env.env_cfg.timestep, ground, env.robot)
    model.vis.map.force, model.vis.rgba.contactforce[:3] = NEWTON, np.array(ORANGE) / 255
    return model, mujoco.MjData(model)


def show(env, model, data):
    """Put the drawn robot where the simulated one is, on the middle tile; the same torques make the same forces."""
    state = env.state
    model.body_mass[:], model.body_ipos[:], model.geom_friction[:] = state.mass[0], state.com[0], state.friction[0]
    model.body_subtreemass[1] = state.mass[0].sum()  # of the trunk and its legs: the camera looks at their centre
    model.opt.gravity[:] = state.gravity[0]
    data.qpos[:], data.qvel[:], data.ctrl[:] = env.qpos[0], env.qvel[0], env.ctrl[0]
    if env.ground is not None:
        data.qpos[:2] += AROUND // 2 * terrain.TILE - terrain.origin(state.tile[0])
    mujoco.mj_forward(model, data)


def point(camera, env, model):
    """Let a camera follow the trunk, from the front right of where the robot heads now."""
    w, x, y, z = env.qpos[0, 3:7]
    camera.type, camera.trackbodyid = mujoco.mjtCamera.mjCAMERA_TRACKING, model.body("trunk").id
    camera.distance, camera.elevation = 1.7, -20.0
    camera.azimuth = 125.0 + np.degrees(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))


def caption(log, command):
    """One line that says what the robot is asked to do and what it does."""
    asked = "  ".join(f"{x:.1f} {unit}" for x, unit in zip(command, ("m/s", "m/s aside", "rad/s"), strict=True) if x)
    return f"{'asked ' + asked + '   ' if asked else ''}v_x {log['v_x'][0]:.1f} m/s   {log['power'][0]:.0f} W"
