"""How a run starts, or goes on: its folder and its settings, checked before anything is written."""

from dataclasses import asdict, replace
from pathlib import Path

from runtime import checkpoint, jax_setup, robot, run_folder
from runtime.cli import Refused, warn
from runtime.flags import check, settle


def begin(options, given_env, given_learner):
    """The folder, tasks.Config and eipo.Config of a run that may start, or with --resume go on. It
    sets JAX up.

    options: flags.Options; given_env, given_learner: the fields that the command line sets.
    Raises Refused if its settings make no sense, or if its folder holds another run.
    """
    robot.refuse_other_model()
    settings = settle(given_env, given_learner)
    folder = run_path(options, *settings)
    if options.resume:
        return folder, *resumed(folder, options, given_env | given_learner)
    refuse_used(folder)
    check(options, *settings)
    jax_setup.set_threads(None)
    jax_setup.numerics()  # refuses if there is no device
    return folder, *settings


def resumed(folder, options, given):
    """Both Configs of the run in folder, with more iterations if given; JAX is set up as it was.

    given: the settings that the command line names, which must be the run's
    """
    env_cfg, cfg, began = checkpoint.load_settings(folder / "checkpoint.npz")
    settings = asdict(env_cfg) | asdict(cfg)
    for name, x in given.items():
        if x != settings[name] and not (name == "iterations" and x > settings[name]):
            what = f"{folder} runs with --{name.replace('_', '-')} {settings[name]}"
            raise Refused(f"{what}: --resume can only raise iterations")
    cfg = replace(cfg, iterations=given.get("iterations", cfg.iterations))
    check(options, env_cfg, cfg)
    jax_setup.set_threads(began["threads"])
    now = jax_setup.configuration() | jax_setup.numerics()
    # each JAX has settings of its own
    changed = [x for x in began if x in now and began[x] != now[x]]
    if changed:
        other = ", ".join(f"{x} {began[x]} and not {now[x]}" for x in changed)
        warn(f"the last start of {folder} began with {other}: last digits will differ")
    return env_cfg, cfg


def run_path(options, env_cfg, cfg):
    """The run folder: what --out says, or a name of task, algorithm, lambda, variant and seed."""
    others = (x for x in (env_cfg.aux, env_cfg.reward) if x not in ("energy", "paper"))
    variant = "".join(f"-{x}" for x in others)
    name = f"{env_cfg.task}-{cfg.algo}-lam{cfg.lam:g}{variant}-seed{cfg.seed}"
    return options.out or Path(f"runs/{name}")


def refuse_used(folder):
    """Refuse a folder that already holds a run."""
    if folder.exists() and not folder.is_dir():
        raise Refused(f"{folder} is a file: choose another --out")
    if found := [name for name in run_folder.FILES if (folder / name).exists()]:
        again = "--resume it" if "checkpoint.npz" in found else "empty the folder"
        line = f"{folder} already holds {found[0]} of a run"
        raise Refused(f"{line}: choose another --out, or {again}")
