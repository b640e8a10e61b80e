"""The command line: `python train.py --task flat` trains a policy and keeps everything in a run
folder.

`runtime/flags.py` has the flags, and `runtime/run_folder.py` says what is in a run folder. A run
that was stopped, by Ctrl-C or by kill -9, goes on from its last checkpoint with --resume, and ends
with the same bits as one that was never stopped.
"""

import json
import os
import shlex
import sys
from contextlib import nullcontext
from dataclasses import asdict, fields, replace
from pathlib import Path

from runtime.interrupt import leave, say, stop_at_boundary, stop_imports

if __name__ == "__main__":
    # training draws no robot, so what MuJoCo would draw with need not work
    os.environ["MUJOCO_GL"] = "off"
    stop_imports()

import jax
import numpy as np

import eipo
import go1_env
import tasks
from runtime import deploy, metrics, parallel, run_folder
from runtime.flags import CONFIGS, Options, check_learner, check_world, parse, settle, tuples

# [ours] training ends with an error after so many iterations without one finite gradient
GIVE_UP = 10


def settle_resumed(folder, given_env, given_learner):
    """The Configs of the run in folder, with iterations if given. ValueError for other changes."""
    env_cfg, cfg = run_folder.load_config(folder)
    for name, x in (given_env | given_learner).items():
        was = (asdict(env_cfg) | asdict(cfg))[name]
        if x != was and not (name == "iterations" and x > was):
            flag = "--" + name.replace("_", "-")
            raise ValueError(
                f"{folder} runs with {flag} {was}, not {x}: --resume can only raise --iterations"
            )
    return env_cfg, replace(cfg, iterations=given_learner.get("iterations", cfg.iterations))


def run_path(options, env_cfg, cfg):
    """The run folder: what --out says, or a name of task, algorithm, lambda, variant and seed."""
    variant = "".join(f"-{x}" for x in (env_cfg.aux, env_cfg.reward) if x in ("smooth", "shaped"))
    usual = tasks.TASKS[env_cfg.task].learner.get("num_envs", eipo.Config.num_envs)
    variant += f"-{cfg.num_envs}envs" if cfg.num_envs != usual else ""
    return Path(
        options.out or f"runs/{env_cfg.task}-{cfg.algo}-lam{cfg.lam:g}{variant}-seed{cfg.seed}"
    )


def prepare(options, given_env, given_learner):
    """Check what is given against itself and the run folder. Returns folder and both Configs."""
    if options.checkpoint_every < 1:
        raise ValueError(f"checkpoint_every is {options.checkpoint_every}: it must be at least 1")
    env_cfg, cfg = settle(given_env, given_learner)
    folder = run_path(options, env_cfg, cfg)
    if options.resume and options.process:
        return folder, env_cfg, cfg  # process 0 tells what the folder holds
    if options.resume:
        if not (folder / "checkpoint.npz").exists():
            raise ValueError(
                f"{folder} holds no checkpoint to resume: check --out, or start there "
                "without --resume"
            )
        env_cfg, cfg = settle_resumed(folder, given_env, given_learner)
    check_learner(cfg, max(1, options.processes or 1))
    check_world(cfg.num_envs, env_cfg, options.threads)
    return folder, env_cfg, cfg


def agree(options, env_cfg, cfg):
    """Both Configs of process 0, for all processes. ValueError if one has other flags."""
    mine = dict(resume=options.resume, checkpoint_every=options.checkpoint_every)
    mine |= asdict(env_cfg) | asdict(cfg)
    flags_of_each = parallel.gather(dict(flags=json.dumps(mine)))
    first, *others = (json.loads(str(own["flags"])) for own in flags_of_each)
    for process, other in enumerate(others, 1):
        for name, x in first.items():
            # then process 0 read all others
            resumed = options.resume and name not in ("resume", "checkpoint_every")
            if other[name] != x and not resumed:
                flag = "--" + name.replace("_", "-")
                raise ValueError(
                    f"process {process} has {flag} {other[name]}, not {x}: give all the same flags"
                )
    records = [{f.name: first[f.name] for f in fields(config)} for config in CONFIGS[1:]]
    return [config(**tuples(x)) for config, x in zip(CONFIGS[1:], records, strict=True)]


def repeat_arithmetic(threads):
    """Make JAX compute the same bits again: in float32, with as many threads as before.

    The last digit of a matrix product depends on the number of JAX's threads, whatever the number
    of cores.
    """
    jax.config.update("jax_enable_x64", False)  # whatever JAX_ENABLE_X64 says
    name = run_folder.JAX_THREADS
    cores = str(go1_env.CORES)
    now = os.environ.setdefault(name, threads or cores)
    if threads and now != threads:
        say(
            f"{name} is {now} but was {threads} when this run began: last digits will differ",
            sys.stderr,
        )
    elif threads and now != cores:
        say(
            f"JAX keeps its {now} threads, for the same bits; {name}={cores} is one for each core",
            sys.stderr,
        )


def save(folder, state, envs, cfg, last):
    """Write checkpoint, policies and pictures into the run folder; last: whether the run ends."""
    run_folder.save_checkpoint(folder / "checkpoint.npz", state, envs, cfg)
    if jax.process_index() == 0:
        deploy.write(folder / "policy.npz", state.pi, envs[0].env_cfg, last)
        if state.pi_prime and last:  # the rival, with which one compares pi, Eq. (3)
            deploy.write(folder / "policy_prime.npz", state.pi_prime, envs[0].env_cfg, last)
        metrics.draw(folder, getattr(envs[0].commands, "weights", None))


def check_learned(state, cfg):
    """Raise ValueError, in one line, if nothing in state is finite any more."""
    if state.pi_prime and not np.isfinite(state.dual).all():
        raise ValueError(
            f"alpha and its momentum are {tuple(state.dual)} after iteration {state.iteration}"
        )
    limit = GIVE_UP * cfg.num_epochs * cfg.num_minibatches
    for name, learner in (("pi", state.pi), ("pi_prime", state.pi_prime)):
        if learner and learner.opt_state.notfinite_count >= limit:
            raise ValueError(
                f"no gradient of {name} was finite in {GIVE_UP} iterations: are rewards and "
                "costs finite?"
            )


def meet(asked, weights, before):
    """Whether any process was asked to stop. All get the curriculum of all.

    weights: of this process's curriculum, and as they were `before`, at the last meeting
    """
    if jax.process_count() == 1:
        return asked
    asked, gain = parallel.average((asked, weights - before))
    before[:] = weights[:] = (before + jax.process_count() * gain).clip(max=1)
    return bool(asked > 0)


def make_envs(env_cfg, cfg, threads):
    """The environments of pi and, for EIPO, of pi_prime; of several processes, this one's share."""
    policies = 2 if cfg.algo == "eipo" else 1
    share = cfg.num_envs // policies // jax.process_count()
    commands = tasks.TASKS[env_cfg.task].commands()  # of both, so that J(pi) and J(pi') compare
    return [go1_env.Go1Env(share, env_cfg, threads, commands) for _ in range(policies)]


def begin(folder, env_cfg, cfg, options):
    """Both Configs, the environments and the State with which a run starts or goes on."""
    checkpoint = folder / "checkpoint.npz"
    lead = not options.process
    threads = None
    if checkpoint.exists() and not options.resume and lead:
        raise ValueError(
            f"{folder} already holds a run: add --resume to continue it, or choose another --out"
        )
    if options.resume and lead:
        threads = run_folder.check_settings(folder, env_cfg, cfg, options.processes or 1)
    repeat_arithmetic(threads)
    env_cfg, cfg = agree(options, env_cfg, cfg)
    envs = make_envs(env_cfg, cfg, options.threads)
    state = eipo.init_state(envs[0], envs[1] if len(envs) == 2 else None, cfg)
    if options.resume:  # the new State tells what to expect
        state = run_folder.load_checkpoint(checkpoint, state, envs)
    return env_cfg, cfg, envs, state


def train(folder, env_cfg, cfg, options, command, stop):
    """Train to the end, from the start or the checkpoint. Returns the last iteration if stopped."""
    lead = not options.process
    env_cfg, cfg, envs, first_state = begin(folder, env_cfg, cfg, options)
    if lead:
        log = metrics.Log(folder, first_state.iteration)
        first = None
        run_folder.save_config(folder, env_cfg, cfg, command, options.resume)
        what = f"{folder}: {cfg.algo} on {env_cfg.task}, {cfg.num_envs} environments."
        say(f"{what} Compiling (once, ~15 s) ...")
    weights = getattr(envs[0].commands, "weights", np.zeros(1))
    before = weights.copy()
    algorithm = eipo.eipo if cfg.algo == "eipo" else eipo.ppo
    for state, numbers in algorithm(*envs, cfg, first_state):
        check_learned(state, cfg)
        stop.worth_saving = True
        steps = state.iteration * cfg.num_steps * cfg.num_envs
        numbers = dict(steps=steps) | {name: float(x) for name, x in numbers.items()}
        asked = meet(stop.asked, weights, before)
        if lead:
            row = log.row(state.iteration, numbers)
            metrics.report(row, first := first or row, cfg.iterations)
        last = asked or state.iteration == cfg.iterations
        if last or state.iteration % options.checkpoint_every == 0:
            if lead:
                log.sync()
            save(folder, state, envs, cfg, last)
        if asked:
            break
    return state.iteration if state.iteration < cfg.iterations else None


def command_line(argv):
    """The words that started this process; the flags are those that train.py got."""
    typed = ["python", *sys.orig_argv[1:]]  # whichever python it was
    return typed if set(argv) <= set(typed) else typed[: len(typed) - len(sys.argv) + 1] + argv


def main(argv):
    """Parse, train, report. Returns the exit status."""
    given_options, given_env, given_learner = parse(argv)
    options = Options(**given_options)
    command = command_line(argv)
    lead = not options.process
    meeting = (options.coordinator, options.processes, options.process)
    try:
        folder, env_cfg, cfg = prepare(options, given_env, given_learner)
        with stop_at_boundary(folder) as stop:
            if meeting != (None, None, None):
                parallel.join(*meeting)
            if lead:
                folder.mkdir(parents=True, exist_ok=True)
            with run_folder.lock(folder) if lead else nullcontext():
                stopped = train(folder, env_cfg, cfg, options, command, stop)
    except (ValueError, OSError) as error:
        if jax.distributed.is_initialized():
            leave(" ".join(str(error).split()))
        say(f"train.py: {' '.join(str(error).split())}", sys.stderr)
        return 2
    if stopped and lead:
        again = shlex.join([*command, *([] if options.resume else ["--resume"])])
        say(f"\nStopped after iteration {stopped}. Continue with: {again}")
    elif lead:
        say(
            f"\nDone: {folder} holds policy.npz, curves.png and metrics.csv. Look: python "
            f"play.py {folder}"
        )
    return 130 if stopped else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
