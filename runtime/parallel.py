"""One run on several processes. Each steps its share of the robots. All hold all samples and the
same learner, and share the arithmetic of every minibatch.

`Shared` shows the algorithm an environment of all robots, and `join` puts a mean over the processes
in the place of `ppo.gradient`. The algorithm itself knows nothing of them. `jax.distributed`
connects them: Gloo between CPUs, NCCL between GPUs. A process takes the first device that it sees.
"""

import json
import os
import socket
import sys
import traceback
import zlib
from contextlib import contextmanager

import jax
import numpy as np
from jax.experimental import multihost_utils
from jax.flatten_util import ravel_pytree
from jax.sharding import AxisType, PartitionSpec

import ppo
from runtime.cli import Refused, complaint

# s in which all processes must have come, and s after which a silent one counts as ended
JOIN, SILENCE = 60, 20


def join(coordinator, processes, process):
    """Connect with the other processes of a run.

    coordinator: HOST:PORT of process 0; process: which of `processes` this one is
    """
    host, _, port = str(coordinator).rpartition(":")
    if None in (processes, process) or not (host and port.isdecimal() and process < processes):
        raise Refused(
            "several processes need --coordinator HOST:PORT, --processes P and --process 0 to "
            f"P - 1, not {coordinator}, {processes} and {process}"
        )
    # it would take SIGTERM, at which `train` saves and stops
    jax.config.update("jax_enable_preemption_service", False)
    times = dict(initialization_timeout=JOIN, heartbeat_timeout_seconds=SILENCE)
    try:
        if process == 0:  # JAX may crash without a word where the port is taken
            socket.create_server(("", int(port))).close()
        # if they do not come, JAX aborts in C++
        print(f"waiting {JOIN} s for {processes} processes at {coordinator}", file=sys.stderr)
        jax.distributed.initialize(coordinator, processes, process, **times)
    except (RuntimeError, OSError, OverflowError) as error:
        raise Refused(f"{coordinator}: the processes did not meet there: {error}") from None
    ppo.gradient = shared(ppo.gradient)


@contextmanager
def together(*meeting):
    """Meanwhile be one of several processes, if `meeting`, the arguments of `join`, says so.

    One that fails ends at once. Python's own way would wait for the others.
    """
    if meeting == (None, None, None):
        yield
        return
    join(*meeting)
    try:
        yield
    except Exception as error:
        lost = "has another process ended? " * isinstance(error, jax.errors.JaxRuntimeError)
        line = lost + " ".join(str(error).split()) if lost else complaint(error)
        print(f"train.py: {line}" if line else traceback.format_exc(), file=sys.stderr, flush=True)
        os._exit(2)


def check_same_start(*given):
    """Refuse, on all processes, if what they were given differs. What is given must suit JSON."""
    checksums = everyone(np.array([zlib.crc32(json.dumps(given).encode())]))
    if (checksums != checksums[0]).any():
        raise Refused("the processes have different flags")


def sync_stop_and_curriculum(stop_requested, weights, before):
    """Whether any process was asked to stop. All get the curriculum of all.

    weights: of this process's curriculum, and as they were `before`, at the last iteration's end
    """
    if jax.process_count() == 1:
        return stop_requested
    requests, gains = everyone((np.array([stop_requested]), (weights - before)[None]))
    before[:] = weights[:] = (before + gains.sum(0)).clip(max=1)
    return bool(requests.any())


# ---- what each has, for all ----


def everyone(tree):
    """The arrays (n, ...) of every process, one after the other, in one message."""
    if jax.process_count() == 1:
        return tree
    leaves, structure = jax.tree.flatten(tree)
    mine = np.concatenate([np.ascontiguousarray(x).reshape(-1).view(np.uint8) for x in leaves])
    rows = np.asarray(multihost_utils.process_allgather(mine))
    parts = np.split(rows, np.cumsum([x.nbytes for x in leaves])[:-1], axis=1)
    return structure.unflatten(
        np.ascontiguousarray(part).view(x.dtype).reshape(len(rows) * len(x), *x.shape[1:])
        for part, x in zip(parts, leaves, strict=True)
    )


class Shared:
    """An environment of the robots of all processes, of which this process steps its own."""

    def __init__(self, env):
        process, n = jax.process_index(), env.num_envs
        self.env = env
        self.num_envs = n * jax.process_count()
        self.mine = slice(process * n, (process + 1) * n)
        self.seen = None

    def __getattr__(self, name):
        return getattr(self.env, name)

    def reset(self, seed):
        """Start episodes, other ones on each process."""
        self.env.reset((seed, jax.process_index()))

    def observe(self):
        """As Go1Env.observe, of all robots."""
        return everyone(self.env.observe()) if self.seen is None else self.seen

    def step(self, action):
        """As Go1Env.step, of all robots."""
        result = self.env.step(action[self.mine])[1:]
        self.seen, result = everyone((self.env.observe(), result))
        return self.seen[0], *result


# ---- arrays of all processes ----


def one_of_each():
    """A mesh of one device of each process."""
    first = {device.process_index: device for device in reversed(jax.devices())}
    devices = [first[i] for i in range(jax.process_count())]
    return jax.make_mesh((len(devices),), ("process",), (AxisType.Auto,), devices=devices)


def shared(gradient):
    """`ppo.gradient` as a mean over the processes, each of which takes its part of the minibatch.

    The results go around as one message, because each message takes its time.
    """

    def call(params, data, chosen, cfg):
        def mean(params, data, chosen):
            numbers, unravel = ravel_pytree(gradient(params, data, chosen, cfg))
            return unravel(jax.lax.pmean(numbers, "process"))

        everything = PartitionSpec()
        # check_vma=True would add up gradients before `mean` sees them
        specs = dict(out_specs=everything, check_vma=False)
        specs |= dict(in_specs=(everything, everything, PartitionSpec("process")))
        return jax.shard_map(mean, mesh=one_of_each(), **specs)(params, data, chosen)

    return call


def everywhere(tree):
    """The arrays of tree as arrays that all processes hold together."""
    if jax.process_count() == 1:
        return tree

    return multihost_utils.host_local_array_to_global_array(tree, one_of_each(), PartitionSpec())
