"""Does noise drive alpha? `python -m lab gap RUN...` compares pi and pi' with their exploration
noise and without it.

In training alpha follows the gap between two noisy policies, and what is evaluated in the end has
no noise. Both policies of a run's last checkpoint go on from where their robots are, in the world
of training. Rewards are of the task, per step, and `training_gap` is the one of lambda-returns that
alpha followed in the last iterations.
"""

from pathlib import Path

import jax
import numpy as np

import eipo
import evaluate
import train
from runtime import metrics, run_folder

WARM_UP = 50  # control steps, 1 s, in which robots get used to another policy
STEPS = 500  # control steps, 10 s
LAST = 100  # iterations over which training's own gap is averaged


def mean_reward(env, params, start, noisy):
    """Mean task reward per step of a policy that goes on from `start`, see `eipo.rollout`."""
    obs = start[0]
    rewards = []
    for t in range(WARM_UP + STEPS):
        if noisy:
            action = eipo.act(params, obs, jax.random.key(evaluate.SEED), t)
        else:
            action = evaluate.mean_action(params, obs)
        obs, reward, *_ = env.step(np.asarray(action))
        rewards.append(reward.mean())
    return float(np.mean(rewards[WARM_UP:]))


def row(folder):
    """Columns of a run folder of EIPO: rewards of pi and pi', with noise and without, and gaps."""
    folder = Path(folder)
    env_cfg, cfg = run_folder.load_config(folder)
    if cfg.algo != "eipo":
        raise ValueError(f"{folder} is a run of PPO: it has no pi'")
    columns = dict(run=folder.name)
    for name, noisy in (("noisy", True), ("quiet", False)):
        envs = train.make_envs(env_cfg, cfg, None)  # restored anew, so that both start alike
        template = eipo.init_state(*envs, cfg)
        state = run_folder.load_checkpoint(folder / "checkpoint.npz", template, envs)
        sides = zip(envs, (state.pi, state.pi_prime), (state.start, state.start_prime), strict=True)
        pi, prime = (mean_reward(env, side.params, start, noisy) for env, side, start in sides)
        columns |= {f"{name}_pi": pi, f"{name}_prime": prime, f"{name}_gap": pi - prime}
    gaps = metrics.read(folder).get("gap", np.array([np.nan]))  # a file without rows has none
    columns["training_gap"] = float(gaps[-LAST:].mean())
    return columns | dict(same_sign=columns["quiet_gap"] * columns["noisy_gap"] > 0)
