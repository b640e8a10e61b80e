"""Actor, critic and estimator (Section IV-C.b): MLPs as functions of their parameters.

params    {"actor", "critic", "estimator": [Layer, ...], "log_std": of the action's noise}
D, P, A   widths of an observation, of what is privileged (the true body velocity) and of an action
K         outputs, or heads, of the critic: the value of the task and, for pi, that of the cost

A left-right mirror may tie the weights (D28). Then an array holds even entries, which the mirror
keeps, such as (right + left) / sqrt 2, and after them odd ones, which it negates, such as (right -
left) / sqrt 2. A layer that treats left and right alike takes even entries to even ones and odd to
odd, so it has a matrix for each kind, and a size is a pair of numbers. Without a mirror there is
one matrix, and a size is a number. `mirror.py` makes such arrays, and has the reasons.
"""

from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.stats import norm


class Layer(NamedTuple):
    """A linear layer. Right and left units share a bias, so the odd entries have none."""

    weights: tuple  # of one matrix (n, m), or of two, for even and for odd entries
    bias: jax.Array  # (m,) that is added to the outputs of the first matrix


def mlp(layers, x):
    """Outputs (..., m) of an MLP for inputs (..., n), with ELU between the layers."""
    num_even = [len(matrix) for matrix in layers[0].weights[:-1]]  # [] without a mirror
    parts = jnp.split(x, num_even, -1)  # even and odd entries, or all of them
    for i, layer in enumerate(layers):
        if i:
            # ELU is not linear: it needs the right and left units, not their sums and differences
            parts = sum_and_difference([jax.nn.elu(part) for part in sum_and_difference(parts)])
        parts = [part @ matrix for part, matrix in zip(parts, layer.weights, strict=True)]
        parts[0] += layer.bias
    return jnp.concatenate(parts, -1)


def sum_and_difference(parts):
    """[right, left] units from [even, odd], or back, as this is its own inverse."""
    if len(parts) == 1:
        return parts
    first, second = parts
    return [(first + second) / np.sqrt(2), (first - second) / np.sqrt(2)]


def policy(params, obs):
    """Mean and standard deviation (..., A) of the action for obs (..., D), and estimate (..., P).

    The estimate is of what is privileged, the true velocity of the body. The actor sees it, but the
    estimator learns from its own error alone (D19).
    """
    estimate = mlp(params["estimator"], obs)
    mean = mlp(params["actor"], join(params, obs, jax.lax.stop_gradient(estimate)))
    # every entry has a partner, so as many are even as are odd; a pair shares one, which makes the
    # noise of right and left independent
    std = jnp.exp(jnp.tile(params["log_std"], len(params["actor"][-1].weights)))
    return mean, jnp.broadcast_to(std, mean.shape), estimate


def value(params, obs, privileged):
    """The critic's values (..., K) of obs (..., D) with privileged (..., P)."""
    return mlp(params["critic"], join(params, obs, privileged))


def join(params, obs, privileged):
    """obs and what is privileged, or its estimate, as one (..., D + P), even entries first.

    obs begins with its own even entries, so that what is privileged and even goes before it.
    """
    even = params["estimator"][-1].weights[0].shape[1]  # how many are: the estimator's outputs
    return jnp.concatenate([privileged[..., :even], obs, privileged[..., even:]], -1)


def sample(params, obs, key):
    """Random actions (N, A) of the policy for obs (N, D), and their log-probabilities (N,)."""
    mean, std, _ = policy(params, obs)
    action = mean + std * jax.random.normal(key, mean.shape)
    return action, log_prob(mean, std, action)


def log_prob(mean, std, action):
    """Log-density (...,) of action (..., A) under independent normals."""
    return norm.logpdf(action, mean, std).sum(-1)


def init_params(rng, env, heads, cfg):
    """Random parameters, drawn by NumPy, because JAX would take seconds to compile that many draws.

    rng:   np.random.Generator
    env:   only its obs_size, privileged_size and action_size are used
    heads: K
    cfg:   ppo.PPOConfig, with the widths of the hidden layers
    """
    sizes = env.obs_size, env.privileged_size, env.action_size
    # arrays with one number, or with those of even and odd entries, which `+` adds each to its own
    n_obs, n_privileged, n_action = map(np.atleast_1d, sizes)
    kinds = len(n_obs)
    n_state, n_values = n_obs + n_privileged, [heads, 0][:kinds]  # nothing of a value is odd
    hidden, hidden_estimator = (
        [[n // kinds] * kinds for n in widths] for widths in (cfg.hidden, cfg.hidden_estimator)
    )
    return dict(
        actor=init_mlp(rng, [n_state, *hidden, n_action]),
        critic=init_mlp(rng, [n_state, *hidden, n_values]),
        estimator=init_mlp(rng, [n_obs, *hidden_estimator, n_privileged]),
        log_std=np.full(n_action[0], cfg.log_std, np.float32),
    )


def init_mlp(rng, sizes):
    """Random layers of an MLP, within +- 1 / sqrt(fan-in) as in PyTorch [lab code].

    sizes: of each layer, from the input on, a list with one number, or with those of even and of
        odd entries. Even units have only even inputs, so each matrix has its own fan-in.
    """

    def uniform(fan_in, *shape):
        scale = np.sqrt(max(fan_in, 1))  # an environment may have no odd inputs
        return (rng.uniform(-1, 1, shape) / scale).astype(np.float32)

    layers = []
    for ins, outs in pairwise(sizes):
        weights = tuple(uniform(n, n, m) for n, m in zip(ins, outs, strict=True))
        layers.append(Layer(weights, uniform(ins[0], outs[0])))
    return layers
