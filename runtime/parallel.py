"""One run on several processes: each steps its own share of the environments, and all hold the same
learner.

On one process `average`, `pooled` and `own_key` return what they get, `gather` a list of it, and
`compiled` is `jax.jit`. Several keep their learners equal to the bit, because every gradient is
averaged before it is used. `jax.distributed` connects them: Gloo between CPUs, NCCL between GPUs. A
process takes the first device that it sees.
"""

import io
import socket
from functools import lru_cache, wraps

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import multihost_utils
from jax.flatten_util import ravel_pytree
from jax.sharding import Mesh, PartitionSpec

from runtime.interrupt import leave_on_abort

AXIS = PartitionSpec("process")
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


def own_key(key):
    """A random key of this process; the first process keeps the one that it is given."""
    return jax.random.fold_in(key, jax.process_index()) if jax.process_index() else key


def average(tree):
    """Means over the processes of the numbers in tree, float32; also inside of `compiled`."""
    if jax.process_count() == 1:
        return tree
    numbers, unravel = ravel_pytree(jax.tree.map(jnp.float32, tree))  # one message for all
    inside = isinstance(numbers, jax.core.Tracer)
    return unravel(jax.lax.pmean(numbers, *AXIS) if inside else jnp.mean(all_of(numbers), 0))


def pooled(log):
    """A dict of numbers of every process as one: floats are averaged, ints (counts) added."""
    counts = {name: jax.process_count() if isinstance(x, int) else 1 for name, x in log.items()}
    return {name: float(x) * counts[name] for name, x in average(log).items()}


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


def compiled(function):
    """function(*arrays, cfg), compiled. Arrays and results are this process's own."""
    alone = jax.jit(function, static_argnames="cfg")

    @lru_cache
    def together(cfg):
        devices = [
            next(d for d in jax.devices() if d.process_index == i)
            for i in range(jax.process_count())
        ]
        mesh = Mesh(devices, tuple(AXIS))

        def one(rows):
            return jax.tree.map(
                lambda x: x[None], function(*jax.tree.map(lambda x: x[0], rows), cfg)
            )

        # check_vma=True would sum gradients over the processes before `average` sees them
        return mesh, jax.jit(
            jax.shard_map(one, mesh=mesh, in_specs=(AXIS,), out_specs=AXIS, check_vma=False)
        )

    @wraps(function)
    def call(*args):
        if jax.process_count() == 1:
            return alone(*args)
        *arrays, cfg = args
        mesh, run = together(cfg)
        rows = jax.tree.map(lambda x: jnp.asarray(x)[None], arrays)
        results = reached(run, multihost_utils.host_local_array_to_global_array(rows, mesh, AXIS))
        return jax.tree.map(lambda x: x.addressable_data(0)[0], results)

    return call
