"""Actor, critic and estimator as functions of their parameters. Section IV-C.b.

params    {"actor": {"layers", "log_std"}, "critic": layers, "estimator": layers}
D, P, A   widths of an observation, of what is privileged, and of an action
K         heads of the critic (task, cost)
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.stats import norm


def init_mlp(key, sizes):
    """Layers [(W, b), ...] of an MLP, uniform in +- 1/sqrt(fan-in) [lab code: PyTorch's default]."""
    layers = []
    for k, n_in, n_out in zip(jax.random.split(key, len(sizes) - 1), sizes[:-1], sizes[1:], strict=True):
        both = jax.random.uniform(k, (n_in + 1, n_out), minval=-1, maxval=1) / np.sqrt(n_in)
        layers.append((both[:-1], both[-1]))
    return layers


def mlp(layers, x):
    """x: (..., n_in) -> (..., n_out), ELU between the layers. The tests forbid implicit broadcasting of ranks."""
    *hidden, (w_out, b_out) = layers
    for w, b in hidden:
        x = jax.nn.elu(x @ w + jnp.broadcast_to(b, (*x.shape[:-1], *b.shape)))
    return x @ w_out + jnp.broadcast_to(b_out, (*x.shape[:-1], *b_out.shape))


def policy(params, obs):
    """Mean and standard deviation (..., A) of the action, and the estimate (..., P) of what is privileged.

    obs: (..., D). The estimate is an input of the actor, but learns from its own error alone (D19).
    """
    estimate = mlp(params["estimator"], obs)
    mean = mlp(params["actor"]["layers"], jnp.concatenate([obs, jax.lax.stop_gradient(estimate)], -1))
    return mean, jnp.broadcast_to(jnp.exp(params["actor"]["log_std"]), mean.shape), estimate


@jax.jit
def value(params, obs, privileged):
    """The critic: (..., K) values of obs (..., D), privileged (..., P)."""
    return mlp(params["critic"], jnp.concatenate([obs, privileged], -1))


def log_prob(mean, std, action):
    """Log-density (...,) of action (..., A) under independent normals."""
    return norm.logpdf(action, mean, std).sum(-1)
