"""The command line: `python train.py --task flat` trains a policy and keeps everything in a run folder.

Every field of three dataclasses (`Options` here, `tasks.Config`, `eipo.Config`) is a flag of the same name. The files
of a run folder are listed in `run_folder.py`. A run that was stopped, by Ctrl-C or by kill -9, goes on from its last
checkpoint with --resume. On the same number of cores it ends with the same bits as one that was never stopped.
"""

import argparse
import inspect
import re
import shlex
import signal
import sys
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import get_args

import eipo
import go1_env
import networks
import run_folder
import tasks


@dataclass(frozen=True)
class Options:
    """How to run. None of these fields changes what is learned."""

    out: str | None = None  # [ours] run folder; by default runs/<task>-<algo>-lam<lam>-seed<seed>
    resume: bool = False  # [ours] continue the run in the folder; only --iterations can be changed, and only raised
    threads: int | None = None  # [ours] threads that step the physics; by default one for every core
    checkpoint_every: int = 50  # [ours] iterations between two checkpoints


CONFIGS = (Options, tasks.Config, eipo.Config)


# ---- settings ----


def describe(config):
    """The comment behind each field of a config dataclass: {"gamma": "[lab code] discount, Eq. (1)", ...}."""
    return dict(re.findall(r"^    (\w+): .*?  # (.*)$", inspect.getsource(config), re.M))


def kind_of(field):
    """Arguments of argparse for a field, by its annotation. Where that allows None, the word none stands for it."""
    if field.type is bool:
        return dict(action=argparse.BooleanOptionalAction)
    several = field.type is tuple
    kind, *none = (type(field.default[0]),) if several else get_args(field.type) or (field.type,)

    def read(text):
        if several and "," in text:
            raise argparse.ArgumentTypeError(f"{text} has commas: put spaces, as in {text.replace(',', ' ')}")
        return None if none and text == "none" else kind(text)

    read.__name__ = kind.__name__  # argparse names it when it cannot read a value
    return dict(type=read, nargs="+" if several else None)


def parse(argv):
    """The flags that were given: one dict of fields for each of CONFIGS."""
    usage = f"train.py [--task {'|'.join(tasks.TASKS)}] [--algo eipo|ppo] [--out DIR] [--resume] [--FIELD VALUE ...]"
    about = "\n".join(f"  {name:<{max(map(len, tasks.TASKS))}}  {task.about}" for name, task in tasks.TASKS.items())
    parser = argparse.ArgumentParser(
        usage=usage, description=f"{__doc__.splitlines()[0]}\n\ntasks:\n{about}", allow_abbrev=False,
        argument_default=argparse.SUPPRESS, formatter_class=argparse.RawDescriptionHelpFormatter
    )  # fmt: skip
    parser.error = lambda message: parser.exit(2, f"train.py: {message} (-h lists every flag)\n")
    for config in CONFIGS:
        comments = describe(config)
        for field in fields(config):
            paper = {name: task.world | task.learner for name, task in tasks.TASKS.items()}
            by_task = [f"{name} {x[field.name]}" for name, x in paper.items() if field.name in x]
            default = [] if len(by_task) == len(paper) else [str(field.default).lower()]
            text = f"{comments[field.name]} (default: {', '.join(default + by_task)})".replace("%", "%%")
            parser.add_argument("--" + field.name.replace("_", "-"), help=text, **kind_of(field))
    given = run_folder.tuples(vars(parser.parse_args(argv)))
    return [{f.name: given[f.name] for f in fields(config) if f.name in given} for config in CONFIGS]


def settle(given_env, given_learner):
    """tasks.Config and eipo.Config: defaults, overruled by the task's own values, overruled by what was given."""
    env_cfg = tasks.task_config(**given_env)
    return env_cfg, eipo.Config(**tasks.TASKS[env_cfg.task].learner | given_learner)


def settle_resumed(folder, given_env, given_learner):
    """The Configs of the run in folder, with iterations raised if that was given. ValueError for other changes."""
    env_cfg, cfg = run_folder.load_config(folder)
    for name, x in (given_env | given_learner).items():
        was = (asdict(env_cfg) | asdict(cfg))[name]
        if x != was and not (name == "iterations" and x > was):
            flag = "--" + name.replace("_", "-")
            raise ValueError(f"{folder} runs with {flag} {was}, not {x}: --resume can only raise --iterations")
    return env_cfg, replace(cfg, iterations=given_learner.get("iterations", cfg.iterations))


# ---- the run ----


def run_path(options, env_cfg, cfg):
    """The run folder: what --out says, or a name made of task, algorithm, lambda, variant and seed."""
    variant = "".join(f"-{x}" for x in (env_cfg.aux, env_cfg.reward) if x in ("smooth", "shaped"))
    return Path(options.out or f"runs/{env_cfg.task}-{cfg.algo}-lam{cfg.lam:g}{variant}-seed{cfg.seed}")


def prepare(options, given_env, given_learner):
    """Make the run folder, or check that what it holds fits; returns folder, tasks.Config, eipo.Config."""
    if options.checkpoint_every < 1:
        raise ValueError(f"checkpoint_every is {options.checkpoint_every}: it must be at least 1")
    env_cfg, cfg = settle(given_env, given_learner)
    folder = run_path(options, env_cfg, cfg)
    if options.resume:
        if not (folder / "checkpoint.npz").exists():
            raise ValueError(f"{folder} holds no checkpoint to resume: check --out, or start there without --resume")
        env_cfg, cfg = settle_resumed(folder, given_env, given_learner)
    elif (folder / "checkpoint.npz").exists():
        raise ValueError(f"{folder} already holds a run: add --resume to continue it, or choose another --out")
    eipo.check(cfg)
    tasks.check(cfg.num_envs, env_cfg, options.threads)
    folder.mkdir(parents=True, exist_ok=True)
    return folder, env_cfg, cfg


def save(folder, state, envs, params):
    """Write the checkpoint, the policy and the pictures of the run folder; params: of pi as plain MLPs."""
    run_folder.save_checkpoint(folder / "checkpoint.npz", state, envs)
    run_folder.save_policy(folder / "policy.npz", params, envs[0].env_cfg)
    run_folder.draw_curves(folder)
    if envs[0].task.curriculum:
        run_folder.draw_commands(folder, envs[0].state.weights)


def report(row, iterations):
    """Print what matters of a row of metrics.csv: on a terminal over the last line, elsewhere for one row in 100."""
    iteration, rate = row["iteration"], row["steps_per_s"]
    left = (iterations - iteration) * row["steps"] / iteration / max(rate, 0.1) / 60
    line = (
        f"{iteration}/{iterations}  {rate:.0f} steps/s  {left:.0f} min left  task {row['reward']:.2f}  "
        f"v_x {row['v_x']:.2f} m/s  power {row['power']:.0f} W  alpha {row['alpha']:.1f}"
        + (f"  gap {row['gap']:+.2f}" if "gap" in row else "")
    )
    if sys.stdout.isatty():
        print(f"\r{line}\x1b[K", end="", flush=True)
    elif iteration % 100 == 0 or iteration == iterations:
        print(line, flush=True)


def train(folder, env_cfg, cfg, options, argv, asked):
    """Train from the start or the checkpoint to the end, or until `asked` is not empty; returns the last iteration."""
    policies = 2 if cfg.algo == "eipo" else 1
    envs = [go1_env.Go1Env(cfg.num_envs // policies, env_cfg, options.threads) for _ in range(policies)]
    if policies == 2:
        envs[1].state.weights = envs[0].state.weights  # one curriculum: J(pi), J(pi') are of the same commands (D23)
    env, env_prime = (*(networks.EvenOdd(env, cfg.mirror) for env in envs), None)[:2]
    state = eipo.init_state(env, env_prime, cfg)  # also tells load_checkpoint what to expect
    if options.resume:
        state = run_folder.load_checkpoint(folder / "checkpoint.npz", state, envs)
    log = run_folder.Log(folder, state.iteration)
    run_folder.save_config(folder, env_cfg, cfg, argv, options.resume)
    print(f"{folder}: {cfg.algo} on {env_cfg.task}, {cfg.num_envs} environments. Compiling (once, ~15 s) ...")
    run = eipo.eipo(env, env_prime, cfg, state) if policies == 2 else eipo.ppo(env, cfg, state)
    for state, metrics in run:
        report(log.row(state.iteration, {name: float(x) for name, x in metrics.items()}), cfg.iterations)
        if asked or state.iteration % options.checkpoint_every == 0 or state.iteration == cfg.iterations:
            save(folder, state, envs, env.dense(state.pi.params))
        if asked:
            break
    return state.iteration


@contextmanager
def stop_at_boundary():
    """Yields a list that is empty until Ctrl-C or SIGTERM asks for a stop. After that, Ctrl-C stops at once."""
    asked = []

    def ask(number, frame):
        asked.append(number)
        signal.signal(signal.SIGINT, signal.default_int_handler)

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def main(argv):
    """Parse, train, report. Returns the exit status."""
    given_options, given_env, given_learner = parse(argv)
    options = Options(**given_options)
    try:
        folder, env_cfg, cfg = prepare(options, given_env, given_learner)
        with stop_at_boundary() as asked:
            done = train(folder, env_cfg, cfg, options, argv, asked)
    except KeyboardInterrupt:
        print("\nStopped at once; --resume goes on from the last checkpoint", file=sys.stderr)
        return 130
    except (ValueError, OSError) as error:
        print(f"train.py: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    if done < cfg.iterations:
        again = shlex.join(["python", "train.py", "--out", str(folder), "--resume"])
        print(f"\nStopped after iteration {done}. Continue with: {again}")
        return 130
    print(f"\nDone: {folder} holds policy.npz, curves.png and metrics.csv")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
