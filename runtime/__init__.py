"""What a run needs and the paper does not mention.

flags.py        the flags of `train.py`, and with which settings one can train
run_folder.py   what a run leaves on disk; deploy.py: policy.npz, written and tried
metrics.py      the numbers of a run, its line on the console, its pictures
interrupt.py    how a run ends when it is told to
parallel.py     how several processes share it
"""

import os
import re
from importlib.metadata import version

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


plain_products()
