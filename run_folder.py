"""What a run leaves on disk, written by `train.py` and read by everything that looks at a run.

    config.json      every setting; and the command, commit, machine and versions of the start and of each resumption
    metrics.csv      a row per iteration; columns that hold clock time have "time" or "per_s" in their name
    checkpoint.npz   all that the next iteration depends on: learners, optimisers, alpha, simulations, random generators
    policy.npz       all that it takes to run the policy
    curves.png       the metrics, drawn
    episodes.csv.gz  every episode that `evaluate.py` has played with this policy
    commands.png     on the task `curriculum`: which commands it has reached
    lock             empty; a process that trains here holds it

Nothing is pickled. All but metrics.csv, which grows by a row, are replaced in one step, so a reader finds the old file
or the new one. What cannot be read raises ValueError with one line that says why.
"""

import errno
import itertools
import json
import os
import platform
import shlex
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from dataclasses import asdict, fields, replace
from importlib.metadata import version
from pathlib import Path
from typing import get_args

import jax
import jax.numpy as jnp
import numpy as np

import contract
import curriculum
import eipo
import go1
import go1_env
import networks
import parallel
import tasks

try:
    import fcntl
except ImportError:
    fcntl = None  # Windows has none: nothing keeps a second process out of a run folder there

EPISODES = "episodes.csv.gz"
JAX_THREADS = "PJRT_NPROC"  # environment variable from which JAX takes its number of threads on a CPU


def stamp(folder):
    """What tells one policy of a run folder from a later one: time and size of policy.npz; None without one."""
    policy = folder / "policy.npz"
    return (policy.stat().st_mtime_ns, policy.stat().st_size) if policy.exists() else None


def commit():
    """The commit of this source, with a + if tracked files have changed since; "unknown" outside a git checkout."""
    command = ["git", "describe", "--always", "--abbrev=40", "--exclude=*", "--dirty=+"]
    try:
        return subprocess.check_output(command, cwd=Path(__file__).parent, stderr=subprocess.DEVNULL, text=True).strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def replace_file(path, write):
    """Call write(file) on a temporary file, then rename it to path: readers find the old file or the whole new one."""
    temporary = path.with_name(path.name + ".tmp")
    with open(temporary, "wb") as file:
        write(file)
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)


def check_writable(path):
    """Raise OSError if `replace_file` cannot write 2 MB to path: who is to work for hours wants to know before."""
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
    """Keep the run folder to this process, until it ends in whatever way. ValueError if another process has it."""
    with open(folder / "lock", "a") as file:
        try:
            if fcntl:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ValueError(f"{folder} is being trained by another process: wait for it or stop it") from None
        except OSError as error:  # some network drives have no locks
            print(f"{folder} cannot be locked ({error}): let no other process train there", file=sys.stderr)
        yield


def running(folder):
    """Whether a process is training in the folder."""
    try:
        if (folder / "lock").exists():
            with lock(folder):
                pass
    except (ValueError, OSError) as error:
        return isinstance(error, ValueError)
    return False


def save_config(folder, env_cfg, cfg, command, resume=False):
    """Write config.json: both Configs, and one more entry that says how, with what and where the run was started.

    command: list of the words that were typed; resume: whether to keep the entries of earlier starts
    """
    starts = json.loads((folder / "config.json").read_text())["starts"] if resume else []
    machine = f"{platform.machine()}, {os.cpu_count()} cores, python {platform.python_version()}"
    versions = {package: version(package) for package in ("jax", "optax", "mujoco", "numpy")}
    about = dict(command=shlex.join(command), commit=commit(), machine=machine, versions=versions)
    record = dict(env=asdict(env_cfg), learner=asdict(cfg), starts=[*starts, about])
    replace_file(folder / "config.json", lambda file: file.write((json.dumps(record, indent=1) + "\n").encode()))


def tuples(record):
    """The record with its lists turned back into tuples, which JSON does not have."""
    return {name: tuple(x) if isinstance(x, list) else x for name, x in record.items()}


def to_config(kind, record):
    """The dataclass `kind` of a record from JSON. TypeError for names and types that are not those of its fields."""
    config = kind(**tuples(record))
    for field in fields(kind):
        x, part = getattr(config, field.name), type(field.default[0]) if field.type is tuple else field.type
        kinds = get_args(part) or (part,)  # for `float | None` these are float and NoneType
        parts = x if field.type is tuple else (x,)
        if type(parts) is not tuple or not {type(y) for y in parts} <= {*kinds, *[int] * (float in kinds)}:
            what = "a list of " * (field.type is tuple) + " or ".join(k.__name__ for k in kinds)
            raise TypeError(f"{field.name} is {x!r}: it must be {what}")
    return config


def load_config(folder):
    """The tasks.Config and eipo.Config of a run."""
    try:
        record = json.loads((folder / "config.json").read_text())
        env_cfg, cfg = to_config(tasks.Config, record["env"]), to_config(eipo.Config, record["learner"])
        tasks.check(cfg.num_envs, env_cfg, None)
        eipo.check(cfg if cfg.algo == "eipo" else replace(cfg, alpha0=None))  # of PPO older runs have a number there
        return env_cfg, cfg
    except FileNotFoundError:
        raise ValueError(f"{folder} is not a run folder: it has no config.json") from None
    except (KeyError, TypeError, AttributeError, ValueError, RecursionError) as error:
        raise ValueError(f"{folder / 'config.json'} is damaged or of another version, see to it: {error}") from None


def read_npz(path):
    """The arrays of an npz file as a dict. Raises ValueError, in one line, for a missing or damaged file."""
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as arrays:
            if damaged := arrays.zip.testzip():  # NumPy trusts a header, and checks no sum if it is told to read less
                raise ValueError(f"the checksum of {damaged} is wrong")
            return dict(arrays)
    except FileNotFoundError:
        raise ValueError(f"{path} does not exist: is this a run folder, and has its run started?") from None
    except Exception as error:  # whatever the readers of zip, of npy and of the Python literal in its header may raise
        raise ValueError(f"{path} is damaged or was not written by train.py, so get it anew: {error}") from None


def checkpoint_arrays(state, envs):
    """All that the next iteration depends on: the leaves of the State, and what each of envs saves, by name."""
    leaves = jax.tree_util.tree_leaves_with_path(state)
    arrays = {"state" + jax.tree_util.keystr(path): np.asarray(leaf) for path, leaf in leaves}
    return arrays | {f"env{i}.{name}": x for i, env in enumerate(envs) for name, x in env.save().items()}


def save_checkpoint(path, state, envs, cfg):
    """Write checkpoint.npz: learners, optimisers, alpha, and the simulations and random generator of each of envs.

    The entry `settings` is both Configs and the number of JAX's threads, as JSON. Of several processes all call this
    and the first one writes; what the i-th has of its own, the simulations and where its rollouts begin, is `i/...`.
    """
    settings = dict(env=asdict(envs[0].env_cfg), learner=asdict(cfg), jax_threads=os.environ.get(JAX_THREADS))
    settings |= dict(processes=jax.process_count()) if jax.process_count() > 1 else {}
    arrays = checkpoint_arrays(state, envs)
    others = parallel.gather({name: x for name, x in arrays.items() if name.startswith(("env", "state.at"))})[1:]
    arrays |= {f"{i}/{name}": x for i, own in enumerate(others, 1) for name, x in own.items()}
    if jax.process_index() == 0:
        replace_file(path, lambda file: np.savez(file, **arrays, settings=json.dumps(settings)))


def check_settings(folder, env_cfg, cfg, processes=1):
    """The number of JAX's threads, as text, with which the checkpoint was trained; None if it does not say.

    Raises ValueError if the Configs, which are those of config.json, or the number of processes are not those with
    which it was trained.
    """
    path = folder / "checkpoint.npz"
    settings = str(read_npz(path).get("settings", "{}"))
    try:
        trained = json.loads(settings)
        parts = [(config, tuples(trained.get(part, {}))) for part, config in (("env", env_cfg), ("learner", cfg))]
    except (ValueError, AttributeError, RecursionError) as error:
        raise ValueError(f"{path} is damaged: {error}") from None
    for config, record in parts:
        for name, was in record.items():
            if name != "iterations" and (x := getattr(config, name, None)) != was:  # --resume may raise iterations
                raise ValueError(f"{folder / 'config.json'} says {name} {x}, but the run has {was}: set it back")
    if (was := trained.get("processes", 1)) != processes:
        raise ValueError(f"{folder} is a run on {was} process(es), not {processes}: --resume needs as many")
    return trained.get("jax_threads")


def load_checkpoint(path, template, envs):
    """The State in checkpoint.npz; envs are restored in place. template: any State of the same configuration.

    Of several processes all call this, the first one reads, and each gets what is its own.
    """
    process = jax.process_index()
    arrays = parallel.gather({} if process else read_npz(path))[0]
    arrays |= {name.removeprefix(f"{process}/"): x for name, x in arrays.items() if name.startswith(f"{process}/")}

    def restore(key, like):
        found = arrays["state" + jax.tree_util.keystr(key)]
        found = found if isinstance(like, np.ndarray | jax.Array) else found.item()
        return jnp.asarray(found) if isinstance(like, jax.Array) else found

    try:
        for name, like in checkpoint_arrays(template, envs).items():
            kinds = [f"{x.dtype.type.__name__} {x.shape}" for x in (arrays[name], like)]
            if kinds[0] != kinds[1]:
                raise ValueError(f"{name} is {kinds[0]}, not {kinds[1]}")
            if name.startswith(("state.pi", "state.dual")) and np.isfinite(like).all():
                check_finite({name: arrays[name]})
        state = jax.tree_util.tree_map_with_path(restore, template)
        for i, env in enumerate(envs):
            env.load({name.removeprefix(f"env{i}."): x for name, x in arrays.items() if name.startswith(f"env{i}.")})
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} is not a checkpoint of this run: {error}") from None
    return state


def save_policy(path, params, env_cfg):
    """Write policy.npz: all that it takes to run the policy without JAX and this project, as README shows.

    params: of plain MLPs, as `networks.EvenOdd.dense` returns them. The file has these arrays:

    estimator.0.W, .b ...  layers (n_in, n_out), (n_out,): H * 44 observations -> body velocity (3) [m/s], ELU between
    actor.0.W, .b ...      layers: H * 44 observations and the estimate -> action (12) [-], ELU between
    log_std                (12,) of the noise in training; a deployed policy takes the mean
    trace.time ...         50 steps of the policy's own run, from sensors to joint targets: see contract.py
    frame_scale            (44,) SI units -> observation; the table at the top of go1_env.py lists a frame's entries
    q_nominal              (12,) [rad]; action_scale (12,) [rad]: joint targets are q_nominal + action_scale * action
    kp, kd                 [N m / rad], [N m s / rad] of the PD controller, which runs at the rate of the physics
    config                 tasks.Config as JSON: history H, timestep, physics_steps, action_limit ...

    contract.py says which frame and sign every entry has. Joints: FR, FL, RR, RL x hip, thigh, calf.
    """
    layers = {"actor": params["actor"]["layers"], "estimator": params["estimator"]}
    weights = {f"{net}.{i}.{name}": np.asarray(x, np.float32) for net in layers for i, layer in enumerate(layers[net])
               for name, x in dict(W=layer.even, b=layer.bias).items()}  # fmt: skip
    units = dict(log_std=np.asarray(params["actor"]["log_std"]), q_nominal=go1.Q_NOMINAL, kp=go1.KP,
                 action_scale=go1_env.ACTION_SCALE, frame_scale=go1_env.FRAME_SCALE, kd=go1.KD)  # fmt: skip
    arrays = weights | units | dict(config=json.dumps(asdict(env_cfg))) | contract.trace(params, env_cfg)
    replace_file(path, lambda file: np.savez(file, **arrays))
    path.with_name(EPISODES).unlink(missing_ok=True)  # they were of the policy before


def check_finite(tree):
    """Raise ValueError if an array in a tree of arrays holds anything but finite numbers."""
    for path, x in jax.tree_util.tree_leaves_with_path(tree):
        if x.dtype.kind not in "biuf" or not np.isfinite(x).all():
            raise ValueError(f"{jax.tree_util.keystr(path)} does not hold finite numbers")


def add_trace(path):
    """Give an older policy.npz a trace, or a new one. Everything else in the file stays as it is."""
    arrays = read_npz(path) | contract.trace(*load_policy(path))
    replace_file(Path(path), lambda file: np.savez_compressed(file, **arrays))


def load_trace(path):
    """The trace in a policy.npz, {"time": (50,), "gravity": (50, 3), ...}: see contract.py."""
    found = {name.removeprefix("trace."): x for name, x in read_npz(path).items() if name.startswith("trace.")}
    if not found:
        raise ValueError(f"{path} has no trace, because it is of an older version: run_folder.add_trace adds one")
    return found


def load_policy(path):
    """The parameters that `networks.policy` takes and the environment's Config, from a policy.npz."""
    arrays = read_npz(path)

    def layers(net):
        indices = itertools.takewhile(lambda i: f"{net}.{i}.W" in arrays, itertools.count())
        no_odd = np.zeros((0, 0), np.float32)
        return [networks.Layer(arrays[f"{net}.{i}.W"], no_odd, arrays[f"{net}.{i}.b"]) for i in indices]

    try:
        env_cfg = to_config(tasks.Config, json.loads(str(arrays["config"])))
        tasks.check(1, env_cfg, None)
        params = dict(actor=dict(layers=layers("actor"), log_std=arrays["log_std"]), estimator=layers("estimator"))
        check_finite(params)
        obs = jax.ShapeDtypeStruct((env_cfg.history * go1_env.FRAME_WIDTH,), np.float32)
        with suppress(TypeError, ValueError):
            if [x.shape for x in jax.eval_shape(networks.policy, params, obs)] == [(12,), (12,), (3,)]:
                return params, env_cfg
        raise ValueError(f"its layers do not fit each other or its history of {env_cfg.history}")
    except (LookupError, TypeError, AttributeError, ValueError, RecursionError) as error:
        raise ValueError(f"{path} is not a policy of this version, so train it anew: {error}") from None


class Log:
    """metrics.csv, which grows by a row in each iteration."""

    def __init__(self, folder, done):
        """done: iterations behind us. Later rows are dropped, because their iterations will be computed again.

        The run does not need the earlier ones: if some are missing, it goes on, and a line on stderr says so.
        """
        self.path, self.done, self.start, self.names = folder / "metrics.csv", done, time.monotonic(), None
        rows = whole_rows(self.path) if done and self.path.exists() else []
        self.kept = list({row["iteration"]: row for row in rows if int(row["iteration"]) <= done}.values())
        if (missing := done - len(self.kept)) > 0:
            print(f"{self.path} lacks {missing} of {done} rows: the run goes on without them", file=sys.stderr)

    def row(self, iteration, metrics):
        """Write one row, and return it as a dict. Time counts from the last start or resumption."""
        seconds, new = time.monotonic() - self.start, iteration - self.done
        rate = metrics["steps"] / iteration * new / seconds
        row = dict(iteration=iteration) | metrics | dict(time_s=round(seconds, 2), steps_per_s=round(rate, 1))
        if not self.names or not self.path.exists():
            self.names = list((self.kept[0] if self.kept else {}) | row)  # another version may have other columns
            lines = map(self.line, [dict(zip(self.names, self.names, strict=True)), *self.kept])
            replace_file(self.path, lambda file: file.write("".join(lines).encode()))
        with open(self.path, "a", newline="") as file:
            file.write(self.line(row))
        return row

    def line(self, row):
        """A row as text."""
        return ",".join(str(row.get(name, "nan")) for name in self.names) + "\n"

    def sync(self):
        """Wait until all rows are on the disk. Then a checkpoint may follow them there."""
        with open(self.path, "a") as file:
            os.fsync(file.fileno())


def whole_rows(path):
    """The rows of metrics.csv as dicts of text, without what a crash or a full disk has torn."""
    names, *rows = (line.split(",") for line in path.read_text(errors="replace").split("\n")[:-1] or [""])
    rows = [dict(zip(names, row, strict=True)) for row in rows if len(row) == len(names)]
    return [row for row in rows if row.get("iteration", "").isdecimal()]


def read_metrics(folder):
    """The columns of metrics.csv: {"iteration": (n,), "reward": (n,), ...}, or {} if there is no row yet."""
    rows = whole_rows(folder / "metrics.csv")
    try:
        return {name: np.array([row[name] for row in rows], float) for name in rows[0]} if rows else {}
    except ValueError as error:
        raise ValueError(f"{folder / 'metrics.csv'} is damaged: {error}") from None


def draw_curves(folder):
    """Draw curves.png: the most telling columns of metrics.csv over environment steps."""
    from matplotlib.figure import Figure  # here, because it is slow to import

    columns = read_metrics(folder)
    panels = dict(reward="task reward per step", v_x="speed ahead [m/s]", power="power [W]",
                  gap="J(pi) - J(pi')", alpha="alpha", kl="KL per iteration")  # fmt: skip
    figure = Figure(figsize=(12, 6), layout="constrained")
    for axes, (name, title) in zip(figure.subplots(2, 3).flat, panels.items(), strict=True):
        for column, label in ((name, "pi"), ("prime_" + name, "pi'")):
            if column in columns and np.isfinite(columns[column]).any():
                axes.plot(columns["steps"] / 1e6, columns[column], label=label, linewidth=0.8)
        axes.set(title=title, xlabel="million steps")
        axes.grid(alpha=0.3)
    figure.axes[0].legend()
    replace_file(folder / "curves.png", lambda file: figure.savefig(file, dpi=100, format="png"))


def draw_commands(folder, weights):
    """Draw commands.png: the weights of the curriculum over the commands (see curriculum.py)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    extent = np.ravel([curriculum.LOW, curriculum.HIGH], "F")[[2, 3, 0, 1]]  # of yaw rate, then of v_x
    image = axes.imshow(weights, origin="lower", extent=extent, aspect="auto", vmin=0, vmax=1)
    axes.set(title=f"{weights.mean():.1%} of all commands", xlabel="yaw rate [rad/s]", ylabel="v_x [m/s]")
    figure.colorbar(image, label="weight")
    replace_file(folder / "commands.png", lambda file: figure.savefig(file, dpi=100, format="png"))
