"""The command line: `python train.py --task flat` trains a policy and keeps everything in a run
folder.

`runtime/flags.py` has the flags, `runtime/start.py` how a run starts or goes on, and
`runtime/run_folder.py` what is in a run folder. A run that was stopped after its first checkpoint,
by Ctrl-C or by kill -9, goes on from the last one with --resume, and ends with the same bits as one
that was never stopped.
"""

import os
import signal
import sys

if __name__ == "__main__":
    os.environ["MUJOCO_GL"] = "off"  # no robot is drawn, so nothing that draws needs to work
    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
        # until there is something to save, Ctrl-C ends the process at once: imports take seconds
        signal.signal(signal.SIGINT, signal.SIG_DFL)

import eipo
import go1_env
import mirror
import networks
import tasks
from runtime import checkpoint, jax_setup, metrics, run_folder, start
from runtime.cli import Refused, StopRequest, program, say, signals_given_back, warn
from runtime.flags import Options, parse


def make_envs(env_cfg, cfg, threads):
    """The environments of pi and, for EIPO, of pi_prime: they split num_envs, and share a grid of
    commands (D23).
    """
    policies = 2 if cfg.algo == "eipo" else 1
    commands = tasks.TASKS[env_cfg.task].commands()
    num_envs = cfg.num_envs // policies
    return [go1_env.Go1Env(num_envs, env_cfg, threads, commands) for _ in range(policies)]


def train(folder, envs, cfg, options, words):
    """Train from the start or the checkpoint, to the end or Ctrl-C. Returns the iteration reached.

    Raises Refused if the last save fails, or what is there cannot be resumed.
    """
    begun = eipo.init_state(envs, cfg, mirror.init_params if cfg.mirror else networks.init_params)
    if options.resume:
        begun = checkpoint.load(folder / "checkpoint.npz", begun, envs)
    env_cfg = envs[0].env_cfg
    earlier = run_folder.starts(folder) if options.resume else []
    recorded = run_folder.record(env_cfg, cfg, words, jax_setup.numerics(), earlier)
    log = metrics.Log(folder, begun.iteration, cfg.iterations)
    what = f"{cfg.algo} on {env_cfg.task}, {cfg.num_envs} robots"
    say(f"{folder}: {what}. Compiling (once, ~15 s) ...")
    state, stop = begun, None
    failed = False  # whether the last save did
    algorithm = eipo.eipo if cfg.algo == "eipo" else eipo.ppo
    for state, row in algorithm(*envs, cfg, begun):
        stop = stop or StopRequest()  # from the first iteration on there is something to save
        steps = state.iteration * cfg.num_steps * cfg.num_envs
        log.add(state.iteration, dict(steps=steps) | {name: float(x) for name, x in row.items()})
        is_last = stop.requested or state.iteration == cfg.iterations
        is_first = state.iteration == begun.iteration + 1  # it is saved, to find a full disk
        is_due = is_first or is_last or state.iteration % options.checkpoint_every == 0
        try:
            if is_due or failed:
                save(folder, log, state, envs, cfg, recorded)
                failed = False
        except OSError as error:  # the disk is full, or another program has a file open
            if is_last:
                what = "what was learned since the last checkpoint is lost"
                raise Refused(f"{error}: {what}", status=1) from None
            if not failed:
                warn(f"{error}. Training goes on, and tries again after each iteration")
            failed = True
        if is_last:
            break
    return state.iteration


def save(folder, log, state, envs, cfg, recorded):
    """Write all that a run keeps, the checkpoint after log and policies. If killed before it, a
    run goes on from the previous one, with the same bits.
    """
    run_folder.save_config(folder, recorded)
    log.write()
    origin = dict(iteration=state.iteration, algo=cfg.algo, lam=cfg.lam, seed=cfg.seed)
    for name, learner in dict(policy=state.pi, policy_prime=state.pi_prime).items():
        if learner:
            path = folder / f"{name}.npz"
            run_folder.save_policy(path, learner.params, envs[0].env_cfg, origin)
    checkpoint.save(folder / "checkpoint.npz", state, envs, cfg)
    metrics.draw_curves(folder)


@program("train.py")
def main(argv):
    """Parse, train, report. Returns the exit status."""
    jax_setup.plain_products()
    given_options, *given = parse(argv)
    options = Options(**given_options)
    folder, env_cfg, cfg = start.begin(options, *given)
    envs = make_envs(env_cfg, cfg, options.threads)
    with run_folder.lock(folder), signals_given_back():
        if not options.resume:  # another process may have trained here meanwhile
            start.refuse_used(folder)
        iteration = train(folder, envs, cfg, options, ["python", "train.py", *argv])
    if iteration < cfg.iterations:
        resume = [] if options.resume else ["--resume"]
        again = run_folder.command("train.py", *argv, *resume)
        say(f"\nStopped after iteration {iteration}. Continue with: {again}")
        return 130
    look = run_folder.command("play.py", str(folder))
    say(f"\nDone: {folder} holds the policy and its curves. Look: {look}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
