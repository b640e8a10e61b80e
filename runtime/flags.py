"""The flags of `train.py`, and with which settings one can train.

Every field of `Options`, `tasks.Config` and `eipo.Config` is a flag of the same name.
"""

import argparse
import inspect
import re
from dataclasses import dataclass, fields
from typing import get_args

import eipo
import tasks
import terrain
from ppo import LOG_STD_RANGE, LR_RANGE


@dataclass(frozen=True)
class Options:
    """How to run. None of these fields changes what is learned."""

    out: str | None = None  # [ours] run folder (default: runs/, named by task, algorithm and seed)
    resume: bool = False  # [ours] go on with the run in the folder; --iterations may be raised
    threads: int | None = None  # [ours] that step the physics; by default one for every core
    checkpoint_every: int = 50  # [ours] iterations between two checkpoints
    coordinator: str | None = None  # [ours] HOST:PORT at which several processes meet
    processes: int | None = None  # [ours] how many; each steps its share of the environments
    process: int | None = None  # [ours] which one this is, from 0, which has the run folder


CONFIGS = (Options, tasks.Config, eipo.Config)
ABOUT = "`python train.py --task flat` trains a policy and keeps everything in a run folder."
LENGTH = """A run has 10 to 15 % of the paper's iterations. On flat and curriculum alpha takes
longer steps to make up for it (D38).
As in the paper:
  --iterations 4000 --lr-alpha 0.01  (on velocity: --iterations 10000)"""


def describe(config):
    """The comment behind each field of a config: {"gamma": "[lab code] discount, Eq. (1)", ...}."""
    source = "".join(inspect.getsource(kind) for kind in config.__mro__[:-1])  # bases as well
    return dict(re.findall(r"^    (\w+): .*?  # (.*)$", source, re.M))


def kind_of(field):
    """Arguments of argparse for a field, by its annotation. The word none stands for None."""
    if field.type is bool:
        return dict(action=argparse.BooleanOptionalAction)
    several = field.type is tuple
    kind, *none = (type(field.default[0]),) if several else get_args(field.type) or (field.type,)

    def read(text):
        if several and "," in text:
            raise argparse.ArgumentTypeError(
                f"{text} has commas: put spaces, as in {text.replace(',', ' ')}"
            )
        return None if none and text == "none" else kind(text)

    read.__name__ = kind.__name__  # argparse names it when it cannot read a value
    return dict(type=read, nargs="+" if several else None)


def parse(argv):
    """The flags that were given: one dict of fields for each of CONFIGS."""
    usage = f"[--task {'|'.join(tasks.TASKS)}] [--algo eipo|ppo] [--out DIR] [--resume]"
    about = "\n".join(f"  {name:<10}  {task.about}" for name, task in tasks.TASKS.items())
    parser = argparse.ArgumentParser(
        usage=f"train.py {usage} [--FIELD VALUE ...]",
        description=f"{ABOUT}\n\ntasks:\n{about}\n\n{LENGTH}",
        allow_abbrev=False,
        argument_default=argparse.SUPPRESS,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.error = lambda message: parser.exit(2, f"train.py: {message} (-h lists every flag)\n")
    for config in CONFIGS:
        comments = describe(config)
        for field in fields(config):
            paper = {name: task.world | task.learner for name, task in tasks.TASKS.items()}
            by_task = [f"{name} {x[field.name]}" for name, x in paper.items() if field.name in x]
            default = [] if len(by_task) == len(paper) else [str(field.default).lower()]
            text = f"{comments[field.name]} (default: {', '.join(default + by_task)})"
            flag = "--" + field.name.replace("_", "-")
            parser.add_argument(flag, help=text.replace("%", "%%"), **kind_of(field))
    given = tuples(vars(parser.parse_args(argv)))
    return [
        {f.name: given[f.name] for f in fields(config) if f.name in given} for config in CONFIGS
    ]


def settle(given_env, given_learner):
    """tasks.Config and eipo.Config: defaults, then the task's own values, then what was given."""
    env_cfg = tasks.task_config(**given_env)
    return env_cfg, eipo.Config(**tasks.TASKS[env_cfg.task].learner | given_learner)


# ---- settings with which one can train ----

WORDS = dict(
    velocity_frame=("heading", "body"),
    clip=("torque", "power"),
    aux=("energy", "smooth"),
    reward=("paper", "shaped"),
)
# least and greatest value, or ends of a range, with unit and reason: worlds beyond are of no use
LIMITS = {
    "num_envs": (1, 2**16, ""),
    "threads": (1, 1024, ""),
    "history": (1, 100, " frames"),
    "num_envs * history": (1, 2**19, ", because each step of a rollout keeps so many frames"),
    "episode_steps": (1, 1e9, ""),
    "command_steps": (1, 1e9, ""),
    "timestep": (1e-9, 0.02, " s, because at 0.03 the motors' PD controllers blow up"),
    "physics_steps": (1, 100, ""),
    "clock_hz": (0, 1e9, " Hz"),
    "action_limit": (1e-9, 1e3, ""),
    "noise": (0, 100, ""),
    "roughness": (0, 1, " m, which is three times the height of the robot"),
    "cells_per_m": (
        1,
        0.5 / terrain.SPACING,
        f" cells, because points of the ground are {terrain.SPACING} m apart",
    ),
    "ground_seed": (0, 2**31 - 1, ""),
    "start_spread": (0, 10, ""),
    "tiles": (1, 1000, ", because that many take ten seconds to make"),
    "friction": (0, 1.5, ", because feet with more sink into the ground"),
    "payload": (-4.9, 20, " kg, on a trunk of 5.6 kg"),
    "com": (-0.1, 0.1, " m"),
    "motor_strength": (0.01, 100, ""),
    "motor_offset": (-1, 1, " rad"),
    "gravity": (-5, 5, " m/s^2, so that things still fall"),
    "latency": (0, 1000, " physics steps"),
    "max_power": (1e-9, 1e6, " W"),
}


def check_world(num_envs, env_cfg, threads):
    """Raise ValueError, in one line, for settings from which no useful world can be built."""
    tasks.task_config(env_cfg.task)
    given = vars(env_cfg) | {
        "num_envs": num_envs,
        "num_envs * history": num_envs * env_cfg.history,
        "threads": threads,
    }
    for name, choices in WORDS.items():
        if given[name] not in choices:
            raise ValueError(f"{name} is {given[name]!r}: it must be one of {', '.join(choices)}")
    for name, (low, high, why) in LIMITS.items():
        x = given[name]
        is_range = isinstance(x, tuple)
        what = "a range, low end first, within" if is_range else "from"
        ends = x if is_range else (x, x)
        # nan as well
        if x is not None and not (len(ends) == 2 and low <= ends[0] <= ends[1] <= high):
            raise ValueError(f"{name} is {x}: it must be {what} {low:g} to {high:g}{why}")


def check_learner(cfg, processes=1):
    """Raise ValueError, in one line, for an eipo.Config that cannot train, on so many processes."""
    ranges = dict.fromkeys(("gamma", "gae_lambda", "momentum_alpha", "dampening_alpha"), (0, 1))
    ranges |= dict(lr_alpha=(0, 1e4), seed=(0, 2**31 - 1), num_epochs=(1, 1000))
    ranges["log_std"] = LOG_STD_RANGE
    for field in fields(cfg):
        x = getattr(cfg, field.name)
        low, high = ranges.get(field.name, (int(field.type is int), 1e9))
        if type(x) in (int, float) and not low <= x <= high:  # nan as well
            raise ValueError(f"{field.name} is {x}: it must be from {low:g} to {high:g}")
    for wrong in (*wrong_method(cfg), *wrong_sizes(cfg, processes)):
        raise ValueError(wrong)


def wrong_method(cfg):
    """Yields what is wrong with the algorithm and the networks of an eipo.Config."""
    units = cfg.hidden + cfg.hidden_estimator
    if cfg.algo not in ("eipo", "ppo"):
        yield f"unknown algo {cfg.algo!r}: choose eipo or ppo"
    if cfg.algo == "ppo" and cfg.alpha0 is not None:
        yield "PPO's alpha is 1 / lam: give --lam instead of alpha0"
    if cfg.algo == "eipo" and cfg.lam == 0:
        yield "EIPO starts at alpha = 1 / lam, so lam must be positive: lam 0 is for ppo"
    if cfg.target_kl and not LR_RANGE[0] <= cfg.lr <= LR_RANGE[1]:
        low, high = LR_RANGE
        yield f"lr is {cfg.lr}: with a target_kl it stays in {low} to {high}, give --target-kl 0"
    if not all(1 <= n <= 4096 for n in units) or len(units) > 8:  # with Adam they take 8 GB
        what = f"hidden layers are {cfg.hidden} and {cfg.hidden_estimator}"
        yield f"{what}: give at most 8, of 1 to 4096 units"
    if cfg.mirror and any(n % 2 for n in units):
        yield "a hidden layer of odd width has no halves: or give --no-mirror"


def wrong_sizes(cfg, processes):
    """Yields what is wrong with the numbers of environments and samples of an eipo.Config."""
    policies = 2 if cfg.algo == "eipo" else 1
    shares = policies * processes
    samples = cfg.num_steps * cfg.num_envs
    what = f"num_envs is {cfg.num_envs}"
    if cfg.num_envs % policies:
        yield f"{what}: EIPO gives half to each policy, so it must be even"
    if cfg.num_envs % shares:
        share = f"{processes} processes have equal shares for each policy"
        yield f"{what}: {share}, so it must be a multiple of {shares}"
    if samples // shares < cfg.num_minibatches:
        few = "num_steps * num_envs gives each policy fewer samples than num_minibatches"
        yield f"{few}: raise num_envs"
    if samples > 2**21:  # a sample takes some kB
        yield f"num_steps is {cfg.num_steps} and {what}: a rollout has at most {2**21} samples"


# ---- settings in JSON ----


def tuples(record):
    """The record with its lists turned back into tuples, which JSON does not have."""
    return {name: tuple(x) if isinstance(x, list) else x for name, x in record.items()}


def to_config(kind, record):
    """The dataclass `kind` of a record from JSON. TypeError for other names or types."""
    config = kind(**tuples(record))
    for field in fields(kind):
        x = getattr(config, field.name)
        is_range = field.type is tuple
        part = type(field.default[0]) if is_range else field.type
        kinds = get_args(part) or (part,)  # for `float | None` these are float and NoneType
        allowed = {*kinds, int} if float in kinds else {*kinds}
        parts = x if is_range else (x,)
        if type(parts) is not tuple or not {type(y) for y in parts} <= allowed:
            what = "a list of " * is_range + " or ".join(k.__name__ for k in kinds)
            raise TypeError(f"{field.name} is {x!r}: it must be {what}")
    return config
