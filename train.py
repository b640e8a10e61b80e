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
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

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
from runtime import checkpoint, jax_setup, metrics, run_folder
from runtime.cli import Refused, StopRequest, program, say, warn
from runtime.flags import Options, check, parse, settle


def run_path(options, env_cfg, cfg):
    """The run folder: what --out says, or a name of task, algorithm, lambda, variant and seed."""
    variant = "".join(f"-{x}" for x in (env_cfg.aux, env_cfg.reward) if x in ("smooth", "shaped"))
    name = f"{env_cfg.task}-{cfg.algo}-lam{cfg.lam:g}{variant}-seed{cfg.seed}"
    if options.out == "":  # a script's variable that is not set
        raise Refused("--out is empty: name a folder, or leave it out")
    return Path(options.out or f"runs/{name}")


def refuse_used(folder):
    """Refuse a folder that already holds a run, unless it is to go on."""
    if found := [name for name in run_folder.FILES if (folder / name).exists()]:
        again = "--resume it, or " * ("checkpoint.npz" in found)
        raise Refused(f"{folder} already holds {found[0]} of a run: {again}choose another --out")


def resumed_settings(folder, given):
    """Both Configs of the run in folder, with more iterations if given, and what JAX began with:
    its threads, and its `jax_setup.numerics`.

    given: the fields of both Configs that the command line sets, which must be the run's
    """
    env_cfg, cfg, jax_threads, began = checkpoint.load_settings(folder / "checkpoint.npz")
    run_folder.starts(folder)  # refuses a config.json to which nothing can be added
    settings = asdict(env_cfg) | asdict(cfg)
    for name, x in given.items():
        if x != settings[name] and not (name == "iterations" and x > settings[name]):
            what = f"{folder} runs with --{name.replace('_', '-')} {settings[name]}"
            raise Refused(f"{what}: --resume can only raise iterations")
    cfg = replace(cfg, iterations=given.get("iterations", cfg.iterations))
    return env_cfg, cfg, jax_threads, began


def make_envs(env_cfg, cfg, threads):
    """The environments of pi and, for EIPO, of pi_prime, which share num_envs and one curriculum.

    So J(pi) and J(pi') can be compared (D23).
    """
    policies = 2 if cfg.algo == "eipo" else 1
    commands = tasks.TASKS[env_cfg.task].commands()
    num_envs = cfg.num_envs // policies
    return [go1_env.Go1Env(num_envs, env_cfg, threads, commands) for _ in range(policies)]


class Keeper:
    """Keeps the last complete iteration of a run until it is written.

    A file that cannot be written now, since the disk is full or another program has it open, is
    written with the next one. A folder that somebody moved away is made again.
    """

    def __init__(self, folder, envs, cfg, log):
        self.folder, self.envs, self.cfg, self.log = folder, envs, cfg, log
        self.newest = None  # (State, what a checkpoint stores of each env), if not written yet
        self.record = None  # writes config.json, once there is something to keep
        self.recorded = False  # whether it did
        self.failed = False  # whether something could not be written at the last try

    def keep(self, state):
        """Take an iteration's State. The environments may go on: theirs is copied."""
        self.newest = state, [checkpoint.saved(env) for env in self.envs]

    def write(self):
        """Write what every iteration adds to: the log, and first of all config.json."""
        self.folder.mkdir(parents=True, exist_ok=True)
        if self.record and not (self.recorded and (self.folder / "config.json").exists()):
            self.record()
            self.recorded = True
        self.log.write()

    def save(self):
        """Write log, checkpoint, policies and pictures into the run folder."""
        is_new = self.newest is not None
        try:
            self.write()
        except OSError:  # another program may have it open: no reason to lose what was learned
            self.save_newest()
            raise
        self.save_newest()
        if is_new:
            self.draw()

    def save_newest(self):
        """Write checkpoint and policies of the last complete iteration, if they are not written."""
        if self.newest is None:
            return
        state, envs = self.newest
        cfg, env_cfg = self.cfg, self.envs[0].env_cfg
        checkpoint.save(self.folder / "checkpoint.npz", state, envs, env_cfg, cfg)
        about = dict(iteration=state.iteration, algo=cfg.algo, lam=cfg.lam, seed=cfg.seed)
        for name, learner in dict(policy=state.pi, policy_prime=state.pi_prime).items():
            if learner:
                path = self.folder / f"{name}.npz"
                run_folder.save_policy(path, learner.params, env_cfg, about)
        self.newest = None

    def draw(self):
        """Draw the curves of the log."""
        try:
            metrics.draw_curves(self.folder)
        except Exception as error:  # a picture is not worth a run
            warn(f"no picture of {self.folder}: {error!r}")

    def is_behind(self, state):
        """Whether the policies in the folder are of another iteration than a State: a run may be
        ended between its checkpoint and them.
        """
        names = ["policy", "policy_prime"] if state.pi_prime else ["policy"]
        try:
            found = [run_folder.load_policy(self.folder / f"{name}.npz")[0] for name in names]
        except Refused:  # one is missing, or damaged
            return True
        return any(pi.about.get("iteration") != state.iteration for pi in found)

    def attempt(self, write):
        """Call write(). If a file cannot be written, say so once, and try again another time."""
        try:
            write()
            self.failed = False
        except OSError as error:
            if not self.failed:
                warn(f"{error}. It trains on, and tries again after each iteration")
            self.failed = True


def train(folder, envs, cfg, options, typed):
    """Train to the end, from the start or the checkpoint. Returns the last iteration if stopped."""
    env_cfg = envs[0].env_cfg
    init = mirror.init_params if cfg.mirror else networks.init_params
    start = eipo.init_state(envs, cfg, init)
    if options.resume:
        start = checkpoint.load(folder / "checkpoint.npz", start, envs)
    log = metrics.Log(folder, start.iteration, cfg.iterations)
    keeper = Keeper(folder, envs, cfg, log)
    if options.resume and keeper.is_behind(start):
        keeper.keep(start)
    what = f"{cfg.algo} on {env_cfg.task}, {cfg.num_envs} environments"
    say(f"{folder}: {what}. Compiling (once, ~15 s) ...")
    stop = None
    algorithm = eipo.eipo if cfg.algo == "eipo" else eipo.ppo
    try:
        for state, row in algorithm(*envs, cfg, start):
            if stop is None:  # the first iteration is done: from now on there is something to keep
                stop = StopRequest()
                earlier = run_folder.starts(folder) if options.resume else []
                about = env_cfg, cfg, typed, jax_setup.numerics(), earlier
                keeper.record = partial(run_folder.save_config, folder, *about)
            row = {name: float(x) for name, x in row.items()}
            steps = state.iteration * cfg.num_steps * cfg.num_envs
            log.add(state.iteration, dict(steps=steps) | row)
            keeper.keep(state)
            if stop.requested and state.iteration < cfg.iterations:
                return state.iteration
            is_due = keeper.failed or state.iteration % options.checkpoint_every == 0
            keeper.attempt(keeper.save if is_due else keeper.write)
    finally:  # whatever ends it, what was learned is kept
        keeper.save()


def prepare(options, given_env, given_learner):
    """The run folder and both Configs of a run that may start, or go on; JAX is set up for it."""
    env_cfg, cfg = settle(given_env, given_learner)
    folder, jax_threads, began = run_path(options, env_cfg, cfg), None, None
    if options.resume:
        given = given_env | given_learner
        env_cfg, cfg, jax_threads, began = resumed_settings(folder, given)
    else:
        refuse_used(folder)
    check(options, env_cfg, cfg)
    jax_setup.set_threads(jax_threads)
    numerics = jax_setup.numerics()  # refuses before anything is written if there is no device
    began = dict(threads=jax_threads) | began if began else {}
    was_and_is = {x: (was, numerics.get(x)) for x, was in began.items()}
    if other := [f"{x} {was} and not {now}" for x, (was, now) in was_and_is.items() if was != now]:
        warn(f"{folder} began with {', '.join(other)}: last digits will differ")
    return folder, env_cfg, cfg


@program("train.py")
def main(argv):
    """Parse, train, report. Returns the exit status."""
    jax_setup.plain_products()
    given_options, *given = parse(argv)
    options = Options(**given_options)
    typed = ["python", *sys.orig_argv[1:]]  # whichever python it was
    folder, env_cfg, cfg = prepare(options, *given)
    envs = make_envs(env_cfg, cfg, options.threads)
    with run_folder.lock(folder):
        if not options.resume:  # another process may have trained here meanwhile
            refuse_used(folder)
        stopped = train(folder, envs, cfg, options, typed)
    if stopped:
        again = shlex.join([*typed, *([] if options.resume else ["--resume"])])
        say(f"\nStopped after iteration {stopped}. Continue with: {again}")
    else:
        play = Path(__file__).with_name("play.py")
        play = play.name if play.parent == Path.cwd() else str(play)
        look = shlex.join(["python", play, str(folder)])
        say(f"\nDone: {folder} holds the policy and its curves. Look: {look}")
    return 130 if stopped else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
