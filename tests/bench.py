"""Where the time goes: `python tests/bench.py` prints ratios, each of two things measured in this
one run.

    environment   Go1Env.step of every task against that of `flat`, and what mujoco.batch alone
                  takes of it
    iteration     steps/s of PPO and EIPO, shares of physics, policy, host and update; ppo_update
                  against a float32 matrix product, in FLOP of the networks (forward 1, backward 2);
                  memory

Absolute rates on a shared machine mean little. `taskset -c 0` measures one core, of physics and of
JAX.
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
    """Yields a dict of the seconds of each call of some places: name=(owner, function), looked up
    when called.
    """
    spent = {name: [] for name in places}

    def timed(name, function, *args):
        start = timeit.default_timer()
        result = jax.block_until_ready(function(*args))
        spent[name].append(timeit.default_timer() - start)
        return result

    with contextlib.ExitStack() as stack:
        for name, (owner, function) in places.items():
            stack.enter_context(
                mock.patch.object(owner, function, partial(timed, name, getattr(owner, function)))
            )
        yield spent


def bench_environment(args):
    """For each task the cost of a step relative to `flat`, and the rate relative to its physics
    alone; prints both.
    """
    # robots hold themselves up
    actions = 0.3 * np.random.default_rng(0).normal(size=(STEPS, args.num_envs, 12))
    envs = [
        go1_env.Go1Env(args.num_envs, tasks.task_config(task, stagger=False))
        for task in tasks.TASKS
    ]
    times = np.empty((ROUNDS, len(envs), 2))
    for i, j in np.ndindex(ROUNDS, len(envs)):  # in turn, so that a busy moment hits all of them
        envs[j].reset(0)
        with watch(step=(envs[j], "step"), physics=(envs[j].batch, "step")) as spent:
            for action in actions:
                envs[j].step(action)
        times[i, j] = sum(spent["step"]), sum(spent["physics"])
    step, physics = times.min(0).T
    for task, cost, ratio in zip(tasks.TASKS, step / step[0], physics / step, strict=True):
        print(
            f"{task:12} a step costs {cost:.2f} of a flat one (aim 2), physics is "
            f"{ratio:.2f} of it (aim 0.80)"
        )


def bench_iteration(args, warm_up=2):
    """Steps/s of PPO and of EIPO and what takes the time, their FLOP rate in ppo_update, and
    memory; prints them.
    """
    # about as many steps with few environments as with many
    iterations = max(2, 2048 // args.num_envs)
    a, matmul = jnp.ones((1024, 1024)), jax.jit(jnp.matmul)
    for algo, policies in (("ppo", 1), ("eipo", 2)):
        envs = [
            go1_env.Go1Env(args.num_envs // policies, tasks.task_config(args.task))
            for _ in range(policies)
        ]
        sizes = dict(num_envs=args.num_envs, iterations=warm_up + iterations)
        cfg = eipo.Config(algo=algo, mirror=args.mirror, **sizes)
        run = eipo.eipo(*envs, cfg) if policies == 2 else eipo.ppo(*envs, cfg)
        state, _ = [next(run) for _ in range(warm_up)][-1]  # compiled by now
        # FLOP of one sample
        forward = sum(2 * w.size for w in jax.tree.leaves(state.pi.params) if w.ndim == 2)
        places = dict(policy=(eipo, "act"), rollout=(eipo, "rollout"), update=(eipo, "ppo_update"))
        places |= {f"physics{i}": (env.batch, "step") for i, env in enumerate(envs)}
        both = partial(next, run), lambda: matmul(a, a).block_until_ready()
        with watch(**places) as spent:  # in turn, so that a busy moment hits both
            times = np.array(
                [[timeit.timeit(f, number=1) for f in both] for _ in range(iterations)]
            )
        seconds, total = {name: sum(t) for name, t in spent.items()}, times[:, 0].sum()
        shares = dict(
            physics=sum(seconds[f"physics{i}"] for i in range(policies)), policy=seconds["policy"]
        )
        shares |= dict(
            host=seconds["rollout"] - sum(shares.values()), update=total - seconds["rollout"]
        )
        shares = ", ".join(f"{name} {t / total:.0%}" for name, t in shares.items())
        steps = cfg.num_steps * cfg.num_envs
        rate = 3 * forward * cfg.num_epochs * steps / policies / min(spent["update"])
        ratio = rate / (2 * 1024**3 / times[:, 1].min())
        print(f"{algo:12} {iterations * steps / total:8.0f} steps/s: {shares}")
        print(f"update       {rate / 1e9:8.0f} GFLOP/s, {ratio:.2f} of a matrix product (aim 0.70)")
    print(
        f"memory       {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GB "
        "at most (aim 2)"
    )


PARTS = dict(environment=bench_environment, iteration=bench_iteration)

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", choices=PARTS)
    parser.add_argument("--task", choices=tasks.TASKS, default="flat")
    parser.add_argument(
        "--mirror", action=argparse.BooleanOptionalAction, default=True, help="tied networks (D28)"
    )
    parser.add_argument("--num-envs", type=int, default=256)
    args = parser.parse_args()
    for part in [args.only] if args.only else PARTS:
        PARTS[part](args)
