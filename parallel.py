"""One run on several processes: each steps its own share of the environments, and all hold the same learner.

On one process `average` and `own_*` return what they get, `gather` a list of it, and `compiled` is `jax.jit`. Several
keep their learners equal to the bit, because every gradient is averaged before it is used. `jax.distributed` connects
them: Gloo between CPUs, NCCL between GPUs. A process takes the first device that it sees.
"""

import ctypes
import io
import os
import signal
import sys
import tempfile
import threading
from functools import lru_cache, wraps

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental.multihost_utils import process_allgather
from jax.flatten_util import ravel_pytree
from jax.sharding import Mesh, NamedSharding, PartitionSpec

AXIS = PartitionSpec("process")
JOIN, SILENCE = 60, 20  # s in which all processes must have come, and s after which a silent one counts as ended
LOST = "another process has ended, see what it said last; --resume goes on from the last checkpoint"
LEAVING = threading.Lock()


def join(coordinator, processes, process):
    """Connect with the others of a run. coordinator: HOST:PORT of process 0; process: number of this one of processes.

    Raises ValueError. If the others do not come, or get lost later, this process ends with a line and status 2.
    """
    host, _, port = str(coordinator).rpartition(":")
    if None in (coordinator, processes, process) or not (host and port.isdecimal() and 0 <= process < processes):
        raise ValueError("several processes need --coordinator HOST:PORT, --processes P and --process 0 to P - 1, "
                         f"not {coordinator}, {processes} and {process}")  # fmt: skip
    why = [f"not all of {processes} processes came to {coordinator} within {JOIN} s: check the flags of each"]
    said = tempfile.TemporaryFile()  # noqa: SIM115, it is needed to the end
    sys.stderr = os.fdopen(os.dup(2), "w", buffering=1)  # for Python alone: what C++ says goes to a file

    @ctypes.CFUNCTYPE(None, ctypes.c_int)
    def aborted(_):  # from C++: JAX has no exception for a coordinator that is lost
        text = os.pread(said.fileno(), 2**20, 0).decode(errors="replace")
        leave(why[0] if "distributed service" in text else text)

    os.dup2(said.fileno(), 2)
    ctypes.CDLL(None).signal(signal.SIGABRT, aborted)
    join.handler = aborted  # keeps it alive
    times = dict(initialization_timeout=JOIN, heartbeat_timeout_seconds=SILENCE, shutdown_timeout_seconds=JOIN)
    try:
        jax.distributed.initialize(coordinator, processes, process, **times)
    except (ValueError, RuntimeError) as error:
        raise ValueError(f"{coordinator} cannot be used, is the port taken? JAX says: {error}") from None
    why[0] = LOST


def leave(why):
    """End one of several processes with a line, at once: Python's own way would wait for those that are lost."""
    LEAVING.acquire()  # for good: the first thread to come says why
    print(f"train.py: {why}", file=sys.stderr, flush=True)
    os._exit(2)


def own_key(key):
    """A random key of this process."""
    return key if jax.process_count() == 1 else jax.random.fold_in(key, jax.process_index())


def own_seed(seed):
    """A seed of this process, for NumPy."""
    return seed if jax.process_count() == 1 else np.random.SeedSequence(seed, spawn_key=(jax.process_index(),))


def average(tree):
    """The means over the processes of the numbers in tree, in float32; inside of a `compiled` function and outside."""
    if jax.process_count() == 1:
        return tree
    if not any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves(tree)):
        return average_outside(tree, None)
    numbers, unravel = ravel_pytree(jax.tree.map(jnp.float32, tree))  # one message for all
    return unravel(jax.lax.pmean(numbers, *AXIS))


def gather(arrays):
    """The named arrays of every process, a list of dicts. Names and shapes may differ."""
    if jax.process_count() == 1:
        return [arrays]
    np.savez(file := io.BytesIO(), **arrays)
    lengths = reached(process_allgather, np.array(len(file.getvalue())))
    length = -(-lengths.max() // 2**16) * 2**16  # one of few, because JAX compiles anew for each
    rows = reached(process_allgather, np.frombuffer(file.getvalue().ljust(length, b"\0"), np.uint8))
    return [dict(np.load(io.BytesIO(row[:n]))) for row, n in zip(rows, lengths, strict=True)]


def reached(function, *args):
    """What function(*args) returns, which waits for the other processes. ValueError if one is lost."""
    try:
        return jax.block_until_ready(function(*args))
    except (ValueError, jax.errors.JaxRuntimeError) as error:
        raise ValueError(f"{LOST} ({error})") from None


def compiled(function):
    """function(*arrays, cfg), compiled. Its arrays and results are each process's own; it may call `average`."""
    alone = jax.jit(function, static_argnames="cfg")

    @lru_cache
    def together(cfg):
        devices = [next(d for d in jax.devices() if d.process_index == i) for i in range(jax.process_count())]
        mesh = Mesh(devices, tuple(AXIS))

        def one(arrays):
            return jax.tree.map(lambda x: x[None], function(*jax.tree.map(lambda x: x[0], arrays), cfg))

        # check_vma=True would sum gradients over the processes before `average` sees them
        run = jax.jit(jax.shard_map(one, mesh=mesh, in_specs=(AXIS,), out_specs=AXIS, check_vma=False))
        return run, NamedSharding(mesh, AXIS)

    @wraps(function)
    def call(*args):
        if jax.process_count() == 1:
            return alone(*args)
        *arrays, cfg = args
        run, sharding = together(cfg)

        def stack(x):
            x = jax.device_put(jnp.asarray(x)[None], jax.local_devices()[0])
            return jax.make_array_from_single_device_arrays((jax.process_count(), *x.shape[1:]), sharding, [x])

        return jax.tree.map(lambda x: x.addressable_data(0)[0], reached(run, jax.tree.map(stack, arrays)))

    return call


@compiled
def average_outside(tree, cfg):
    """`average` of numbers outside of a `compiled` function."""
    return average(tree)
