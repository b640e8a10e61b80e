"""XLA takes no products from a library that was seen to get them wrong (runtime/jax_setup.py)."""

import jax
import numpy as np
from support import EIPO

import eipo
import ppo
from go1_env import Go1Env
from mirror import Mirrored


def test_products_are_not_ynnpack_s():
    """In an update of a policy, as XLA compiles it for this processor."""
    rng = np.random.default_rng(0)
    draw = lambda *shape: rng.normal(size=shape).astype(np.float32)  # noqa: E731
    env = Mirrored(Go1Env(1))
    pi = ppo.init_learner(rng, env, ("reward", "cost"), EIPO.ppo_cfg)
    widths = dict(obs=sum(env.obs_size), privileged=3, action=12)
    arrays = {name: draw(8, 16, n) for name, n in widths.items()} | dict(log_prob=draw(8, 16))
    tau = eipo.Transition(**dict.fromkeys(eipo.Transition._fields) | arrays)
    key = jax.random.PRNGKey(0)
    lowered = ppo.ppo_update.lower(pi, tau, draw(8, 16, 2), draw(8, 16), key, EIPO.ppo_cfg)
    text = lowered.compile().as_text()
    assert "dot(" in text and "__ynn_fusion" not in text
