"""Where the time goes: `python tests/bench.py` prints ratios, each of two things measured in this one run.

    environment   Go1Env.step of every task against that of `flat`, and what mujoco.batch alone takes of it
    update        ppo_update against a large float32 matrix product, in FLOP of the networks (forward 1, backward 2)
    iteration     shares of physics, policy, host and update; steps/s of PPO and EIPO; memory

Absolute rates on a shared machine mean little. `taskset -c 0` measures one core, of physics and of JAX.
"""

import argparse
import contextlib
import resource
import sys
import timeit
from functools import partial
from pathlib import Path
from unittest import mock

sys.path.insert(0, str(Path(__file__).parents[1]))

import jax
import jax.numpy as jnp
import numpy as np

import eipo
import go1_env
import tasks

ROUNDS, STEPS = 7, 25  # how often something is measured; steps of an environment each time


@contextlib.contextmanager
def watch(**places):
    """Yields a dict of the seconds spent in each of some places: name=(owner, function), looked up when called."""
    spent = dict.fromkeys(places, 0.0)

    def timed(name, function, *args):
        start = timeit.default_timer()
        result = jax.block_until_ready(function(*args))
        spent[name] += timeit.default_timer() - start
        return result

    with contextlib.ExitStack() as stack:
        for name, (owner, function) in places.items():
            stack.enter_context(mock.patch.object(owner, function, partial(timed, name, getattr(owner, function))))
        yield spent


def bench_environment(args):
    """For each task the cost of a step relative to `flat`, and the rate relative to its physics alone; prints both."""
    actions = 0.3 * np.random.default_rng(0).normal(size=(STEPS, args.num_envs, 12))  # robots hold themselves up
    envs = [go1_env.Go1Env(args.num_envs, tasks.task_config(task, stagger=False)) for task in tasks.TASKS]
    times = np.empty((ROUNDS, len(envs), 2))
    for i, j in np.ndindex(ROUNDS, len(envs)):  # in turn, so that a busy moment hits all of them
        envs[j].reset(0)
        with watch(step=(envs[j], "step"), physics=(envs[j].batch, "step")) as spent:
            for action in actions:
                envs[j].step(action)
        times[i, j] = spent["step"], spent["physics"]
    step, physics = times.min(0).T
    for task, cost, ratio in zip(tasks.TASKS, step / step[0], physics / step, strict=True):
        print(f"{task:12} a step costs {cost:.2f} of a flat one (aim 2), physics is {ratio:.2f} of it (aim 0.80)")


def bench_update(args):
    """FLOP rate of ppo_update relative to that of a matrix product; prints both."""
    cfg = eipo.Config(algo="ppo", num_envs=args.num_envs)
    env = go1_env.Go1Env(args.num_envs, tasks.task_config(args.task))
    key = jax.random.key(0)
    learner = [eipo.init_learner(key, (env.obs_size, env.privileged_size, env.action_size), 2, cfg)]
    tau, _, _ = eipo.rollout(env, learner[0].params, eipo.start(env, 0), key, cfg)
    estimated = eipo.estimate(learner[0].params, tau, cfg)
    advantage = eipo.mix(estimated.advantage, 1 / cfg.lam, cfg.lam)

    def update():
        learner[0], log = eipo.ppo_update(learner[0], tau, estimated, advantage, key, cfg)
        return jax.block_until_ready(log)

    a, product = jnp.ones((1024, 1024)), jax.jit(lambda a: a @ a)
    forward = sum(2 * w.size for w in jax.tree.leaves(learner[0].params) if w.ndim == 2)  # FLOP of one sample
    work = 3 * forward * cfg.num_epochs * cfg.num_steps * args.num_envs
    both = update, lambda: product(a).block_until_ready()
    times = [[timeit.timeit(f, number=1) for f in both] for _ in range(ROUNDS + 1)]  # in turn; the first compiles
    t_update, t_product = np.min(times[1:], 0)
    rate, peak = work / t_update / 1e9, 2 * 1024**3 / t_product / 1e9
    print(f"update       {rate:8.0f} GFLOP/s, matrix product {peak:4.0f}: ratio {rate / peak:.2f} (aim 0.70)")


def bench_iteration(args, warm_up=2):
    """Shares of an iteration and steps/s of PPO and of EIPO, and the memory of both; prints them."""
    iterations = max(2, 2048 // args.num_envs)  # about as many steps with few environments as with many
    for algo, policies in (("ppo", 1), ("eipo", 2)):
        envs = [go1_env.Go1Env(args.num_envs // policies, tasks.task_config(args.task)) for _ in range(policies)]
        cfg = eipo.Config(algo=algo, num_envs=args.num_envs, iterations=warm_up + iterations)
        places = {f"physics{i}": (env.batch, "step") for i, env in enumerate(envs)}
        with watch(policy=(eipo, "act"), rollout=(eipo, "rollout"), **places) as spent:
            for state, _ in eipo.eipo(*(*envs, None)[:2], cfg):
                jax.block_until_ready(state.pi)
                if state.iteration == warm_up:  # compiled by now
                    start = timeit.default_timer()
                    spent.update(dict.fromkeys(spent, 0.0))
        total = timeit.default_timer() - start
        shares = dict(physics=sum(spent[name] for name in places), policy=spent["policy"])
        shares |= dict(host=spent["rollout"] - sum(shares.values()), update=total - spent["rollout"])
        shares = ", ".join(f"{name} {t / total:.0%}" for name, t in shares.items())
        print(f"{algo:12} {iterations * cfg.num_steps * cfg.num_envs / total:8.0f} steps/s: {shares}")
    print(f"memory       {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GB at most (aim 2)")


PARTS = dict(environment=bench_environment, update=bench_update, iteration=bench_iteration)

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", choices=PARTS)
    parser.add_argument("--task", choices=tasks.TASKS, default="flat")
    parser.add_argument("--num-envs", type=int, default=256)
    args = parser.parse_args()
    for part in [args.only] if args.only else PARTS:
        PARTS[part](args)
