"""What a run leaves on disk, written by `train.py` and read by everything that looks at a run.

    config.json      every setting; and the command, commit, machine and versions of the start and
                     of each resumption
    metrics.csv      a row per iteration; columns that hold clock time have "time" or "per_s" in
                     their name
    checkpoint.npz   all that the next iteration depends on: learners, optimisers, alpha,
                     simulations, random generators
    policy.npz       all that it takes to run the policy
    policy_prime.npz the same of pi_prime, when a run of EIPO has ended
    curves.png       the metrics, drawn
    episodes.csv.gz  episodes that `python -m lab` has played with this policy
    commands.png     on the task `curriculum`: which commands it has reached
    lock             empty; a process that trains here holds it

Nothing is pickled. All but metrics.csv, which grows by a row, are replaced in one step, so a reader
finds the old file or the new one. What cannot be read raises ValueError with one line that says
why.
"""

import errno
import json
import os
import platform
import re
import shlex
import subprocess
import sys
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
from runtime.flags import check_learner, check_world, to_config, tuples

try:
    import fcntl
except ImportError:
    fcntl = None  # Windows has none: nothing keeps a second process out of a run folder there

EPISODES = "episodes.csv.gz"
# environment variable from which JAX takes its number of threads on a CPU
JAX_THREADS = "PJRT_NPROC"


def commit():
    """The commit of this source, with a + if it was changed since; "unknown" outside of git."""
    command = ["git", "describe", "--always", "--abbrev=40", "--exclude=*", "--dirty=+"]
    try:
        return subprocess.check_output(
            command, cwd=Path(__file__).parent, stderr=subprocess.DEVNULL, text=True
        ).strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def cpu_model():
    """The name of this machine's processor, as the system gives it."""
    try:
        names = re.findall(r"^model name\s*: (.*)$", Path("/proc/cpuinfo").read_text(), re.M)
    except OSError:  # no Linux
        names = []
    return names[0] if names else platform.processor()


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


def check_writable(path):
    """Raise OSError if `replace_file` cannot write 2 MB to path, before hours of work."""
    temporary = path.with_name(path.name + ".tmp")
    try:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, "a folder is in the way")
        with open(temporary, "wb") as file:
            file.write(bytes(2**21))
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def lock(folder):
    """Keep the run folder to this process, until it ends. ValueError if another one has it."""
    with open(folder / "lock", "a") as file:
        try:
            if fcntl:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ValueError(
                f"{folder} is being trained by another process: wait for it or stop it"
            ) from None
        except OSError as error:  # some network drives have no locks
            print(
                f"{folder} cannot be locked ({error}): let no other process train there",
                file=sys.stderr,
            )
        yield


def save_config(folder, env_cfg, cfg, command, resume=False):
    """Write config.json: both Configs, and one more entry about this start.

    command: list of the words that were typed; resume: whether to keep the entries of earlier
        starts
    """
    starts = json.loads((folder / "config.json").read_text()).get("starts") if resume else []
    if not isinstance(starts, list):
        raise ValueError(f"{folder / 'config.json'} is damaged: its starts are {starts}, no list")
    machine = f"{platform.machine()}, {os.cpu_count()} cores, python {platform.python_version()}"
    versions = {package: version(package) for package in ("jax", "optax", "mujoco", "numpy")}
    about = dict(command=shlex.join(command), commit=commit(), machine=machine, versions=versions)
    about |= dict(cpu=cpu_model(), cores=CORES)
    record = dict(env=asdict(env_cfg), learner=asdict(cfg), starts=[*starts, about])
    replace_file(
        folder / "config.json",
        lambda file: file.write((json.dumps(record, indent=1) + "\n").encode()),
    )


def load_config(folder):
    """The tasks.Config and eipo.Config of a run."""
    try:
        record = json.loads((folder / "config.json").read_text())
        env_cfg = tasks.read_config(record["env"])
        cfg = to_config(eipo.Config, record["learner"])
        check_world(cfg.num_envs, env_cfg, None)
        check_learner(cfg)
        return env_cfg, cfg
    except FileNotFoundError:
        raise ValueError(f"{folder} is not a run folder: it has no config.json") from None
    except (KeyError, TypeError, AttributeError, ValueError, RecursionError) as error:
        raise ValueError(
            f"{folder / 'config.json'} is damaged or of another version, see to it: {error}"
        ) from None


def read_npz(path):
    """The arrays of an npz file as a dict. ValueError, in one line, if it is missing or damaged."""
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as arrays:
            # NumPy trusts a header, and checks no sum if it is told to read less
            if damaged := arrays.zip.testzip():
                raise ValueError(f"the checksum of {damaged} is wrong")
            return dict(arrays)
    except FileNotFoundError:
        # and so the run was evaluated, before its policy was removed
        kept = (Path(path).parent / EPISODES).exists()
        hint = (
            "this folder keeps its run's numbers alone, "
            "and config.json has the command that trains it again"
        )
        hint = hint if kept else "is this a run folder, and has its run started?"
        raise ValueError(f"{path} does not exist: {hint}") from None
    # whatever the readers of zip, of npy and of the Python literal in its header may raise
    except Exception as error:
        raise ValueError(
            f"{path} is damaged or was not written by train.py, so get it anew: {error}"
        ) from None


def saved(env):
    """What a checkpoint stores of a Go1Env: all that its next step depends on, by name."""
    rng = np.array(json.dumps(env.rng.bit_generator.state))
    return {name: x.copy() for name, x in vars(env.state).items()} | dict(rng=rng)


def restore_env(env, arrays):
    """Let env continue from what `saved` returned, with the same bits as if never stopped."""
    for name, x in vars(env.state).items():
        x[:] = arrays[name]
    env.batch.set_const()  # what MuJoCo derives from the masses
    env.rng.bit_generator.state = json.loads(str(arrays["rng"]))


def checkpoint_arrays(state, envs):
    """All that the next iteration depends on, by name: leaves of the State, `saved` envs."""
    leaves = jax.tree_util.tree_leaves_with_path(state)
    arrays = {"state" + jax.tree_util.keystr(path): np.asarray(leaf) for path, leaf in leaves}
    return arrays | {
        f"env{i}.{name}": x for i, env in enumerate(envs) for name, x in saved(env).items()
    }


def save_checkpoint(path, state, envs, cfg):
    """Write checkpoint.npz: the State, and the simulations and random generators of envs.

    The entry `settings` is both Configs and the number of JAX's threads, as JSON. Of several
    processes all call this and the first one writes; what the i-th has of its own, the simulations
    and where its rollouts begin, is `i/...`.
    """
    settings = dict(
        env=asdict(envs[0].env_cfg), learner=asdict(cfg), jax_threads=os.environ.get(JAX_THREADS)
    )
    settings |= dict(processes=jax.process_count()) if jax.process_count() > 1 else {}
    arrays = checkpoint_arrays(state, envs)
    prefixes = ("env",)
    mine = {name: x for name, x in arrays.items() if name.startswith(prefixes)}
    others = parallel.gather(mine)[1:]
    arrays |= {f"{i}/{name}": x for i, own in enumerate(others, 1) for name, x in own.items()}
    if jax.process_index() == 0:
        replace_file(path, lambda file: np.savez(file, **arrays, settings=json.dumps(settings)))


def check_settings(folder, env_cfg, cfg, processes=1):
    """The number of JAX's threads, as text, that the checkpoint was trained with, or None.

    Raises ValueError if it was trained with other Configs than these of config.json, or on another
    number of processes.
    """
    path = folder / "checkpoint.npz"
    settings = str(read_npz(path).get("settings", "{}"))
    try:
        trained = json.loads(settings)
        parts = [
            (config, tuples(trained.get(part, {})))
            for part, config in (("env", env_cfg), ("learner", cfg))
        ]
    except (ValueError, AttributeError, RecursionError) as error:
        raise ValueError(f"{path} is damaged: {error}") from None
    for config, record in parts:
        for name, was in record.items():
            # --resume may raise iterations
            if name != "iterations" and (x := getattr(config, name, None)) != was:
                raise ValueError(
                    f"{folder / 'config.json'} says {name} {x}, but the run has {was}: set it back"
                )
    if (was := trained.get("processes", 1)) != processes:
        raise ValueError(
            f"{folder} is a run on {was} process(es), not {processes}: --resume needs as many"
        )
    if not isinstance(threads := trained.get("jax_threads"), str | None):
        raise ValueError(f"{path} is damaged: its jax_threads are {threads}, no text")
    return threads


def load_checkpoint(path, template, envs):
    """The State in checkpoint.npz; envs are restored in place. template: a State of its Config.

    Of several processes all call this, the first one reads, and each gets what is its own.
    """
    process = jax.process_index()
    arrays = parallel.gather({} if process else read_npz(path))[0]
    arrays |= below(arrays, f"{process}/")

    def restore(key, like):
        found = arrays["state" + jax.tree_util.keystr(key)]
        found = found if isinstance(like, np.ndarray | jax.Array) else found.item()
        return jnp.asarray(found) if isinstance(like, jax.Array) else found

    try:
        for name, like in checkpoint_arrays(template, envs).items():
            check_array(name, arrays[name], like)
        state = jax.tree_util.tree_map_with_path(restore, template)
        for i, env in enumerate(envs):
            restore_env(env, below(arrays, f"env{i}."))
    except (LookupError, TypeError, AttributeError, ArithmeticError, ValueError) as error:
        raise ValueError(f"{path} is not a checkpoint of this run: {error}") from None
    except RecursionError:
        raise ValueError(f"{path} is not a checkpoint of this run: its rng is nested") from None
    return state


def below(arrays, prefix):
    """The arrays whose names begin with a prefix, without it."""
    named = [name for name in arrays if name.startswith(prefix)]
    return {name.removeprefix(prefix): arrays[name] for name in named}


def check_array(name, x, like):
    """Raise ValueError if x has not the kind of another array, or is not finite while that is."""
    kind, expected = (f"{array.dtype.type.__name__} {array.shape}" for array in (x, like))
    if kind != expected:
        raise ValueError(f"{name} is {kind}, not {expected}")
    numbers = like.dtype.kind in "fc" and np.isfinite(like).all()
    if numbers and not np.isfinite(x).all():
        raise ValueError(f"{name} does not hold finite numbers")
