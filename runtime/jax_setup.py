"""What JAX computes with, and on what the last digits of a run depend."""

import os
import re
import sys
from importlib.metadata import version

import jax

from go1_env import CORES
from runtime.command import Refused

THREADS = "PJRT_NPROC"  # environment variable with the number of JAX's threads on a CPU

YNN_OFF = "--xla_cpu_experimental_ynn_fusion_type="
# first and last version of jaxlib on which this flag was tried; XLA stops at one it does not know
YNN_KNOWN = (0, 10, 1), (0, 12, 0)


def plain_products():
    """Let XLA compute matrix products on CPUs by itself, from its first computation on.

    From jaxlib 0.10.1 it hands them to the library YNNPACK, with which others saw crashes, wrong
    gradients and other bits from one call to the next (jax issues 39103, 39257 and 39741). Here
    they are no slower without it.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    jaxlib = tuple(map(int, re.findall(r"\d+", version("jaxlib"))[:3]))
    if YNN_KNOWN[0] <= jaxlib <= YNN_KNOWN[1] and "ynn_fusion_type" not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {YNN_OFF}"


def surroundings():
    """Versions and settings on which the last digits of a run depend, by name, as text."""
    found = {package: version(package) for package in ("jax", "jaxlib", "numpy", "mujoco")}
    settings = "jax_enable_x64", "jax_default_prng_impl", "jax_threefry_partitionable"
    found |= {name: str(getattr(jax.config, name)) for name in settings}
    return found | {THREADS: os.environ.get(THREADS, "unset")}


def restore(began_with):
    """Give JAX as many threads as when the run began, and say what else is not as it was then.

    began_with: `surroundings` of then, or {} for a new run. JAX reads the number of threads once,
    before it computes anything, and last digits depend on it.
    """
    os.environ.setdefault(THREADS, began_with.get(THREADS, str(CORES)))
    now = surroundings()
    changed = [f"{x} was {was} and is {now[x]}" for x, was in began_with.items() if now[x] != was]
    if changed:
        print(f"train.py: last digits will differ: {', '.join(changed)}", file=sys.stderr)


def find_device():
    """Refuse if JAX has nothing to compute on, before anything is written."""
    try:
        jax.devices()
    except (AssertionError, RuntimeError) as error:
        asked = os.environ.get("JAX_PLATFORMS")
        raise Refused(f"JAX finds no device, and JAX_PLATFORMS is {asked}. {error}") from None
