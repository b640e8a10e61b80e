"""Readings of Algorithm 1's lines 12 and 13 that we do not ship: `python results/alpha/arms.py ARM [train.py's flags]`.

a    the default: alpha starts at 1 / lambda_0, momentum as in torch
b    lambda_0 stays, its weight starts at 1, and momentum is dampened. In our units that is alpha from 1 / lambda_0
     with a step 0.01 / lambda_0, so alpha moves by 1 % of its start per iteration at most
c    a, but the advantages of each stream are normalised before they are mixed, as the lab's code does it
d    the control of c: normalised streams, fixed weights 1.5 : 1, no pi' and so no alpha. What the lab's code may
     have amounted to (lab code: its alpha is the sum of normalised advantages, which is zero)
e    a, from a lambda_0 ten times as large as the task's (`ppo10`, PPO with it, beside it)
f    our remedy for alphas of any size: the step of b, but relative to alpha itself, not to its start
ppo  PPO(lambda_0), and ppo0 PPO(0), beside them
"""

import sys
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

import eipo
import train

ARMS = ("a", "b", "c", "d", "e", "f", "ppo", "ppo0", "ppo10")


def normalised(stream):
    """A stream of advantages with mean 0 and standard deviation 1, any shape."""
    return (stream - stream.mean()) / (stream.std() + 1e-8)


def mix_normalised(advantage, alpha, lam):
    """eipo.mix on normalised streams: alpha lam is 1 at the start."""
    return alpha * lam * normalised(advantage[..., 0]) - normalised(advantage[..., 1])


def mix_fixed(advantage, alpha, lam):
    """eipo.mix on normalised streams with the fixed weights 1.5 : 1."""
    return mix_normalised(advantage, 1.5, 1.0)


def step_relative(dual, gap, cfg):
    """eipo.step_alpha on log alpha, momentum dampened: alpha moves by 1 % per iteration at most, and stays positive."""
    if not np.isfinite(gap):
        return dual
    gradient = np.clip(-gap, -cfg.clip_alpha, cfg.clip_alpha)
    velocity = cfg.momentum_alpha * dual.velocity + (1 - cfg.momentum_alpha) * gradient
    return eipo.Dual(float(dual.alpha * np.exp(cfg.lr_alpha * velocity)), float(velocity))


def main(arm, argv):
    """Train one arm; returns the exit status."""
    if arm not in ARMS:
        print(f"arms.py: unknown arm {arm!r}: choose one of {', '.join(ARMS)}", file=sys.stderr)
        return 2
    _, given_env, given_learner = train.parse(argv)
    lam = train.settle(given_env, given_learner)[1].lam
    if arm == "b":
        argv = ["--lr-alpha", f"{0.01 / lam:g}", "--dampening-alpha", "0.99", *argv]
    if arm in ("e", "ppo10", "ppo0"):
        argv = [*argv, "--lam", f"{dict(ppo0=0).get(arm, 10) * lam:g}"]
    if arm in ("d", "ppo", "ppo0", "ppo10"):
        argv = ["--algo", "ppo", *argv]
    if arm == "f":
        eipo.eipo = partial(eipo.eipo, step_alpha=step_relative)
    eipo.mix = dict(c=mix_normalised, d=mix_fixed).get(arm, eipo.mix)
    return train.main(argv)


if __name__ == "__main__":
    sys.exit(main("".join(sys.argv[1:2]), sys.argv[2:]))
