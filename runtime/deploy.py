"""policy.npz on its way from a learner to a robot: written with its trace, and tried in simulation.

`policy.py` says what the file promises, and knows nothing of how a policy is trained.
"""

from dataclasses import asdict, replace
from itertools import islice

import numpy as np

import go1
import go1_env
import mirror
import policy
import tasks
from runtime import run_folder

STEPS = 50  # control steps of the trace, 1 s
ROBOT = dict(  # what a policy has to know of its robot
    frame_scale=go1_env.FRAME_SCALE,
    q_nominal=go1.Q_NOMINAL,
    action_scale=go1_env.ACTION_SCALE,
    kp=go1.KP,
    kd=go1.KD,
)


def of_learner(learner, env, env_cfg):
    """The Policy of an eipo.Learner that learned from env, without a trace."""
    pairs = learner.params["log_std"]
    halves = np.tile(pairs, sum(np.atleast_1d(env.action_size)) // len(pairs))
    return policy.Policy(
        **mirror.plain_policy(learner.params, env),
        log_std=halves,
        **ROBOT,
        config=asdict(env_cfg),
    )


def write(path, learner, env, env_cfg, last):
    """Write policy.npz; env: what it learned from; last: whether the file gets its trace."""
    pi = of_learner(learner, env, env_cfg)
    if last:
        pi.trace = trace(pi, env_cfg)
    run_folder.replace_file(path, lambda file: policy.save(file, pi))


def load(path):
    """The Policy in a policy.npz, and the tasks.Config of its world. Its robot must be ours."""
    with run_folder.reading(path):
        pi = policy.load(path)
        other = [name for name, x in ROBOT.items() if not np.array_equal(getattr(pi, name), x)]
        if other:
            raise ValueError(f"its robot has another {', '.join(other)}")
        return pi, tasks.read_config(pi.config)


def trace(pi, env_cfg):
    """The trace of a Policy, {"time": (50,), "gravity": (50, 3), ...}, without noise.

    It follows the greatest command of its task, or 1 m/s.
    """
    world = replace(env_cfg, noise=0.0, stagger=False, tiles=1, episode_steps=10**9)
    rows = []
    command = tasks.TASKS[env_cfg.task].commands().example
    for seen, _ in islice(drive(pi, go1_env.Go1Env(1, world, 1), command), STEPS):
        target = pi.q_nominal + pi.action_scale * pi.action
        made = dict(frame=pi.frame, estimate=pi.estimate, action=pi.action, target=target)
        rows.append(seen | made)
    return {name: np.array([row[name] for row in rows], np.float32) for name in rows[0]}


def drive(pi, env, command, seed=0):
    """Let a Policy drive the one robot of env, for ever, as it would a real one.

    command: (3,) [m/s, m/s, rad/s], which the caller may change in place
    Yields of each control step what the robot measured, by its name in the trace, and env's log.
    """
    obs, _ = env.reset(seed, command)
    pi.start()
    while True:
        frame = obs[0, -go1_env.FRAME_WIDTH :] / pi.frame_scale
        gravity, _, pose, qd = np.split(frame[:30], [3, 6, 18])
        seen = dict(gravity=gravity, command=command.copy(), q=pi.q_nominal + pose, qd=qd)
        time = env.period * pi.steps
        pi.act(**seen)
        obs, _, terminated, truncated, info = env.step(pi.action[None])
        yield dict(time=time) | seen, info["log"]
        if terminated[0] or truncated[0]:
            pi.start()
