"""Actor, critic and estimator (Section IV-C.b): MLPs as functions of their parameters.

params    {"actor", "critic", "estimator": [Layer, ...], "log_std": of the action's noise}
D, P, A   widths of an observation, of the privileged part of a state and of an action
K         outputs, or heads, of the critic: the value of the task and, for pi, that of the cost

Where the robot's mirror ties the weights, arrays have their even entries first, as `mirror.py`
explains (D28). A layer then has a matrix for those and another for the odd ones, and a size, which
otherwise is a number, is a pair.
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
    bias: jax.Array  # (m,) of the first


def mlp(layers, x):
    """Outputs (..., m) of an MLP for inputs (..., n), with ELU between the layers."""
    halves = jnp.split(x, [len(weights) for weights in layers[0].weights[:-1]], -1)
    for i, layer in enumerate(layers):
        if i:  # ELU acts on the right and left units themselves
            halves = sum_and_difference([jax.nn.elu(x) for x in sum_and_difference(halves)])
        halves = [x @ weights for x, weights in zip(halves, layer.weights, strict=True)]
        halves[0] += layer.bias
    return jnp.concatenate(halves, -1)


def sum_and_difference(halves):
    """[right, left] units from [even, odd], or back, as this is its own inverse."""
    if len(halves) == 1:
        return halves
    first, second = halves
    return [(first + second) / np.sqrt(2), (first - second) / np.sqrt(2)]


def policy(params, obs):
    """Mean and deviation (..., A) of the action for obs (..., D), and estimated velocity (..., P).

    The actor sees the estimate, but the estimator learns from its own error alone (D19).
    """
    velocity = mlp(params["estimator"], obs)
    mean = mlp(params["actor"], beside(params, obs, jax.lax.stop_gradient(velocity)))
    std = jnp.exp(jnp.tile(params["log_std"], len(params["actor"][-1].weights)))
    return mean, jnp.broadcast_to(std, mean.shape), velocity


def value(params, obs, privileged):
    """The critic's values (..., K) of obs (..., D) with privileged (..., P)."""
    return mlp(params["critic"], beside(params, obs, privileged))


def beside(params, obs, velocity):
    """obs and velocity as one array (..., D + P), of which the even entries still come first."""
    even = params["estimator"][-1].weights[0].shape[1]
    return jnp.concatenate([velocity[..., :even], obs, velocity[..., even:]], -1)


def sample(params, obs, key):
    """Random actions (N, A) of the policy for obs (N, D), and their log-probabilities (N,)."""
    mean, std, _ = policy(params, obs)
    action = mean + std * jax.random.normal(key, mean.shape)
    return action, log_prob(mean, std, action)


def log_prob(mean, std, action):
    """Log-density (...,) of action (..., A) under independent normals."""
    return norm.logpdf(action, mean, std).sum(-1)


def init_params(rng, env, heads, cfg):
    """Random parameters, drawn by NumPy, because JAX would take seconds to compile as many draws.

    rng:   np.random.Generator
    env:   its obs_size, privileged_size and action_size count
    heads: K
    cfg:   ppo.PPOConfig, with the widths of the hidden layers
    """
    sizes = env.obs_size, env.privileged_size, env.action_size
    obs, privileged, action = map(np.atleast_1d, sizes)
    values = [heads, 0][: len(obs)]  # a mirrored state has the same value: nothing is odd

    def init(inputs, hidden, outputs):
        return init_mlp(rng, [inputs, *([n // len(obs)] * len(obs) for n in hidden), outputs])

    return dict(
        actor=init(obs + privileged, cfg.hidden, action),
        critic=init(obs + privileged, cfg.hidden, values),
        estimator=init(obs, cfg.hidden_estimator, privileged),
        log_std=np.full(action[0], cfg.log_std, np.float32),  # right and left are equally noisy
    )


def init_mlp(rng, widths):
    """Random layers of an MLP, within +- 1 / sqrt(fan-in) as in PyTorch [lab code].

    widths: of each layer, from the input on, a list with one number, or with those of even and of
        odd entries. Each has its own fan-in, as its products have no other inputs.
    """

    def uniform(fan_in, *shape):
        scale = np.sqrt(max(fan_in, 1))  # there may be no odd entries
        return (rng.uniform(-1, 1, shape) / scale).astype(np.float32)

    layers = []
    for ins, outs in pairwise(widths):
        weights = tuple(uniform(n, n, m) for n, m in zip(ins, outs, strict=True))
        layers.append(Layer(weights, uniform(ins[0], outs[0])))
    return layers
