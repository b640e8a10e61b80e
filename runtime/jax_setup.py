"""What JAX computes with, and on what the last digits of a run depend."""

import os
import platform
import re
from importlib.metadata import version
from pathlib import Path

import jax

from go1_env import CORES
from runtime.cli import Refused

THREADS = "PJRT_NPROC"  # environment variable with the number of JAX's threads on a CPU

YNN_OFF = "--xla_cpu_experimental_ynn_fusion_type="
# in the names of JAX's settings on which no digit depends; of devices `device` tells
SILENT = re.compile("cache|log|debug|dump|trac|profil|pgle|check|error|platform|device|host")
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


def set_threads(began_with):
    """Give JAX as many threads as when the run began, or one for each core if it begins now (None).

    JAX reads the number once, before it computes anything, and last digits depend on it. What the
    user has set wins.
    """
    threads = os.environ.setdefault(THREADS, began_with or str(CORES))
    if not (threads.isascii() and threads.isdigit() and int(threads)):  # JAX would pass over it
        raise Refused(f"{THREADS} is {threads}: it must be a number of threads")


def configuration():
    """All of JAX's settings on which digits may depend: {name: text}. None is a path."""
    texts = {name: str(x) for name, x in jax.config.values.items() if not SILENT.search(name)}
    return {name: x for name, x in texts.items() if os.sep not in x}


def numerics():
    """What the last digits of a run depend on, for config.json: {name: text}.

    Of JAX's settings these are two, and those that the environment sets: JAX does not say which
    are its defaults. A checkpoint keeps all of them.
    """
    names = "jax_enable_x64", "jax_default_matmul_precision"
    settings = configuration()
    settings = {x: settings[x] for x in settings if x in names or x.upper() in os.environ}
    settings |= {x: version(x) for x in ("jax", "jaxlib", "mujoco", "numpy", "optax", "scipy")}
    flags = " ".join(x for x in os.environ.get("XLA_FLAGS", "").split() if os.sep not in x)
    settings |= dict(cpu=cpu_model(), device=device(), threads=os.environ.get(THREADS))
    return settings | dict(xla_flags=flags)


def cpu_model():
    """The name of this machine's processor, as the system gives it."""
    linux = Path("/proc/cpuinfo")
    names = re.findall(r"model name\s*: (.*)", linux.read_text()) if linux.exists() else []
    return names[0] if names else platform.processor()


def device():
    """The name of what JAX computes on: "cpu", or that of a GPU. It refuses if there is none."""
    try:
        return jax.devices()[0].device_kind
    except (AssertionError, RuntimeError) as error:
        asked = os.environ.get("JAX_PLATFORMS")
        raise Refused(f"JAX finds no device, and JAX_PLATFORMS is {asked}. {error}") from None
