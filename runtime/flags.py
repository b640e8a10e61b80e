"""The flags of `train.py`, and which settings do not fit together.

Every field of `Options`, `tasks.Config` and `eipo.Config` is a flag of the same name, and the
comment behind the field is what `-h` says of it.
"""

import argparse
import inspect
import re
from dataclasses import dataclass, fields, is_dataclass
from typing import Literal, get_args, get_origin

import eipo
import tasks
from ppo import LR_RANGE
from runtime.cli import Parser, Refused


@dataclass(frozen=True)
class Options:
    """How to run. None of these fields changes what is learned."""

    out: str | None = None  # the run folder; without it runs/ gets one, named by what is trained
    resume: bool = False  # go on from the run folder's last checkpoint, with the settings it has
    threads: int | None = None  # threads that step the physics; without it one for each core
    checkpoint_every: int = 50  # iterations from one checkpoint to the next


GROUPS = {"how to run": Options, "the world": tasks.Config, "the learner": eipo.Config}
ABOUT = """`python train.py --task flat` trains a policy and keeps everything in a run folder.

tasks:
{tasks}

A run has 10 to 15 % of the paper's iterations, where it prints them. On flat and
curriculum alpha takes longer steps to make up for it (D38). The paper's length and step:
  --iterations 4000 --lr-alpha 0.01  (on velocity: --iterations 10000)

[IV-C] is a section of the paper, [lab code] what its authors published, [ours] neither; D38 is an
entry of deviations.md."""


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
    return dict(type=kind, metavar={int: "N", float: "X", str: "TEXT"}[kind])


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
    given = tasks.tuples(vars(parser.parse_args(argv)))
    return [{name: given[name] for name in describe(c) if name in given} for c in GROUPS.values()]


def settle(given_env, given_learner):
    """tasks.Config and eipo.Config: defaults, then the task's own values, then what was given."""
    env_cfg = tasks.task_config(**given_env)
    return env_cfg, eipo.Config(**tasks.TASKS[env_cfg.task].learner | given_learner)


def check(cfg):
    """Refuse settings of an eipo.Config that do not fit together."""
    policies = 2 if cfg.algo == "eipo" else 1
    batch = cfg.num_steps * cfg.num_envs // policies // cfg.num_minibatches
    units = cfg.hidden + cfg.hidden_estimator
    if cfg.algo == "eipo" and cfg.lam == 0:
        raise Refused("lam is 0: EIPO starts at alpha = 1 / lam, so only --algo ppo takes 0")
    if cfg.target_kl and not LR_RANGE[0] <= cfg.lr <= LR_RANGE[1]:
        raise Refused(f"lr is {cfg.lr}: adapted, it stays within {LR_RANGE}; or --target-kl 0")
    if cfg.mirror and any(n % 2 for n in units):
        raise Refused(f"one of {units} hidden units is odd, and has no half: or --no-mirror")
    if cfg.num_envs % policies:
        what = f"num_envs is {cfg.num_envs}: {policies} policies have equal shares"
        raise Refused(f"{what}, so it must be a multiple of {policies}")
    if batch < 1:
        raise Refused("num_minibatches is greater than num_steps * num_envs of each policy")
