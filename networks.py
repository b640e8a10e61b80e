"""Actor, critic and estimator (Section IV-C.b) as functions of their parameters, tied by the robot's mirror (D28).

The mirror M of a Go1 swaps its right and left legs and changes the sign of what points sideways. Robot and tasks are
symmetric, but for 2 mm in the trunk's centre of mass, and so is Eq. (9) with the power clip (D3). So a policy loses
nothing by pi(M s) = M pi(s). An MLP obeys this if its hidden units are pairs (right, left) that M swaps. In each pair,
even = (right + left) / sqrt 2 is the same after M, and odd = (right - left) / sqrt 2 changes its sign. A linear layer
then maps even coordinates to even ones and odd to odd ones. Its two products have half the width and half the height
of the dense layer's, so half the weights and arithmetic. In a plain MLP (--no-mirror) all coordinates are even.

params    {"actor": {"layers", "log_std"}, "critic": layers, "estimator": layers}; layers are [Layer, ...]
D, P, A   widths of an observation, of the privileged part of a state and of an action: even coordinates, then odd ones
K         outputs, or heads, of the critic: the value of the task and, for pi, the value of the cost
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.stats import norm


class Layer(NamedTuple):
    """A linear layer. Only even outputs have a bias, because right and left units share one."""

    even: jax.Array  # (even in, even out)
    odd: jax.Array  # (odd in, odd out)
    bias: jax.Array  # (even out,)


def init_mlp(key, sizes):
    """Random layers of an MLP, within +- 1/sqrt(fan-in) as in PyTorch [lab code]; sizes: [(even, odd), ...]."""

    def uniform(key, fan_in, *shape):
        return jax.random.uniform(key, shape, minval=-1, maxval=1) / np.sqrt(max(fan_in, 1))

    layers = []
    for k, (even_in, odd_in), (even, odd) in zip(jax.random.split(key, len(sizes) - 1), sizes, sizes[1:], strict=False):
        k_even, k_odd, k_bias = jax.random.split(k, 3)
        weights = uniform(k_even, even_in, even_in, even), uniform(k_odd, odd_in, odd_in, odd)
        layers.append(Layer(*weights, uniform(k_bias, even_in, even)))
    return layers


def elu(even, odd):
    """ELU of hidden units whose coordinates are even (..., n) and odd (..., n). It acts on the right and left units."""
    if odd.shape[-1] == 0:
        return jax.nn.elu(even), odd
    right, left = jax.nn.elu((even + odd) / np.sqrt(2)), jax.nn.elu((even - odd) / np.sqrt(2))
    return (right + left) / np.sqrt(2), (right - left) / np.sqrt(2)


def mlp(layers, even, odd):
    """Even and odd outputs for even (..., n) and odd (..., m) inputs, with ELU between the layers."""
    *hidden, last = layers
    for layer in hidden:
        even, odd = elu(even @ layer.even + layer.bias, odd @ layer.odd)
    return even @ last.even + last.bias, odd @ last.odd


def policy(params, obs):
    """Mean and standard deviation (..., A) of the action for obs (..., D), and the estimated body velocity (..., P).

    The actor sees the estimate, but the estimator learns from its own error alone (D19).
    """
    obs = jnp.split(obs, [len(params["estimator"][0].even)], -1)
    estimate = mlp(params["estimator"], *obs)
    seen = [jnp.concatenate(pair, -1) for pair in zip(obs, jax.lax.stop_gradient(estimate), strict=True)]
    mean = jnp.concatenate(mlp(params["actor"]["layers"], *seen), -1)
    std = jnp.exp(params["actor"]["log_std"])
    std = jnp.concatenate([std, std[: mean.shape[-1] - len(std)]])  # right and left are equally noisy
    return mean, jnp.broadcast_to(std, mean.shape), jnp.concatenate(estimate, -1)


@jax.jit
def value(params, obs, privileged):
    """The critic's values (..., K) of obs (..., D) with privileged (..., P). A mirrored state has the same value."""
    obs = jnp.split(obs, [len(params["estimator"][0].even)], -1)
    privileged = jnp.split(privileged, [len(params["estimator"][-1].bias)], -1)
    return mlp(params["critic"], *(jnp.concatenate(pair, -1) for pair in zip(obs, privileged, strict=True)))[0]


def log_prob(mean, std, action):
    """Log-density (...,) of action (..., A) under independent normals."""
    return norm.logpdf(action, mean, std).sum(-1)
