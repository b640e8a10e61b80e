"""The command line: `python train.py --task flat` trains a policy and keeps everything in a run
folder.

`runtime/flags.py` has the flags, and `runtime/run_folder.py` says what is in a run folder. A run
that was stopped, by Ctrl-C or by kill -9, goes on from its last checkpoint with --resume, and ends
with the same bits as one that was never stopped.
"""

import os
import shlex
import signal
import sys
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
from mirror import Mirrored, plain_policy
from runtime import checkpoint, jax_setup, metrics, parallel, run_folder
from runtime.cli import Refused, StopRequest, program
from runtime.flags import Options, check, parse, settle


def run_path(options, env_cfg, cfg):
    """The run folder: what --out says, or a name of task, algorithm, lambda, variant and seed."""
    variant = "".join(f"-{x}" for x in (env_cfg.aux, env_cfg.reward) if x in ("smooth", "shaped"))
    name = f"{env_cfg.task}-{cfg.algo}-lam{cfg.lam:g}{variant}-seed{cfg.seed}"
    return Path(options.out or f"runs/{name}")


def resumed_settings(folder, given, processes):
    """Both Configs of the run in folder, with more iterations if given, and its threads of JAX.

    given: the fields of both Configs that the command line sets, which must be the run's
    """
    env_cfg, cfg, jax_threads, was = checkpoint.load_settings(folder / "checkpoint.npz")
    if was != processes:
        raise Refused(f"{folder} is a run on {was} process(es): --resume needs as many")
    settings = asdict(env_cfg) | asdict(cfg)
    for name, x in given.items():
        if x != settings[name] and not (name == "iterations" and x > settings[name]):
            what = f"{folder} runs with --{name.replace('_', '-')} {settings[name]}"
            raise Refused(f"{what}: --resume can only raise iterations")
    return env_cfg, replace(cfg, iterations=given.get("iterations", cfg.iterations)), jax_threads


def make_envs(env_cfg, cfg, threads):
    """The environments of pi and, for EIPO, of pi_prime; of several processes, this one's share."""
    policies = 2 if cfg.algo == "eipo" else 1
    share = cfg.num_envs // policies // jax.process_count()
    commands = tasks.TASKS[env_cfg.task].commands()  # of both, so that J(pi) and J(pi') compare
    return [go1_env.Go1Env(share, env_cfg, threads, commands) for _ in range(policies)]


def save(folder, state, envs, shown, cfg):
    """Write checkpoint, policies and pictures into the run folder.

    shown: the environments as the policies see them
    """
    checkpoint.save(folder / "checkpoint.npz", state, envs, cfg)
    if jax.process_index():
        return
    for name, learner in dict(policy=state.pi, policy_prime=state.pi_prime).items():
        if learner:
            params = jax.tree.map(np.asarray, learner.params)  # of several processes this one's
            layers = plain_policy(params, shown[0])
            run_folder.save_policy(folder / f"{name}.npz", layers, envs[0].env_cfg)
    try:
        metrics.draw_curves(folder)
    except Exception as error:  # a picture is not worth a run
        print(f"train.py: no picture of {folder}: {error!r}", file=sys.stderr, flush=True)


def train(folder, envs, cfg, options, typed):
    """Train to the end, from the start or the checkpoint. Returns the last iteration if stopped."""
    env_cfg = envs[0].env_cfg
    shown = [Mirrored(env) for env in envs] if cfg.mirror else envs
    shared = shown if jax.process_count() == 1 else [parallel.Shared(env) for env in shown]
    start = eipo.init_state(shared[0], shared[1] if len(envs) == 2 else None, cfg)
    if options.resume:
        start = checkpoint.load(folder / "checkpoint.npz", start, envs)
    arrays = parallel.everywhere(dict(key=start.key, pi=start.pi, pi_prime=start.pi_prime))
    is_main = jax.process_index() == 0
    log = metrics.Log(folder, start.iteration, cfg.iterations)
    if is_main:
        what = f"{cfg.algo} on {env_cfg.task}, {cfg.num_envs} environments"
        print(f"{folder}: {what}. Compiling (once, ~15 s) ...", flush=True)
    weights = envs[0].commands.weights
    weights_before = weights.copy()
    stop = None
    algorithm = eipo.eipo if cfg.algo == "eipo" else eipo.ppo
    for state, row in algorithm(*shared, cfg, start._replace(**arrays)):
        if stop is None:  # the first iteration is done: from now on there is something to keep
            stop = StopRequest()
            if is_main:
                device = jax_setup.device()
                run_folder.save_config(folder, env_cfg, cfg, typed, device, options.resume)
        stopped = parallel.sync_stop_and_curriculum(stop.requested, weights, weights_before)
        steps = state.iteration * cfg.num_steps * cfg.num_envs
        row = dict(steps=steps) | {name: float(x) for name, x in row.items()}
        if is_main:
            log.add(state.iteration, row)
        is_due = state.iteration % options.checkpoint_every == 0
        if is_due or stopped or state.iteration == cfg.iterations:
            save(folder, state, envs, shown, cfg)
        if stopped:
            return state.iteration


def prepare(options, given_env, given_learner):
    """The run folder and both Configs of a run that may start, or go on; JAX is set up for it."""
    env_cfg, cfg = settle(given_env, given_learner)
    folder, jax_threads = run_path(options, env_cfg, cfg), None
    if options.resume:
        given = given_env | given_learner
        env_cfg, cfg, jax_threads = resumed_settings(folder, given, options.processes or 1)
    elif found := [name for name in run_folder.FILES if (folder / name).exists()]:
        again = "--resume it, or " * ("checkpoint.npz" in found)
        raise Refused(f"{folder} already holds {found[0]} of a run: {again}choose another --out")
    check(cfg, options.processes or 1)
    jax_setup.set_threads(jax_threads)
    return folder, env_cfg, cfg


@program("train.py")
def main(argv):
    """Parse, train, report. Returns the exit status."""
    jax_setup.plain_products()
    given_options, *given = parse(argv)
    options = Options(**given_options)
    typed = ["python", *sys.orig_argv[1:]]  # whichever python it was
    is_main = not options.process
    folder, env_cfg, cfg = prepare(options, *given)
    with parallel.together(options.coordinator, options.processes, options.process):
        jax_setup.device()  # refuses before anything is written
        parallel.check_same_start(*given, options.resume, options.checkpoint_every)
        envs = make_envs(env_cfg, cfg, options.threads)
        with run_folder.lock(folder) if is_main else nullcontext():
            stopped = train(folder, envs, cfg, options, typed)
    if stopped and is_main:
        again = shlex.join([*typed, *([] if options.resume else ["--resume"])])
        print(f"\nStopped after iteration {stopped}. Continue with: {again}")
    elif is_main:
        look = shlex.join(["python", "play.py", str(folder)])
        print(f"\nDone: {folder} holds the policy and its curves. Look: {look}")
    return 130 if stopped else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
