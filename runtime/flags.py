"""The flags of `train.py`: every field of `Options`, `tasks.Config` and `eipo.Config` is a flag of the same name."""

import argparse
import inspect
import re
from dataclasses import dataclass, fields
from typing import get_args

import eipo
import tasks
from runtime.settings import tuples


@dataclass(frozen=True)
class Options:
    """How to run. None of these fields changes what is learned."""

    out: str | None = None  # [ours] run folder; by default runs/<task>-<algo>-lam<lam>[-<variant>]-seed<seed>
    resume: bool = False  # [ours] continue the run in the folder; only --iterations can be changed, and only raised
    threads: int | None = None  # [ours] threads that step the physics; by default one for every core
    checkpoint_every: int = 50  # [ours] iterations between two checkpoints
    coordinator: str | None = None  # [ours] HOST:PORT on which process 0 meets the others of a run on several processes
    processes: int | None = None  # [ours] how many these are; each steps an equal share of the environments
    process: int | None = None  # [ours] which of them this one is, from 0; only process 0 needs the run folder


CONFIGS = (Options, tasks.Config, eipo.Config)
ABOUT = "`python train.py --task flat` trains a policy and keeps everything in a run folder."
LENGTH = """A run has 10 to 15 % of the paper's iterations, and alpha takes longer steps for it (D38). As in the paper:
  --iterations 4000 --lr-alpha 0.01 --momentum-alpha 0.99  (on velocity: --iterations 10000)"""


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
        usage=usage, description=f"{ABOUT}\n\ntasks:\n{about}\n\n{LENGTH}", allow_abbrev=False,
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
    given = tuples(vars(parser.parse_args(argv)))
    return [{f.name: given[f.name] for f in fields(config) if f.name in given} for config in CONFIGS]


def settle(given_env, given_learner):
    """tasks.Config and eipo.Config: defaults, overruled by the task's own values, overruled by what was given."""
    env_cfg = tasks.task_config(**given_env)
    return env_cfg, eipo.Config(**tasks.TASKS[env_cfg.task].learner | given_learner)
