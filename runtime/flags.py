"""The flags of `train.py`, what their numbers may be, and which do not fit together.

Every field of `Options`, `tasks.Config` and `eipo.Config` is a flag of the same name, and the
comment behind the field is what `-h` says of it.
"""

import argparse
import functools
import inspect
import re
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Literal, get_args, get_origin

import eipo
import go1
import tasks
import terrain
from ppo import LOG_STD_RANGE, LR_RANGE
from runtime.cli import A_SEED, COUNT, Parser, Refused, a_path, misfit, tuples


@dataclass(frozen=True)
class Options:
    """How to run. None of these fields changes what is learned."""

    out: Path | None = None  # the run folder; without it runs/ gets one, named by what is trained
    resume: bool = False  # go on from the run folder's last checkpoint, with the settings it has
    threads: int | None = None  # threads that step the physics; without it one for each core
    checkpoint_every: int = 50  # iterations from one checkpoint to the next


GROUPS = {"how to run": Options, "the world": tasks.Config, "the learner": eipo.Config}
FACTOR = {"at least": 1e-9, "at most": 10**9}  # products of a few still fit into float32
# What a number of each type may be, also both ends of a range: as much as can be simulated or
# learned from. 0 turns something off: the clock, noise, adaptation of lr, a weight, alpha's steps
LIMITS_OF = {int: COUNT, float: FACTOR | {"at least": 0}}
# with 0 nothing would be learned
NOT_0 = "action_limit", "clip_eps", "max_grad_norm", "reward_scale", "clip_alpha"
LIMITS = dict.fromkeys(NOT_0, FACTOR) | dict(  # of all that have limits of their own
    threads={"at least": 1, "at most": 1024},
    timestep={"at least": 1e-5, "at most": 0.02},  # with 0.03 s the joints of a PD motor oscillate
    roughness={"at least": 0, "at most": 10},
    # a cell needs two points: Perlin noise is 0 at its corners, so that of 20 cells is 0 everywhere
    cells_per_m={"at least": 1, "at most": round(1 / (2 * terrain.SPACING))},
    start_spread={"at least": 0, "at most": 10},
    friction={"at least": 1e-3, "at most": 100},  # with less MuJoCo's contacts explode
    payload={"at most": 100},  # at least so much that the trunk keeps some mass, see `check`
    com={"at least": -1, "at most": 1},
    motor_strength={"above": 0, "at most": 100},
    motor_offset={"at least": -10, "at most": 10},
    gravity={"at least": -9, "at most": 9},  # things still fall
    latency={"at least": 0, "at most": 1000},
    max_power={"above": 0},  # inf: no limit
    num_epochs=COUNT | {"at most": 10**4},  # JAX counts minibatches in 32 bits
    num_minibatches=COUNT | {"at most": 10**5},
    lr={"at least": 1e-9, "at most": 1},
    log_std=dict(zip(("at least", "at most"), LOG_STD_RANGE, strict=True)),
    num_envs=COUNT | {"at most": 2**31 - 1},  # what MuJoCo's batch takes
    momentum_alpha={"at least": 0, "below": 1},  # with 1 a gradient would count for ever
    gamma={"at least": 0, "at most": 1},
    gae_lambda={"at least": 0, "at most": 1},
    seed=A_SEED,
    ground_seed=A_SEED,
)
ABOUT = """`python train.py --task flat` trains a policy and keeps everything in a run folder.

tasks:
{tasks}

In a run that is k times shorter than the paper's, alpha's clock runs k times faster: its step is
0.01 k^2, its momentum 1 - 0.01 k (D38). --iterations alone does not change them. The paper's run:
  --iterations 4000 --lr-alpha 0.01 --momentum-alpha 0.99  (on velocity: --iterations 10000)

[IV-C] is a section of the paper, [lab code] what its authors published, [ours] neither; D38 is an
entry of deviations.md."""


@functools.cache  # it reads source files
def describe(config):
    """The comment behind each field of a config: {"gamma": "[lab code] discount, Eq. (1)", ...}."""
    source = "".join(inspect.getsource(c) for c in config.__mro__ if is_dataclass(c))
    return dict(re.findall(r"^    (\w+): .*?  # (.*)$", source, re.M))


def kind_of(field):
    """Arguments of argparse for a field, by its annotation."""
    if field.type is bool:
        return dict(action=argparse.BooleanOptionalAction)
    if field.name == "task":
        return dict(choices=list(tasks.TASKS))
    if get_origin(field.type) is Literal:
        return dict(choices=get_args(field.type))
    if field.type is tuple:
        if isinstance(field.default[0], int):
            return dict(type=int, nargs="+", metavar="N")
        return dict(type=float, nargs=2, metavar=("LOW", "HIGH"))
    kind, *_ = get_args(field.type) or (field.type,)  # of int | None it is int
    metavar = {int: "N", float: "X", Path: "FOLDER"}[kind]
    return dict(type=a_path if kind is Path else kind, metavar=metavar)


def limits():
    """What each number may be, as `misfit` takes it. Fields that are no numbers have no limits."""
    all_fields = [field for config in GROUPS.values() for field in fields(config)]
    types = {field.name: kind_of(field).get("type") for field in all_fields}
    return {name: LIMITS.get(name, LIMITS_OF[t]) for name, t in types.items() if t in LIMITS_OF}


def parse(argv):
    """The flags that were given: one dict of fields for each of GROUPS."""
    about = "\n".join(f"  {name:<10}  {task.about}" for name, task in tasks.TASKS.items())
    parser = Parser(
        "train.py",
        ABOUT.format(tasks=about),
        usage="train.py [--task TASK] [--algo eipo|ppo] [--out FOLDER] [--FIELD VALUE ...]",
        argument_default=argparse.SUPPRESS,
    )
    own = {task: x.world | x.learner for task, x in tasks.TASKS.items()}
    for title, config in GROUPS.items():
        group = parser.add_argument_group(title)
        by_name = {field.name: field for field in fields(config)}
        for name, comment in describe(config).items():
            default = by_name[name].default
            defaults = [] if default is None else [str(default)]
            defaults += [f"{task} {x[name]}" for task, x in own.items() if name in x]
            text = comment + f" (default: {', '.join(defaults)})" * bool(defaults)
            flag = "--" + name.replace("_", "-")
            group.add_argument(flag, help=text.replace("%", "%%"), **kind_of(by_name[name]))
    given = tuples(vars(parser.parse_args(argv)))
    return [{name: given[name] for name in describe(c) if name in given} for c in GROUPS.values()]


def settle(given_env, given_learner):
    """tasks.Config and eipo.Config: defaults, then the task's own values, then what was given."""
    env_cfg = tasks.task_config(**given_env)
    return env_cfg, eipo.Config(**tasks.TASKS[env_cfg.task].learner | given_learner)


def check(options, env_cfg, cfg):
    """Refuse settings with which nothing sensible can be learned, by themselves or together."""
    if line := misfit(vars(options) | vars(env_cfg) | vars(cfg), limits()):
        raise Refused(line)
    for name, x in vars(env_cfg).items():
        if isinstance(x, tuple) and x[0] > x[1]:
            raise Refused(f"--{name.replace('_', '-')} is {x[0]} {x[1]}: the lower end comes first")
    trunk = go1.build_model(env_cfg.timestep, None).body("trunk").mass[0]
    if env_cfg.payload[0] <= -trunk:
        what = f"the trunk has {trunk:g} kg, so it must be above -{trunk:g}"
        raise Refused(f"--payload is {env_cfg.payload[0]}: {what}")
    dt = env_cfg.timestep * env_cfg.physics_steps
    if dt > 0.5:
        what = f"with a timestep of {env_cfg.timestep:g} s that is a control step of {dt:g} s"
        raise Refused(f"--physics-steps is {env_cfg.physics_steps}: {what}, of at most 0.5 s")
    if env_cfg.clock_hz * dt > 0.5:
        steps = f"control steps of {dt:g} s, --timestep times --physics-steps,"
        what = f"{steps} show a clock of at most {0.5 / dt:g} Hz"
        raise Refused(f"--clock-hz is {env_cfg.clock_hz}: {what}")
    if cfg.lam < FACTOR["at least"] and (cfg.algo == "eipo" or cfg.lam):
        why = "EIPO starts at alpha = 1 / lam, and only --algo ppo takes 0"
        raise Refused(f"--lam is {cfg.lam:g}: it must be at least {FACTOR['at least']}; {why}")
    if cfg.target_kl and not LR_RANGE[0] <= cfg.lr <= LR_RANGE[1]:
        raise Refused(f"--lr is {cfg.lr}: it must be within {LR_RANGE}, or give --target-kl 0")
    units = cfg.hidden + cfg.hidden_estimator
    if cfg.mirror and any(n % 2 for n in units):
        raise Refused(f"of the hidden units {units} one is odd: make it even, or give --no-mirror")
    policies = 2 if cfg.algo == "eipo" else 1
    samples = cfg.num_steps * cfg.num_envs // policies
    if cfg.num_envs % policies:
        what = f"--num-envs is {cfg.num_envs}: {policies} policies have equal shares"
        raise Refused(f"{what}, so it must be a multiple of {policies}")
    if samples < 2:
        what = "a policy needs two samples, since the normalised advantage of one is 0"
        raise Refused(f"--num-envs is {cfg.num_envs}, and --num-steps {cfg.num_steps}: {what}")
    if samples < cfg.num_minibatches:
        raise Refused("--num-minibatches is greater than num_steps * num_envs of each policy")
