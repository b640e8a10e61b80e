"""How good is a trained policy? The task performance of Section V-A, on the simulator that trained it.

`python evaluate.py RUN...` prints one line per run folder: task performance (sum of Eq. (5) over an episode / 1000,
early ends count as zeros), the share of episodes that end in a fall, mean speed, power, and mean power by mean speed.
The policy is deterministic; each episode keeps one command, uniform in the task's range; noise, friction and payload
are drawn as in training; every policy starts from the same states with the same commands.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

import eipo
import go1_env
import run_folder

SEED = 2024  # of the evaluation's episodes, far from the seeds that training uses


class Episodes(NamedTuple):
    """One number per episode, (num_episodes,) each."""

    task: np.ndarray  # [-] sum of the task reward / 1000, Section V-A
    fell: np.ndarray  # bool, ended before the time limit
    v_x: np.ndarray  # [m/s] mean body velocity while the episode lasted
    power: np.ndarray  # [W] mean total power, without the survival bonus (D18)


def run_episodes(env, params):
    """One episode of every environment under the deterministic policy: Episodes.

    env: a Go1Env with stagger=False; params: as `run_folder.load_policy` returns
    """
    mean = jax.jit(lambda obs: eipo.policy(params, obs)[0])
    limit = env.config.episode_steps
    task, v_x, power, steps = np.zeros((4, env.num_envs))
    alive, fell = np.ones(env.num_envs, bool), np.zeros(env.num_envs, bool)
    obs, _ = env.reset(SEED)
    for _ in range(limit):
        obs, reward, terminated, truncated, info = env.step(np.asarray(mean(obs)))
        for total, x in ((task, reward), (v_x, info["log"]["v_x"]), (power, info["log"]["power"]), (steps, 1.0)):
            total += np.where(alive, x, 0.0)
        fell |= alive & terminated
        alive &= ~(terminated | truncated)
    return Episodes(task / limit, fell, v_x / steps, power / steps)


def evaluate(folder, num_episodes=1000, clip=None, threads=0):
    """Episodes of the policy in a run folder. num_episodes: all at once; clip: of Eq. (9), None as trained."""
    params, config = run_folder.load_policy(Path(folder) / "policy.npz")
    config = replace(config, clip=clip or config.clip)
    env = go1_env.Go1Env(num_episodes, replace(config, stagger=False, command_steps=config.episode_steps), threads)
    return run_episodes(env, params)


def main(argv):
    """Evaluate run folders; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="+", help="run folders, each with a policy.npz")
    parser.add_argument("--episodes", type=int, default=1000, help="episodes per run (default: 1000)")
    parser.add_argument("--clip", choices=("torque", "power"), help="what Eq. (9) clips (default: as in training, D3)")
    args = parser.parse_args(argv)
    try:
        print("| run | task performance | fell | v_x [m/s] | power [W] | energy [J/m] |\n|---|---|---|---|---|---|")
        for folder in args.runs:
            e = evaluate(folder, args.episodes, args.clip)
            print(f"| {folder} | {e.task.mean():.3f} | {100 * e.fell.mean():.1f} % | {e.v_x.mean():.3f} "
                  f"| {e.power.mean():.1f} | {e.power.mean() / e.v_x.mean():.0f} |", flush=True)  # fmt: skip
    except (ValueError, OSError) as error:
        print(f"evaluate.py: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
