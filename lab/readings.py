"""Readings of the paper that we do not ship, to be trained and compared: `python -m lab readings
READING [flags]`.

The flags are those of `train.py`, and each run gets its own folder with --out. The readings are:

exchange    pi also trains on the rollouts of pi_prime. A borrowed sample weighs min(1, pi /
            pi_prime), the ratio of the probabilities of its action, and `borrowed` in metrics.csv
            is the mean of that weight. Algorithm 1 as printed does not do this. The code of EIPO's
            authors and that of its successor HEPO exchange rollouts
normalised  the advantages of each stream are normalised before they are mixed, so that alpha
            lambda_0 = 1 weighs both alike whatever lambda_0 is. The lab's code does so
fixed       as normalised, with weights 1.5 : 1 for ever; for --algo ppo. The lab's code may have
            amounted to this
noisy       the exploration noise, which starts at 1, never falls below a standard deviation of 0.6.
            It asks whether a policy stands for long because it no longer tries a step
own         pi has a curriculum of commands of its own. Here the two policies share one, so
            that the successes of pi_prime also make the commands of pi harder. It asks whether pi
            stands for long because of that
yoked       PPO whose alpha is, in every iteration, that of another run, as in `readings yoked
            results/velocity/NAME --task velocity --algo ppo --lam 0.01`. There is no pi_prime. It
            asks whether EIPO is more than its schedule of alpha

Other readings need no code: `--ent-coef 0.01` is the lab's entropy bonus, `--clip torque` is Eq.
(9) as printed, and `--lr-alpha 2 --dampening-alpha 0.99` lets alpha move by 1 % of 200 in an
iteration.
"""

import math
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np

import curriculum
import eipo
import ppo
import train
from lab import record
from runtime import metrics


def normalised(stream):
    """A stream of advantages with mean 0 and standard deviation 1, any shape."""
    return (stream - stream.mean()) / (stream.std() + 1e-8)


def mix_normalised(advantage, alpha, lam):
    """`eipo.mix` of normalised streams. With lam = 0 only the task counts, as there."""
    if lam == 0:
        return advantage[..., 0]
    return alpha * lam * normalised(advantage[..., 0]) - normalised(advantage[..., 1])


def mix_fixed(advantage, alpha, lam):
    """`eipo.mix` of normalised streams with the weights 1.5 : 1."""
    return 1.5 * normalised(advantage[..., 0]) - normalised(advantage[..., 1])


def side_by_side(ours, theirs):
    """The arrays (T, N, ...) of two tuples, each pair as one (T, 2N, ...)."""
    return (jnp.concatenate(pair, 1) for pair in zip(ours, theirs, strict=True))


def exchange(env, env_prime, cfg, state=None):
    """`eipo.eipo`, where pi learns from both rollouts. Comments name the lines that differ."""
    state = state or eipo.init_state(env, env_prime, cfg)
    _, _, pi, pi_prime, dual, start, start_prime = state
    for iteration in range(state.iteration + 1, cfg.iterations + 1):
        key, key_prime, key_update, key_update_prime = eipo.iteration_keys(state.key, iteration)
        tau, start, log = eipo.rollout(env, pi.params, start, key, cfg)
        # L7: tau' keeps the cost as well, for pi
        heads = pi_prime.params | dict(critic=pi.params["critic"])
        tau_both, start_prime, log_prime = eipo.rollout(
            env_prime, heads, start_prime, key_prime, cfg
        )
        tau_prime = tau_both._replace(reward=tau_both.reward[..., :1])

        est = eipo.estimate(pi.params, tau, cfg)
        est_prime = eipo.estimate(pi_prime.params, tau_prime, cfg)
        borrowed = eipo.estimate(pi.params, tau_both, cfg)  # L8: by pi's critic
        weight = jnp.minimum(1.0, jnp.exp(borrowed.log_prob - est_prime.log_prob))
        both = eipo.Estimate(*side_by_side(est, borrowed))
        tau_pi = eipo.Rollout(*side_by_side(tau[:6], tau_both[:6]), tau.after, tau.final)
        objective = normalised(eipo.mix(both.advantage, dual.alpha, cfg.lam))
        objective *= jnp.concatenate([jnp.ones_like(weight), weight], 1)
        # L9: on twice the samples
        pi, trained = ppo.ppo_update(pi, tau_pi, both, objective, key_update, cfg)

        task = est_prime.advantage[..., 0]
        pi_prime, trained_prime = ppo.ppo_update(
            pi_prime, tau_prime, est_prime, task, key_update_prime, cfg
        )
        gap = float(eipo.estimate_J(est) - eipo.estimate_J(est_prime))
        metrics = eipo.summary(est, dual, cfg) | log | trained
        metrics |= dict(gap=gap, borrowed=weight.mean())
        metrics |= {f"prime_{name}": x for name, x in (log_prime | trained_prime).items()}
        dual = eipo.step_alpha(dual, gap, cfg)
        yield eipo.State(iteration, state.key, pi, pi_prime, dual, start, start_prime), metrics


def with_own_commands(make_envs):
    """`train.make_envs`, where each environment has a curriculum of its own."""

    def made(*args):
        envs = make_envs(*args)
        for env in envs:
            env.state.command_weights = curriculum.initial_weights()
        return envs

    return made


def alpha_of(run):
    """Iterations and alpha of a run: a run folder, or results/TASK/NAME, where every tenth is."""
    run = Path(run)
    rows = [row for row in record.read(run.parent / record.METRICS) if row["run"] == run.name]
    if not rows:
        if not (run / "metrics.csv").exists():
            raise ValueError(f"{run} has no metrics.csv: name a run folder or results/TASK/NAME")
        columns = metrics.read(run)
        return columns["iteration"], columns["alpha"]
    return [np.array([float(row[name]) for row in rows]) for name in ("iteration", "alpha")]


def yoked(ppo, iterations, alphas):
    """`eipo.ppo` with an alpha of another run, which is interpolated between its iterations."""

    def trained(env, cfg, state=None):
        state = state or eipo.init_state(env, None, cfg)
        while state.iteration < cfg.iterations:
            alpha = float(np.interp(state.iteration + 1, iterations, alphas))
            state, numbers = next(ppo(env, cfg, state._replace(dual=eipo.Dual(alpha, 0.0))))
            yield state, numbers

    return trained


def main(reading, argv):
    """Train with one reading; returns the exit status."""
    readings = ("exchange", "normalised", "fixed", "noisy", "own", "yoked")
    if reading not in readings:
        print(
            f"readings.py: unknown reading {reading!r}: choose one of {', '.join(readings)}",
            file=sys.stderr,
        )
        return 2
    if reading == "exchange":
        eipo.eipo = exchange
    elif reading == "noisy":
        ppo.LOG_STD_RANGE = math.log(0.6), ppo.LOG_STD_RANGE[1]
    elif reading == "own":
        train.make_envs = with_own_commands(train.make_envs)
    elif reading == "yoked":
        if not argv:
            raise ValueError("yoked needs the run that gives alpha: a folder, or results/TASK/NAME")
        leader, *argv = argv
        eipo.ppo = yoked(eipo.ppo, *alpha_of(leader))
    else:
        eipo.mix = dict(normalised=mix_normalised, fixed=mix_fixed)[reading]
    return train.main(argv)
