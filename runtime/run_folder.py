"""What a run leaves on disk, written by `train.py` and read by everything that looks at a run.

    config.json       every setting; command, commit, machine and versions of each start
    metrics.csv       a row per iteration; clock time is where "time" or "per_s" is in the name
    checkpoint.npz    all that the next iteration depends on, and the settings with which it goes on
    policy.npz        all that it takes to run the policy pi; EIPO adds policy_prime.npz
    curves.png        the metrics, drawn
    lock              empty; a process that trains here holds it

Nothing is pickled. All but the lock are written with each checkpoint, and replaced in one step, so
a reader finds the old file or the new one. What cannot be read is refused, in one line.
checkpoint.npz has a file of its own, `checkpoint.py`, because it takes JAX.
"""

import json
import os
import platform
import shlex
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import asdict, fields
from pathlib import Path

import numpy as np

import go1
import go1_env
import policy
import tasks
from runtime import robot
from runtime.cli import Refused, tuples, warn

try:
    import fcntl
except ImportError:
    fcntl = None  # Windows has none: nothing keeps a second process out of a run folder there

FILES = "config.json", "metrics.csv", "checkpoint.npz", "policy.npz", "policy_prime.npz"


@contextmanager
def reading(path):
    """Turn any error of reading a file into Refused, with one line that names the file."""
    try:
        yield
    except (Refused, MemoryError):
        raise
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError, PermissionError) as error:
        raise Refused(f"{path}: {error.strerror}") from None
    except Exception as error:  # whatever the readers of npz, JSON or CSV may raise
        what = f"is damaged, or of another program: {error!r:.200}"  # of a file that may be long
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
    finally:  # a disk that is full should not also keep a half-written file
        temporary.unlink(missing_ok=True)


@contextmanager
def lock(folder):
    """Make a run folder and keep it to this process. Raises Refused if another one has it."""
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / "lock", "a") as file:
        try:
            if fcntl:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise Refused(f"{folder} is being trained by another process: stop it") from None
        except OSError as error:  # a file system of a network may have no locks
            warn(f"{folder} cannot be locked ({error}): let nothing else write there")
        yield


# ---- config.json ----


def commit():
    """The commit of this source, with a + if any of it was changed or added since.

    It is "unknown" unless git tracks this very file: the source may be a copy that lies in another
    repository. Settings of git in somebody's shell, such as GIT_DIR, are of something else.
    """
    here = Path(__file__)
    env = {name: x for name, x in os.environ.items() if not name.startswith("GIT_")}

    def git(*words):
        options = dict(cwd=here.parent, env=env, check=True, capture_output=True, text=True)
        return subprocess.run(["git", "--no-optional-locks", *words], **options).stdout.strip()

    try:
        git("ls-files", "--error-unmatch", here.name)
        changes = git("status", "--porcelain", "--untracked-files=all", ":/*.py", ":/*.xml")
        return git("rev-parse", "HEAD") + "+" * bool(changes)
    except (OSError, subprocess.CalledProcessError):  # no git, no commit, or an owner it distrusts
        return "unknown"


def starts(folder):
    """The entries in the config.json of a run folder, one for each start."""
    with reading(path := folder / "config.json"):
        return [*json.loads(path.read_text())["starts"]]


def record(env_cfg, cfg, words, numerics, earlier=()):
    """What config.json says: both Configs, and one more entry about this start.

    words: of its command line; numerics: of `jax_setup`; earlier: entries of earlier starts
    """
    machine = f"{platform.machine()}, {os.cpu_count()} cores, python {platform.python_version()}"
    start = dict(command=shlex.join(words), commit=commit(), machine=machine)
    start |= dict(cores=go1_env.CORES, jax=numerics)
    return dict(env=asdict(env_cfg), learner=asdict(cfg), starts=[*earlier, start])


def save_config(folder, recorded):
    """Write config.json; recorded: what `record` returned."""
    text = json.dumps(recorded, indent=1) + "\n"
    replace_file(folder / "config.json", lambda file: file.write(text.encode()))


def command(script, *words):
    """A command line of a script of this project, as a user in this folder would type it."""
    paths = Path(sys.executable), Path(__file__).parents[1] / script
    here = Path.cwd()
    paths = [path.relative_to(here) if path.is_relative_to(here) else path for path in paths]
    return shlex.join([*map(str, paths), *words])


# ---- policy.npz ----


def of_the_robot():
    """The fields of policy.Policy that describe our robot."""
    scales = dict(frame_scale=go1_env.FRAME_SCALE, action_scale=go1.ACTION_SCALE)
    return scales | dict(q_nominal=go1.Q_NOMINAL, kp=go1.KP, kd=go1.KD)


def save_policy(path, params, env_cfg, origin):
    """Write policy.npz; params: as in `networks.py`.

    origin: {name: value} of its iteration, algo, lam and seed
    """
    layers = {net: params[net].layers for net in ("actor", "estimator")}
    about = origin | dict(robot=robot.digest())
    pi = policy.Policy(**layers, **of_the_robot(), config=asdict(env_cfg), about=about)
    replace_file(path, lambda file: policy.save(file, pi))


def read_config(settings):
    """The tasks.Config of a dict that comes from JSON.

    Raises ValueError if its fields are not those of tasks.Config, or if there is no such task.
    """
    env_cfg = config_of(tasks.Config, settings)
    if env_cfg.task not in tasks.TASKS:
        raise ValueError(f"there is no task {env_cfg.task}")
    return env_cfg


def config_of(kind, settings):
    """A Config of this kind with settings from JSON: ValueError unless they are just its fields."""
    if other := {f.name for f in fields(kind)} ^ settings.keys():
        raise ValueError(f"its settings and ours differ in {', '.join(sorted(other))}")
    return kind(**tuples(settings))


def load_policy(path):
    """The Policy in a policy.npz, and the tasks.Config of its world. Its robot must be ours."""
    robot.refuse_other_model()
    with reading(path):
        pi = policy.load(path)
        other = [
            name for name, x in of_the_robot().items() if not np.array_equal(getattr(pi, name), x)
        ]
        if other:
            raise ValueError(f"its robot has another {', '.join(other)}")
        env_cfg = read_config(pi.config)
        robot.refuse_other_digest(path, pi.about["robot"])
        if missing := {"iteration", "algo", "lam", "seed"} - pi.about.keys():
            raise ValueError(f"it does not say its {', '.join(sorted(missing))}")
        return pi, env_cfg
