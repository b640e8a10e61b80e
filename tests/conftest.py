"""One compilation cache for all tests and the processes that they start, and fewer compilations."""

import inspect
import os
import re
import tempfile
from dataclasses import replace

import pytest

os.environ["JAX_PLATFORMS"] = "cpu"
os.environ["JAX_COMPILATION_CACHE_DIR"] = os.path.join(tempfile.gettempdir(), "eipo-test-jax-cache")
os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
os.environ["JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"] = "0"
os.environ["TF_CPP_MIN_LOG_LEVEL"] = "3"  # older versions of jaxlib complain of their own cache

UNREAD = dict(algo="eipo", lam=1.0, seed=0, iterations=1, lr_alpha=1.0)


@pytest.fixture(scope="module")
def one_compilation():
    """Runs that differ in fields of Config that nothing compiled reads share what JAX compiles.

    JAX would trace anew for each Config, which takes seconds.
    """
    import eipo
    import networks
    import ppo

    compiled = "".join(map(inspect.getsource, (networks, ppo, eipo.estimate)))
    assert not re.search(rf"cfg\.({'|'.join(UNREAD)})\b", compiled)

    def shared(function):
        return lambda *args: function(*args[:-1], replace(args[-1], **UNREAD))

    with pytest.MonkeyPatch.context() as patch:
        for name in ("init_learner", "estimate", "ppo_update"):
            patch.setattr(eipo, name, shared(getattr(eipo, name)))
        yield


@pytest.fixture(scope="module")
def undrawn():
    """No curves.png, which takes longer than to train a tiny run."""
    from runtime import metrics

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(metrics, "draw_curves", lambda folder: None)
        yield
