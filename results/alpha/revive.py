"""What keeps a policy standing? `python results/alpha/revive.py RUN` makes one part of its learner new, and trains on.

Each time from the checkpoint of RUN, a run of EIPO, with alpha held where the run left it and pi' left out. Prints a
Markdown row per remedy: the batch mean of the task reward, and the policy's noise, over 20 iterations each.
"""

import sys
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

import eipo
import go1_env
import run_folder

AFTER = (20, 100, 200)  # iterations


def renew(part, pi, fresh, cfg):
    """The Learner pi with one part of it taken from the Learner fresh."""
    actor, network = pi.params["actor"], fresh.params
    params = {
        "noise": pi.params | dict(actor=actor | dict(log_std=network["actor"]["log_std"])),
        "actor, noise kept": pi.params | dict(actor=network["actor"] | dict(log_std=actor["log_std"])),
        "actor and noise": pi.params | dict(actor=network["actor"]),
        "critic": pi.params | dict(critic=network["critic"]),
        "everything": network,
    }.get(part, pi.params)
    if part in ("nothing", "noise"):
        return pi._replace(params=params)
    return eipo.Learner(params, eipo.optimizer(cfg).init(params), jnp.float32(cfg.lr))


def load(run):
    """The State of a run of EIPO without its pi', pi's environments in that state, and a Config to go on with."""
    env_cfg, cfg = run_folder.load_config(run)
    envs = [go1_env.Go1Env(cfg.num_envs // 2, env_cfg, 1) for _ in range(2)]
    state = run_folder.load_checkpoint(run / "checkpoint.npz", next(eipo.eipo(*envs, cfg))[0], envs)
    cfg = replace(cfg, algo="ppo", num_envs=cfg.num_envs // 2, iterations=state.iteration + AFTER[-1])
    return state._replace(pi_prime=None, at_prime=None), envs[0], cfg


def train(run, part):
    """Task reward and noise of every iteration (n, 2)."""
    state, env, cfg = load(run)
    fresh = eipo.init_learner(jax.random.key(1), (env.obs_size, env.privileged_size, env.action_size), 2, cfg)
    state = state._replace(pi=renew(part, state.pi, fresh, cfg))
    return np.array([(log["reward"], log["std"]) for _, log in eipo.eipo(env, None, cfg, resume=state) if log])


if __name__ == "__main__":
    if len(sys.argv) != 2 or not (Path(sys.argv[1]) / "checkpoint.npz").exists():
        sys.exit("revive.py: give the folder of a run that has a checkpoint.npz")
    print("| new | " + " | ".join(f"after {x}" for x in AFTER) + " |\n|" + "---|" * (len(AFTER) + 1))
    for part in ("nothing", "optimiser", "noise", "critic", "actor, noise kept", "actor and noise", "everything"):
        log = train(Path(sys.argv[1]), part)
        cells = (log[x - 20 : x].mean(0) for x in AFTER)
        print(f"| {part} | " + " | ".join(f"{reward:.2f} ({noise:.2f})" for reward, noise in cells) + " |", flush=True)
