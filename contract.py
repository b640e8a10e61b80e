"""What a policy.npz promises to whoever runs the policy elsewhere: what it measures, in which frame, with which sign.

A control step, `1 / (timestep * physics_steps)` = 50 times a second, turns sensors into joint targets. README's lines
do the same. The trace in the file holds 50 such steps, so that another program can be compared with it, row by row.

| array          | width | unit       | meaning                                                                    |
|----------------|-------|------------|----------------------------------------------------------------------------|
| trace.time     | 1     | s          | since the policy was started; where it is 0, the robot starts (anew)       |
| trace.gravity  | 3     | -          | unit vector along gravity in the trunk's frame: (0, 0, -1) of a level one  |
| trace.command  | 3     | m/s, rad/s | v_x forward, v_y to the left, yaw rate to the left                         |
| trace.q        | 12    | rad        | joint angles; 0 is a straight leg that points down from a level trunk      |
| trace.qd       | 12    | rad/s      | joint speeds                                                               |
| trace.frame    | 44    | as above   | what these become, with the last target: the entries listed in go1_env.py  |
| trace.estimate | 3     | m/s        | the estimator's output: velocity of the trunk, which no sensor measures    |
| trace.action   | 12    | -          | the actor's output, clipped at +- action_limit                             |
| trace.target   | 12    | rad        | joint targets: q_nominal + action_scale * action                           |

The trunk's frame has x forward, y to the left, z up; its velocity is in this frame. A trunk with its nose up has a
negative gravity[0], one with its right side down a negative gravity[1]. Joints are FR, FL, RR, RL x hip, thigh, calf.
A positive hip angle moves the foot to the left, a positive thigh angle moves it back, and a calf's is always negative.
All hips turn about +x, all thighs and calves about +y. A frame holds the action of the step before, which is 0 at the
start. The policy sees the last H frames, the oldest first, and at the start H times the first one.
"""

from dataclasses import replace

import numpy as np

import go1
import go1_env
import networks

STEPS = 50  # control steps of the trace, 1 s


def trace(params, env_cfg):
    """The arrays of the table above, (50,) or (50, width) float32, of one robot under the policy; params: plain MLPs.

    It follows the greatest command of its task, or 1 m/s, without noise. It starts anew if it falls.
    """
    world = replace(env_cfg, noise=0.0, stagger=False, tiles=1, episode_steps=10**9)
    env, rows = go1_env.Go1Env(1, world, 1), []
    obs, _ = env.reset(0, (1.0, 0.0, 0.0) if env.task.curriculum else env.task.command_high)
    for _ in range(STEPS):
        seen = dict(time=env.period * env.state.age[0], gravity=env.felt_gravity()[0], command=env.state.command[0],
                    q=env.qpos[0, 7:], qd=env.qvel[0, 6:],
                    frame=env.state.frames[0, -1] / go1_env.FRAME_SCALE)  # fmt: skip
        row = {name: np.array(x, np.float32) for name, x in seen.items()}  # copies, because the next step changes them
        action, _, estimate = (np.asarray(x) for x in networks.policy(params, obs))
        obs, *_ = env.step(action)
        action = np.clip(action[0], -env_cfg.action_limit, env_cfg.action_limit)
        target = go1.Q_NOMINAL + go1_env.ACTION_SCALE * action
        rows.append(row | dict(estimate=estimate[0], action=action, target=target))
    return {f"trace.{name}": np.array([row[name] for row in rows], np.float32) for name in rows[0]}
