"""Trained policies, measured as in Sections IV-D and V: episodes under the deterministic policy.

Each episode keeps one command. It starts from a random pose as in training, or from the nominal one. Noise, friction
and payload are drawn as in training, but the ground is new (D42). Every policy starts from the same draws.
`studies/statistics.py` makes numbers of them.
"""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

import go1_env
import networks
from runtime import policy_file

SEED = 2024  # of the evaluation's episodes, far from the seeds that training uses
EPISODE_STEPS = 1000  # control steps, 20 s, Section V-A
SLOW = 0.05  # m/s, below which a robot has no energy per velocity (D27)
PEAK_STEPS = 10  # control steps, 0.2 s, over which the second peak velocity is averaged (D18)
FORWARD = np.array([(x / 10, 0.0, 0.0) for x in range(11)])  # commands of Figs. 2 to 4, v_x [m/s]

watchers = []  # of progress: called with True after each step that is played, with False for episodes that are known


class Episodes(NamedTuple):
    """What is measured of N episodes (D42): one number of each, (N,). Speed ahead is over ground (D25, D27)."""

    performance: np.ndarray  # [-] sum of the task reward / 1000, Section V-A; the time after a fall counts as 0
    fell: np.ndarray  # 0 or 1, whether the episode ended before the time limit
    v_x: np.ndarray  # [m/s] mean speed ahead while the episode lasted
    v_x_late: np.ndarray  # [m/s] the same in the second half of the time limit; NaN if the episode ended before it
    power: np.ndarray  # [W] mean of mechanical power, heating and battery, Eq. (9), without the survival bonus (D18)
    energy: np.ndarray  # [J/m] power / v_x (D18, D27); NaN for a robot that is slower than SLOW
    peak: np.ndarray  # [m/s] largest speed ahead (D18)
    peak_sustained: np.ndarray  # [m/s] largest mean speed ahead of 0.2 s (D18)
    pitch: np.ndarray  # [degrees] mean pitch of the trunk, positive with the nose up
    roll: np.ndarray  # [degrees] mean roll of the trunk, positive with the right side down


@jax.jit
def mean_action(params, obs):
    """The action (N, 12) [-] for obs (N, D), without exploration noise (D42); params: as for networks.policy."""
    return networks.policy(params, obs)[0]


def deterministic(params):
    """The policy that is evaluated and shown: a function of obs (N, D) that returns actions (N, 12) [-] in NumPy."""
    return lambda obs: np.asarray(mean_action(params, obs))


def evaluated(env_cfg, clip=None, roughness=None, nominal=False):
    """The Config in which a policy that was trained with env_cfg is evaluated; other arguments are those of `load`."""
    return replace(env_cfg, reward="paper", frame="heading", stagger=False,
                   episode_steps=EPISODE_STEPS, command_steps=EPISODE_STEPS,
                   start_spread=0.0 if nominal else env_cfg.start_spread,
                   clip=clip or env_cfg.clip, ground_seed=SEED,
                   roughness=env_cfg.roughness if roughness is None else (roughness, roughness))  # fmt: skip


def load(folder, num_episodes, clip=None, roughness=None, nominal=False, threads=None, robot=None, **changes):
    """The `deterministic` policy of a run folder, and a Go1Env to try it in, with one robot for each episode.

    clip, roughness: of Eq. (9), and [m] of the ground; None for either is as in training
    nominal: start from the nominal pose at rest, not from random poses and velocities as in training (D35)
    robot, changes: another model of the robot, see Go1Env, and fields of its Config that differ from training
    """
    params, env_cfg = policy_file.load(Path(folder) / "policy.npz")
    world = replace(evaluated(env_cfg, clip, roughness, nominal), **changes)
    return deterministic(params), go1_env.Go1Env(num_episodes, world, threads, robot)


def steps(policy, env, command=None):
    """One episode of every robot; yields, per step, reward, log, who was still in the episode, and who fell now.

    command: (N, 3) [m/s, m/s, rad/s] that the episodes keep; with None the task draws one for each
    """
    obs, _ = env.reset(SEED, command)
    alive = np.ones(env.num_envs, bool)
    for _ in range(env.env_cfg.episode_steps):
        obs, reward, terminated, truncated, info = env.step(policy(obs))
        yield reward, info["log"], alive, alive & terminated
        alive = alive & ~(terminated | truncated)
        for watch in watchers:
            watch(True)


def energy_per_metre(power, v_x):
    """Energy per velocity [J/m] of power [W] and speed ahead v_x [m/s], both (N,). NaN if slower than SLOW (D27)."""
    return np.divide(power, v_x, out=np.full(len(v_x), np.nan), where=v_x > SLOW)


def run_episodes(policy, env, command=None):
    """The Episodes of all robots of env. Arguments are those of `steps`."""
    limit, totals, late = env.env_cfg.episode_steps, np.zeros((6, env.num_envs)), np.zeros((2, env.num_envs))
    recent, fell = np.zeros((PEAK_STEPS, env.num_envs)), np.zeros(env.num_envs, bool)
    peak, sustained = np.full((2, env.num_envs), -np.inf)
    for t, (reward, log, alive, falls) in enumerate(steps(policy, env, command)):
        v_x = log["v_x"]
        ones = np.ones(env.num_envs)
        totals += np.where(alive, [reward, v_x, log["power"], log["pitch"], log["roll"], ones], 0.0)
        if t >= limit // 2:
            late += np.where(alive, [v_x, ones], 0.0)
        fell |= falls
        recent[t % PEAK_STEPS] = v_x
        peak = np.where(alive, np.maximum(peak, v_x), peak)
        if t + 1 >= PEAK_STEPS:
            sustained = np.where(alive, np.maximum(sustained, recent.mean(0)), sustained)
    performance, length = totals[0] / limit, totals[-1]
    v_x, power, pitch, roll = totals[1:-1] / length
    v_x_late = np.divide(late[0], late[1], out=np.full(env.num_envs, np.nan), where=late[1] > 0)
    energy = energy_per_metre(power, v_x)
    return Episodes(performance, fell, v_x, v_x_late, power, energy, peak, sustained, pitch, roll)
