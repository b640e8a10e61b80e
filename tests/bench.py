"""Where the time goes: `python tests/bench.py`. Prints ratios, each of two things measured in turn in this one run.

    tasks         a step of the other tasks, on rough ground, against one of `flat`
    environment   Go1Env.step against a bare mujoco.batch loop that applies the same torques to the same states
    update        ppo_update against a large float32 matrix product, in FLOP of the networks (forward 1, backward 2)
    iteration     shares of physics, policy, host and update; steps/s of PPO and EIPO; memory

Absolute rates on a shared machine mean little. Pin with `taskset -c 0` to measure one core.
"""

import argparse
import contextlib
import resource
import sys
import time
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

ROUNDS = 7


def seconds(*functions):
    """Best time of each function over ROUNDS, called in turn so that a busy moment hits all of them."""
    times = np.full((ROUNDS, len(functions)), np.inf)
    for function in functions:
        jax.block_until_ready(function())  # warm up, compile
    for i in range(ROUNDS):
        for j, function in enumerate(functions):
            start = time.perf_counter()
            jax.block_until_ready(function())
            times[i, j] = time.perf_counter() - start
    return times.min(0)


def bench_tasks(num_envs, threads, steps=25):
    """Cost of a step of each task relative to `flat`, for robots that hold themselves up; prints it."""
    actions = 0.3 * np.random.default_rng(0).normal(size=(steps, num_envs, 12))

    def run(env):
        env.reset(0)
        for action in actions:
            env.step(action)

    envs = [go1_env.Go1Env(num_envs, tasks.task_config(task, stagger=False), threads) for task in tasks.TASKS]
    times = seconds(*(partial(run, env) for env in envs))
    costs = (f"{task} {t / times[0]:.2f}" for task, t in zip(tasks.TASKS, times, strict=True))
    print(f"tasks        cost of a step relative to flat: {', '.join(costs)} (aim 2)")


def bench_environment(num_envs, threads, steps=25):
    """Rate of Go1Env.step on `flat`, where no episode ends so soon, relative to the bare loop; prints both."""
    config = tasks.task_config("flat", stagger=False)
    env, bare = go1_env.Go1Env(num_envs, config, threads), go1_env.Go1Env(num_envs, config, threads)
    env.reset(0)
    actions = 0.3 * np.random.default_rng(0).normal(size=(steps, num_envs, 12))
    begin, torques, step = env.state(), [], env.batch.step
    env.batch.step = lambda: (torques.append(env.ctrl.copy()), step())  # record what the environment applies
    for action in actions:
        assert not np.logical_or(*env.step(action)[2:4]).any(), "an episode ended: the loops would differ"
    del env.batch.step
    env.load(begin)
    bare.load(begin)

    def full():
        env.batch.state[:] = begin["sim"]
        for action in actions:
            env.step(action)

    def loop():
        bare.batch.state[:] = begin["sim"]
        for torque in torques:
            bare.ctrl[:] = torque
            bare.batch.step()

    t_full, t_loop = seconds(full, loop)
    assert (env.batch.state == bare.batch.state).all(), "the two loops must do the same physics"
    n = num_envs * steps
    print(
        f"environment  {n / t_full:8.0f} steps/s, bare loop {n / t_loop:8.0f}: ratio {t_loop / t_full:.2f} (aim 0.80)"
    )


def bench_update(task, num_envs, threads):
    """FLOP rate of ppo_update relative to that of a matrix product; prints both."""
    cfg = eipo.Config(algo="ppo", num_envs=num_envs)
    env = go1_env.Go1Env(num_envs, tasks.task_config(task), threads)
    sizes = env.obs_size, env.privileged_size, env.action_size
    key = jax.random.key(0)
    learner = [eipo.init_learner(key, sizes, 2, cfg)]
    tau, _, _ = eipo.rollout(env, learner[0].params, eipo.start(env, 0), key, cfg)
    estimated = eipo.estimate(learner[0].params, tau, cfg)
    advantage = eipo.mix(estimated.advantage, 1 / cfg.lam, cfg.lam)

    def update():
        learner[0], log = eipo.ppo_update(learner[0], tau, estimated, advantage, key, cfg)
        return log

    a = jnp.ones((1024, 1024))
    product = jax.jit(lambda a: a @ a)
    forward = sum(2 * w.size for w in jax.tree.leaves(learner[0].params) if w.ndim == 2)  # FLOP of one sample
    work = 3 * forward * cfg.num_epochs * cfg.num_steps * num_envs
    t_update, t_product = seconds(update, lambda: product(a))
    rate, peak = work / t_update, 2 * 1024**3 / t_product
    print(
        f"update       {rate / 1e9:8.0f} GFLOP/s, matrix product {peak / 1e9:4.0f}: ratio {rate / peak:.2f} (aim 0.70)"
    )


def bench_iteration(algo, task, num_envs, threads, iterations=6):
    """Shares of an iteration and steps/s; prints them."""
    spent = {}

    def timed(owner, function, name):
        inner = getattr(owner, function)

        def wrapped(*args):
            start = time.perf_counter()
            result = jax.block_until_ready(inner(*args))
            spent[name] = spent.get(name, 0.0) + time.perf_counter() - start
            return result

        return mock.patch.object(owner, function, wrapped)

    policies = 2 if algo == "eipo" else 1
    env_config = tasks.task_config(task)
    envs = [go1_env.Go1Env(num_envs // policies, env_config, threads) for _ in range(policies)]
    cfg = eipo.Config(algo=algo, num_envs=num_envs, iterations=3 + iterations)
    with contextlib.ExitStack() as stack:
        for env in envs:
            stack.enter_context(timed(env.batch, "step", "physics"))
        stack.enter_context(timed(eipo, "act", "policy"))
        stack.enter_context(timed(eipo, "rollout", "rollout"))
        for state, _ in eipo.eipo(*(*envs, None)[:2], cfg):
            jax.block_until_ready(state.pi)
            if state.iteration == 3:  # compiled by now
                start = time.perf_counter()
                spent.clear()
    total = time.perf_counter() - start
    rollout = spent.pop("rollout")
    shares = spent | dict(host=rollout - sum(spent.values()), update=total - rollout)
    rate = iterations * cfg.num_steps * num_envs / total
    print(f"{algo:12} {rate:8.0f} steps/s:", ", ".join(f"{name} {100 * t / total:.0f} %" for name, t in shares.items()))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--task", choices=tasks.TASKS, default="flat")
    parser.add_argument("--num-envs", type=int, default=256)
    parser.add_argument("--threads", type=int, default=0, help="of the physics; 0 takes every core")
    args = parser.parse_args()
    bench_tasks(args.num_envs, args.threads)
    bench_environment(args.num_envs, args.threads)
    bench_update(args.task, args.num_envs, args.threads)
    for algo in ("ppo", "eipo"):
        bench_iteration(algo, args.task, args.num_envs, args.threads)
    print(f"memory       {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GB at most (aim 2)")
