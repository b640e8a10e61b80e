"""What a policy.npz promises to whoever runs the policy elsewhere: what it measures, in which
frame, with which sign.

A control step, `1 / (timestep * physics_steps)` = 50 times a second, turns sensors into joint
targets. The lines of docs/deploy.md do the same. The trace in the file holds 50 such steps, so that
another program can be compared with it, row by row.

| array          | width | unit       | meaning                                                    |
|----------------|-------|------------|------------------------------------------------------------|
| trace.time     | 1 | s          | since the policy was started; 0 where the robot starts anew|
| trace.gravity  | 3 | -          | unit vector along gravity in the trunk's frame             |
| trace.command  | 3 | m/s, rad/s | v_x forward, v_y to the left, yaw rate to the left         |
| trace.q        | 12 | rad        | joint angles; 0: a straight leg, down from a level trunk   |
| trace.qd       | 12 | rad/s      | joint speeds                                               |
| trace.frame    | 44 | as above   | what these become, with the last target, see go1_env.py    |
| trace.estimate | 3 | m/s        | the estimator's output: the trunk's velocity, never measure|
| trace.action   | 12 | -          | the actor's output, clipped at +- action_limit             |
| trace.target   | 12 | rad        | joint targets: q_nominal + action_scale * action           |

The trunk's frame has x forward, y to the left, z up; its velocity is in this frame. A trunk with
its nose up has a negative gravity[0], one with its right side down a negative gravity[1]. Joints
are FR, FL, RR, RL x hip, thigh, calf. A positive hip angle moves the foot to the left, a positive
thigh angle moves it back, and a calf's is always negative. All hips turn about +x, all thighs and
calves about +y. A frame holds the action of the step before, which is 0 at the start. The policy
sees the last H frames, the oldest first, and at the start H times the first one.
"""

import itertools
import json
from contextlib import suppress
from dataclasses import asdict, replace

import jax
import numpy as np

import go1
import go1_env
import networks
import tasks
from mirror import make_bases
from runtime import run_folder

PLAIN = make_bases(None, go1_env.FRAME_WIDTH, 3, 12)
STEPS = 50  # control steps of the trace, 1 s


def trace(params, env_cfg):
    """The arrays of the table above, (50,) or (50, width) float32; params: of plain MLPs.

    It follows the greatest command of its task, or 1 m/s, without noise. It starts anew if it
    falls.
    """
    world = replace(env_cfg, noise=0.0, stagger=False, tiles=1, episode_steps=10**9)
    env = go1_env.Go1Env(1, world, 1)
    rows = []
    env_high = env.commands.high
    obs, _ = env.reset(0, np.minimum(env_high, 1) * [1, 0, 0])
    for _ in range(STEPS):
        seen = dict(
            time=env.period * env.state.age[0],
            gravity=env.state.frames[0, -1, :3],
            command=env.state.command[0],
            q=env.qpos[0, 7:],
            qd=env.qvel[0, 6:],
            frame=env.state.frames[0, -1] / go1_env.FRAME_SCALE,
        )
        # copies, because the next step changes them
        row = {name: np.array(x, np.float32) for name, x in seen.items()}
        action, _, estimate = (np.asarray(x) for x in networks.policy(params, obs, PLAIN))
        obs, *_ = env.step(action)
        action = np.clip(action[0], -env_cfg.action_limit, env_cfg.action_limit)
        target = go1.Q_NOMINAL + go1_env.ACTION_SCALE * action
        rows.append(row | dict(estimate=estimate[0], action=action, target=target))
    return {f"trace.{name}": np.array([row[name] for row in rows], np.float32) for name in rows[0]}


def save(path, params, env_cfg):
    """Write policy.npz, which runs without JAX and this project: docs/deploy.md shows how.

    params: of plain MLPs, as `networks.dense` returns them. The file has these arrays:

    estimator.0.W, .b ...  layers (n_in, n_out), (n_out,) with ELU between them: H * 44
                           observations -> body velocity (3) [m/s]
    actor.0.W, .b ...      layers: H * 44 observations and the estimate -> action (12) [-]
    log_std                (12,) of the noise in training; a deployed policy takes the mean
    trace.time ...         50 steps of the policy's own run: the table above
    frame_scale            (44,) SI units -> observation, see the table in go1_env.py
    q_nominal              (12,) [rad]
    action_scale           (12,) [rad]: joint targets are q_nominal + action_scale * action
    kp, kd                 [N m / rad], [N m s / rad] of the PD controller, at the physics' rate
    config                 tasks.Config as JSON: history H, timestep, physics_steps ...

    The head of this file says which frame and sign every entry has. Joints: FR, FL, RR, RL x hip,
    thigh, calf.
    """
    weights = {}
    for net in ("actor", "estimator"):
        for i, layer in enumerate(params[net]):
            weights[f"{net}.{i}.W"] = np.asarray(layer.weights[0], np.float32)
            weights[f"{net}.{i}.b"] = np.asarray(layer.bias, np.float32)
    units = dict(
        log_std=np.asarray(params["log_std"]),
        frame_scale=go1_env.FRAME_SCALE,
        q_nominal=go1.Q_NOMINAL,
        action_scale=go1_env.ACTION_SCALE,
        kp=go1.KP,
        kd=go1.KD,
    )
    arrays = weights | units | dict(config=json.dumps(asdict(env_cfg))) | trace(params, env_cfg)
    run_folder.replace_file(path, lambda file: np.savez(file, **arrays))
    path.with_name(run_folder.EPISODES).unlink(missing_ok=True)  # they were of the policy before


def load(path):
    """The parameters for `networks.policy`, and the tasks.Config, from a policy.npz."""
    arrays = run_folder.read_npz(path)

    def layers(net):
        indices = itertools.takewhile(lambda i: f"{net}.{i}.W" in arrays, itertools.count())
        return [networks.Layer((arrays[f"{net}.{i}.W"],), arrays[f"{net}.{i}.b"]) for i in indices]

    try:
        env_cfg = tasks.read_config(json.loads(str(arrays["config"])))
        params = dict(
            actor=layers("actor"), estimator=layers("estimator"), log_std=arrays["log_std"]
        )
        check_finite(params)
        obs = jax.ShapeDtypeStruct((env_cfg.history * go1_env.FRAME_WIDTH,), np.float32)
        with suppress(TypeError, ValueError):
            shapes = [x.shape for x in jax.eval_shape(networks.policy, params, obs, PLAIN)]
            if shapes == [(12,), (12,), (3,)]:
                return params, env_cfg
        raise ValueError(f"its layers do not fit each other or its history of {env_cfg.history}")
    except (LookupError, TypeError, AttributeError, ValueError, RecursionError) as error:
        raise ValueError(
            f"{path} is not a policy of this version, so train it anew: {error}"
        ) from None


def check_finite(tree):
    """Raise ValueError if an array in a tree holds anything but numbers that float32 can hold."""
    for path, x in jax.tree_util.tree_leaves_with_path(tree):
        greatest = np.finfo(np.float32).max
        if x.dtype.kind not in "biuf" or not (np.abs(x) <= greatest).all():  # nan as well
            raise ValueError(f"{jax.tree_util.keystr(path)} does not hold finite numbers")
