"""What a run leaves on disk, written by `train.py` and read by everything that looks at a run.

    config.json       every setting; command, commit, machine and versions of each start
    metrics.csv       a row per iteration; clock time is where "time" or "per_s" is in the name
    checkpoint.npz    all that the next iteration depends on, and the settings with which it goes on
    policy.npz        all that it takes to run the policy pi; EIPO adds policy_prime.npz at the end
    curves.png        the metrics, drawn
    lock              empty; a process that trains here holds it

Nothing is pickled. All but metrics.csv, which grows by a row, are replaced in one step, so a reader
finds the old file or the new one. What cannot be read is refused, in one line.
"""

import json
import os
import platform
import re
import shlex
import subprocess
from contextlib import contextmanager
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import eipo
import tasks
from go1_env import CORES
from runtime import parallel
from runtime.command import Refused
from runtime.jax_setup import surroundings

try:
    import fcntl
except ImportError:
    fcntl = None  # Windows has none: nothing keeps a second process out of a run folder there

FILES = "config.json", "metrics.csv", "checkpoint.npz", "policy.npz", "policy_prime.npz"


@contextmanager
def reading(path):
    """The one place where a file that cannot be read becomes one line that names it."""
    try:
        yield
    except Exception as error:  # whatever the readers of npz, JSON or CSV may raise
        missing = isinstance(error, FileNotFoundError)
        what = "does not exist" if missing else f"is damaged, or of another program: {error!r}"
        raise Refused(f"{path} {what}") from None


def read_npz(path):
    """The arrays of an npz file as a dict."""
    # opened here, because np.load leaves a damaged file open
    with reading(path), open(path, "rb") as file, np.load(file) as arrays:
        return dict(arrays)


def replace_file(path, write):
    """Call write(file) on a temporary file, and rename it to path: readers find old or new."""
    temporary = path.with_name(path.name + ".tmp")
    try:
        with open(temporary, "wb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:  # a disk that is full shall not also keep what is half written
        temporary.unlink(missing_ok=True)


@contextmanager
def lock(folder):
    """Make the run folder and keep it to this process, until it ends, unless another one has it."""
    if folder.is_symlink() and not folder.exists():
        raise Refused(f"{folder} is a link to {folder.readlink()}, which does not exist")
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / "lock", "a") as file:
        try:
            if fcntl:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise Refused(f"{folder} is being trained by another process: stop it") from None
        yield


# ---- config.json ----


def commit():
    """The commit of this source, with a + if it was changed since; "unknown" outside of git."""
    here = Path(__file__)
    is_ours = ["ls-files", "--error-unmatch", here.name]  # and not a copy in somebody's repository
    describe = ["describe", "--always", "--abbrev=40", "--exclude=*", "--dirty=+"]
    options = dict(cwd=here.parent, capture_output=True, text=True)
    try:
        _, found = (subprocess.run(["git", *x], check=True, **options) for x in (is_ours, describe))
        return found.stdout.strip()
    except (FileNotFoundError, subprocess.CalledProcessError):  # there is no git, or no commit
        return "unknown"


def cpu_model():
    """The name of this machine's processor, as the system gives it."""
    linux = Path("/proc/cpuinfo")
    names = re.findall(r"model name\s*: (.*)", linux.read_text()) if linux.exists() else []
    return names[0] if names else platform.processor()


def save_config(folder, env_cfg, cfg, command, resume=False):
    """Write config.json: both Configs, and one more entry about this start.

    command: list of the words that were typed; resume: whether to keep earlier starts' entries
    """
    path = folder / "config.json"
    with reading(path):
        starts = json.loads(path.read_text())["starts"] if resume else []
    machine = f"{platform.machine()}, {os.cpu_count()} cores, python {platform.python_version()}"
    versions = {package: version(package) for package in ("jax", "optax", "mujoco", "numpy")}
    about = dict(command=shlex.join(command), commit=commit(), machine=machine, versions=versions)
    about |= dict(cpu=cpu_model(), cores=CORES)
    record = dict(env=asdict(env_cfg), learner=asdict(cfg), starts=[*starts, about])
    text = json.dumps(record, indent=1) + "\n"
    replace_file(path, lambda file: file.write(text.encode()))


# ---- checkpoint.npz ----


def saved(env):
    """What a checkpoint stores of a Go1Env: all that its next step depends on, by name."""
    # of one length on all processes
    rng = np.array(json.dumps(env.rng.bit_generator.state), "U256")
    return {name: x.copy() for name, x in vars(env.state).items()} | dict(rng=rng)


def restore_env(env, arrays):
    """Let env continue from what `saved` returned, with the same bits as if never stopped."""
    for name, x in vars(env.state).items():
        x[:] = arrays[name]
    env.batch.set_const()  # what MuJoCo derives from the masses
    env.rng.bit_generator.state = json.loads(str(arrays["rng"]))


def save_checkpoint(path, state, envs, cfg):
    """Write the State, the settings, and the environments of every process, which all call this."""
    leaves = jax.tree_util.tree_leaves_with_path(state)
    arrays = {"state" + jax.tree_util.keystr(key): np.asarray(leaf) for key, leaf in leaves}
    for i, env in enumerate(envs):
        of_all = parallel.everyone({name: x[None] for name, x in saved(env).items()})
        for name, each in of_all.items():
            arrays |= {f"process{p}.env{i}.{name}": x for p, x in enumerate(each)}
    settings = dict(env=asdict(envs[0].env_cfg), learner=asdict(cfg))
    settings |= dict(surroundings=surroundings(), processes=jax.process_count())
    arrays["settings"] = np.array(json.dumps(settings))
    if jax.process_index() == 0:
        replace_file(path, lambda file: np.savez(file, **arrays))


def load_settings(path):
    """Both Configs of a checkpoint, its `surroundings`, and how many processes there were."""
    arrays = read_npz(path)
    with reading(path):
        record = json.loads(str(arrays["settings"]))
        env_cfg, cfg = tasks.read_config(record["env"]), tasks.tuples(record["learner"])
        return env_cfg, eipo.Config(**cfg), record["surroundings"], record["processes"]


def load_checkpoint(path, template, envs):
    """The State in a checkpoint, of the same shape as template; envs are restored in place.

    Of several processes each reads it, and restores its own environments.
    """
    process = jax.process_index()
    arrays = read_npz(path)

    def restore(key, like):
        found = arrays["state" + (name := jax.tree_util.keystr(key))]
        if found.shape != np.shape(like):
            raise ValueError(f"{name} has the shape {found.shape}, and not {np.shape(like)}")
        return found.item() if isinstance(like, int | float) else jnp.asarray(found)

    with reading(path):
        state = jax.tree_util.tree_map_with_path(restore, template)
        for i, env in enumerate(envs):
            prefix = f"process{process}.env{i}."
            restore_env(env, {name: arrays[prefix + name] for name in saved(env)})
    return state
