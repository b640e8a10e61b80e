"""One compilation cache for all tests and the processes that they start."""

import os
import tempfile

os.environ["JAX_PLATFORMS"] = "cpu"
os.environ["JAX_COMPILATION_CACHE_DIR"] = os.path.join(tempfile.gettempdir(), "eipo-test-jax-cache")
os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
os.environ["JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"] = "0"
os.environ["TF_CPP_MIN_LOG_LEVEL"] = "3"  # older versions of jaxlib complain of their own cache

from runtime import jax_setup

jax_setup.plain_products()
