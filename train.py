"""The command line: `python train.py --task flat` trains a policy and keeps everything in a run
folder.

`runtime/flags.py` has the flags, and `runtime/run_folder.py` says what is in a run folder. A run
that was stopped, by Ctrl-C or by kill -9, goes on from its last checkpoint with --resume, and ends
with the same bits as one that was never stopped.
"""

import json
import os
import shlex
import signal
import sys
import zlib
from contextlib import nullcontext
from dataclasses import asdict, replace
from pathlib import Path

if __name__ == "__main__":
    os.environ["MUJOCO_GL"] = "off"  # no robot is drawn, so nothing that draws needs to work
    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
        # until there is something to save, Ctrl-C ends the process at once: imports take seconds
        signal.signal(signal.SIGINT, signal.SIG_DFL)

import jax
import numpy as np

import eipo
import go1_env
import tasks
from runtime import deploy, metrics, parallel, run_folder
from runtime.flags import Options, check, parse, settle
from runtime.interrupt import StopRequest


def run_path(options, env_cfg, cfg):
    """The run folder: what --out says, or a name of task, algorithm, lambda, variant and seed."""
    variant = "".join(f"-{x}" for x in (env_cfg.aux, env_cfg.reward) if x in ("smooth", "shaped"))
    usual = tasks.TASKS[env_cfg.task].learner.get("num_envs", eipo.Config.num_envs)
    variant += f"-{cfg.num_envs}envs" if cfg.num_envs != usual else ""
    name = f"{env_cfg.task}-{cfg.algo}-lam{cfg.lam:g}{variant}-seed{cfg.seed}"
    return Path(options.out or f"runs/{name}")


def resumed_settings(folder, given, processes):
    """Both Configs and JAX's threads of the run in folder, with more iterations if given.

    given: the fields of both Configs that the command line sets. ValueError if the run has others.
    """
    env_cfg, cfg, threads, was = run_folder.load_settings(folder / "checkpoint.npz")
    if was != processes:
        raise ValueError(f"{folder} is a run on {was} process(es): --resume needs as many")
    settings = asdict(env_cfg) | asdict(cfg)
    for name, x in given.items():
        if x != settings[name] and not (name == "iterations" and x > settings[name]):
            what = f"{folder} runs with --{name.replace('_', '-')} {settings[name]}"
            raise ValueError(f"{what}: --resume can only raise iterations")
    return env_cfg, replace(cfg, iterations=given.get("iterations", cfg.iterations)), threads


def pin_jax_threads(began_with):
    """Let JAX use as many threads as when the run began: its last digits depend on their number.

    began_with: text, or None for a new run. JAX reads it once, before it computes anything.
    """
    name = run_folder.JAX_THREADS
    now = os.environ.setdefault(name, began_with or str(go1_env.CORES))
    if began_with and now != began_with:
        what = f"{name} is {now} but was {began_with} when this run began"
        print(f"train.py: {what}, so last digits will differ", file=sys.stderr)


def make_envs(env_cfg, cfg, threads):
    """The environments of pi and, for EIPO, of pi_prime; of several processes, this one's share."""
    policies = 2 if cfg.algo == "eipo" else 1
    share = cfg.num_envs // policies // jax.process_count()
    commands = tasks.TASKS[env_cfg.task].commands()  # of both, so that J(pi) and J(pi') compare
    return [go1_env.Go1Env(share, env_cfg, threads, commands) for _ in range(policies)]


def save(folder, state, envs, cfg, is_last):
    """Write checkpoint, policy and pictures into the run folder; at the end pi_prime's policy."""
    run_folder.save_checkpoint(folder / "checkpoint.npz", state, envs, cfg)
    if jax.process_index():
        return
    learners = dict(policy=state.pi)
    if state.pi_prime and is_last:  # the rival, with which one compares pi, Eq. (3)
        learners |= dict(policy_prime=state.pi_prime)
    for name, learner in learners.items():
        learner = jax.tree.map(np.asarray, learner)  # of several processes this one alone goes on
        deploy.write(folder / f"{name}.npz", learner, envs[0].env_cfg, is_last)
    metrics.draw_curves(folder)


def check_same_flags(*given):
    """Raise ValueError, on all processes, if they were not started with the same flags."""
    checksums = parallel.everyone(np.array([zlib.crc32(json.dumps(given).encode())]))
    if (checksums != checksums[0]).any():
        raise ValueError("the processes have different flags")


def sync_stop_and_curriculum(stop_requested, weights, before):
    """Whether any process was asked to stop. All get the curriculum of all.

    weights: of this process's curriculum, and as they were `before`, at the last iteration's end
    """
    if jax.process_count() == 1:
        return stop_requested
    requests, gains = parallel.everyone((np.array([stop_requested]), (weights - before)[None]))
    before[:] = weights[:] = (before + gains.sum(0)).clip(max=1)
    return bool(requests.any())


def train(folder, env_cfg, cfg, options, command):
    """Train to the end, from the start or the checkpoint. Returns the last iteration if stopped."""
    envs = make_envs(env_cfg, cfg, options.threads)
    shared = envs if jax.process_count() == 1 else [parallel.Shared(env) for env in envs]
    start = eipo.init_state(shared[0], shared[1] if len(envs) == 2 else None, cfg)
    if options.resume:
        start = run_folder.load_checkpoint(folder / "checkpoint.npz", start, envs)
    arrays = parallel.everywhere(dict(key=start.key, pi=start.pi, pi_prime=start.pi_prime))
    is_main = jax.process_index() == 0
    if is_main:
        log = metrics.Log(folder, start.iteration, cfg.iterations)
        run_folder.save_config(folder, env_cfg, cfg, command, options.resume)
        what = f"{cfg.algo} on {env_cfg.task}, {cfg.num_envs} environments"
        print(f"{folder}: {what}. Compiling (once, ~15 s) ...", flush=True)
    weights = getattr(envs[0].commands, "weights", np.zeros(1))
    weights_before = weights.copy()
    stop = None
    algorithm = eipo.eipo if cfg.algo == "eipo" else eipo.ppo
    for state, row in algorithm(*shared, cfg, start._replace(**arrays)):
        stop = stop or StopRequest()
        stopped = sync_stop_and_curriculum(stop.requested, weights, weights_before)
        steps = state.iteration * cfg.num_steps * cfg.num_envs
        row = dict(steps=steps) | {name: float(x) for name, x in row.items()}
        if is_main:
            log.add(state.iteration, row)
        is_last = stopped or state.iteration == cfg.iterations
        if is_last or state.iteration % options.checkpoint_every == 0:
            save(folder, state, envs, cfg, is_last)
        if stopped:
            return state.iteration


def main(argv):
    """Parse, train, report. Returns the exit status."""
    given_options, given_env, given_learner = parse(argv)
    options = Options(**given_options)
    command = ["python", *sys.orig_argv[1:]]  # whichever python it was
    is_main = not options.process
    meeting = (options.coordinator, options.processes, options.process)
    try:
        env_cfg, cfg = settle(given_env, given_learner)
        folder, threads = run_path(options, env_cfg, cfg), None
        if options.resume:
            given = given_env | given_learner
            env_cfg, cfg, threads = resumed_settings(folder, given, options.processes or 1)
        elif (folder / "checkpoint.npz").exists():
            raise ValueError(f"{folder} already holds a run: --resume it, or choose another --out")
        check(env_cfg, cfg, options.processes or 1)
        pin_jax_threads(threads)
        if meeting != (None, None, None):
            parallel.join(*meeting)
            check_same_flags(given_env, given_learner, options.resume, options.checkpoint_every)
        if is_main:
            folder.mkdir(parents=True, exist_ok=True)
        with run_folder.lock(folder) if is_main else nullcontext():
            stopped = train(folder, env_cfg, cfg, options, command)
    except (ValueError, OSError, jax.errors.JaxRuntimeError) as error:
        joined = jax.distributed.is_initialized()
        lost = "has another process ended? " * (joined and isinstance(error, RuntimeError))
        print(f"train.py: {lost}{' '.join(str(error).split())}", file=sys.stderr, flush=True)
        if joined:
            os._exit(2)  # Python's own way would wait for the others
        return 2
    if stopped and is_main:
        again = shlex.join([*command, *([] if options.resume else ["--resume"])])
        print(f"\nStopped after iteration {stopped}. Continue with: {again}")
    elif is_main:
        print(f"\nDone: {folder} holds the policy and its curves. Look: python play.py {folder}")
    return 130 if stopped else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
