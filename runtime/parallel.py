"""One run on several processes. Each steps its share of the robots. All hold all samples and the
same learner, and share the arithmetic of every minibatch.

On one process nothing here does anything. On several, `Shared` shows the algorithm an environment
of all robots, and `spread` cuts the indices of each minibatch. Nothing else of a run knows of
processes. `jax.distributed` connects them: Gloo between CPUs, NCCL between GPUs. A process takes
the first device that it sees.
"""

import io
import socket
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import multihost_utils
from jax.flatten_util import ravel_pytree
from jax.sharding import AxisType, NamedSharding, PartitionSpec

from runtime.interrupt import leave_on_abort

# s in which all processes must have come, and s after which a silent one counts as ended
JOIN, SILENCE = 60, 20
LOST = "another process has ended, see what it said last; --resume goes on from the last checkpoint"


def join(coordinator, processes, process):
    """Connect with the other processes of a run.

    coordinator: HOST:PORT of process 0; process: which of `processes` this one is

    Raises ValueError. If the others do not come, or get lost later, this process ends with a line
    and status 2.
    """
    host, _, port = str(coordinator).rpartition(":")
    if None in (coordinator, processes, process) or not (
        host and port.isdecimal() and 0 <= process < processes
    ):
        needed = "--coordinator HOST:PORT, --processes P and --process 0 to P - 1"
        given = f"{coordinator}, {processes} and {process}"
        raise ValueError(f"several processes need {needed}, not {given}")
    why = [
        f"not all of {processes} processes came to {coordinator} within {JOIN} s: check the "
        "flags of each"
    ]
    # JAX raises nothing for some losses
    leave_on_abort(lambda said: why[0] if "distributed service" in said else said)
    # it would take SIGTERM, at which `train` saves and stops
    jax.config.update("jax_enable_preemption_service", False)
    times = dict(
        initialization_timeout=JOIN,
        heartbeat_timeout_seconds=SILENCE,
        shutdown_timeout_seconds=JOIN,
    )
    try:
        if process == 0:
            # JAX may crash without a word where the port is taken
            socket.create_server(("", int(port))).close()
        jax.distributed.initialize(coordinator, processes, process, **times)
    except (ValueError, RuntimeError, OSError, OverflowError) as error:
        raise ValueError(f"{coordinator} cannot be used, is the port taken? {error}") from None
    why[0] = LOST


def average(tree):
    """Means over the processes of the numbers in tree, float32."""
    if jax.process_count() == 1:
        return tree
    numbers, unravel = ravel_pytree(jax.tree.map(jnp.float32, tree))  # one message for all
    return unravel(jnp.mean(all_of(numbers), 0))


def sharding(*axes):
    """A NamedSharding over one device of each process."""
    first = {device.process_index: device for device in reversed(jax.devices())}
    devices = [first[i] for i in range(jax.process_count())]
    mesh = jax.make_mesh((len(devices),), ("process",), (AxisType.Auto,), devices=devices)
    return NamedSharding(mesh, PartitionSpec(*axes))


def spread(indices):
    """indices (minibatches, size), of which each process takes its part of every minibatch.

    XLA then divides the arithmetic of a minibatch among the processes, and adds up its parts.
    """
    if jax.process_count() == 1:
        return indices
    indices = np.asarray(indices)
    cut = sharding(None, "process")
    return jax.make_array_from_callback(indices.shape, cut, lambda part: indices[part])


def everywhere(tree):
    """The arrays of tree as arrays that all processes hold."""
    if jax.process_count() == 1:
        return tree

    def replicated(x):
        x = np.asarray(x)
        return jax.make_array_from_callback(x.shape, sharding(), lambda part: x[part])

    return jax.tree.map(replicated, tree)


class Shared:
    """An environment of the robots of all processes, of which this process steps its own."""

    def __init__(self, env):
        process, n = jax.process_index(), env.num_envs
        self.env = env
        self.num_envs = n * jax.process_count()
        self.mine = slice(process * n, (process + 1) * n)

    def __getattr__(self, name):
        return getattr(self.env, name)

    def reset(self, seed):
        return everyone(self.env.reset((seed, jax.process_index())))

    def observe(self):
        return everyone(self.env.observe())

    def step(self, action):
        return everyone(self.env.step(action[self.mine]))


def everyone(tree):
    """The arrays (n, ...) of every process, one after the other."""
    return reached(partial(multihost_utils.process_allgather, tiled=True), tree)


def gather(arrays):
    """The named arrays of every process, a list of dicts. Names and shapes may differ."""
    if jax.process_count() == 1:
        return [arrays]
    np.savez(file := io.BytesIO(), **arrays)
    lengths = all_of(np.array(len(file.getvalue())))
    length = -(-lengths.max() // 2**16) * 2**16  # one of few, because JAX compiles anew for each
    rows = all_of(np.frombuffer(file.getvalue().ljust(length, b"\0"), np.uint8))
    return [dict(np.load(io.BytesIO(row[:n]))) for row, n in zip(rows, lengths, strict=True)]


def all_of(array):
    """The array of every process, (P, ...)."""
    return reached(multihost_utils.process_allgather, array)


def reached(function, *args):
    """What function(*args) returns, which waits for the others. ValueError if one is lost."""
    try:
        return jax.block_until_ready(function(*args))
    except (ValueError, jax.errors.JaxRuntimeError) as error:
        raise ValueError(f"{LOST} ({error})") from None
