"""Actor, critic and estimator (Section IV-C.b): MLPs as functions of their parameters.

Between the layers an array is a list of halves, as `mirror.py` explains (D28): two where the
robot's mirror ties the weights, one in a plain MLP.

params    {"actor", "critic", "estimator": [Layer, ...], "log_std": (pairs of action entries,)}
bases     mirror.Bases, which turn observations and actions into halves and back
D, P, A   widths of an observation, of the privileged part of a state and of an action
K         outputs, or heads, of the critic: the value of the task and, for pi, that of the cost
"""

from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.stats import norm

from mirror import (
    dense,
    join,
    row_of_frames,
    side_by_side,
    split,
    split_frames,
    sum_and_difference,
)


class Layer(NamedTuple):
    """A linear layer. Right and left units share a bias, so it has no odd half."""

    weights: tuple  # one matrix (n, m) per half
    bias: jax.Array  # (m,) of the even half, or of the only one


def mlp(layers, halves):
    """Outputs of an MLP, with ELU between the layers."""
    for i, layer in enumerate(layers):
        if i:  # ELU acts on the right and left units themselves
            halves = sum_and_difference([jax.nn.elu(x) for x in sum_and_difference(halves)])
        halves = [x @ weights for x, weights in zip(halves, layer.weights, strict=True)]
        halves[0] += layer.bias
    return halves


def policy(params, obs, bases):
    """Mean and deviation (..., A) of the action for obs (..., D), and estimated velocity (..., P).

    The actor sees the estimate, but the estimator learns from its own error alone (D19).
    """
    frames = split_frames(obs, bases.frame)
    velocity = mlp(params["estimator"], frames)
    detached = [jax.lax.stop_gradient(half) for half in velocity]
    inputs = [jnp.concatenate(parts, -1) for parts in zip(frames, detached, strict=True)]
    mean = join(mlp(params["actor"], inputs), bases.action)
    std = jnp.exp(params["log_std"])[bases.pair]  # right and left are equally noisy
    return mean, jnp.broadcast_to(std, mean.shape), join(velocity, bases.privileged)


def value(params, obs, privileged, bases):
    """The critic's values (..., K) of obs (..., D) with privileged (..., P).

    A mirrored state has the same values, so they are the even half.
    """
    seen = split_frames(obs, bases.frame), split(privileged, bases.privileged)
    return mlp(params["critic"], [jnp.concatenate(x, -1) for x in zip(*seen, strict=True)])[0]


def sample(params, obs, key, bases):
    """Random actions (N, A) of the policy for obs (N, D), and their log-probabilities (N,)."""
    mean, std, _ = policy(params, obs, bases)
    action = mean + std * jax.random.normal(key, mean.shape)
    return action, log_prob(mean, std, action)


def log_prob(mean, std, action):
    """Log-density (...,) of action (..., A) under independent normals."""
    return norm.logpdf(action, mean, std).sum(-1)


def init_params(rng, obs_size, heads, bases, cfg):
    """Random parameters, drawn by NumPy, because JAX would take seconds to compile as many draws.

    rng: np.random.Generator; heads: K; cfg: ppo.PPOConfig, with the widths of the hidden layers
    """
    history = obs_size // len(bases.frame[0])
    num_halves = len(bases.frame)
    obs_widths = [history * half.shape[1] for half in bases.frame]
    velocity_widths = [half.shape[1] for half in bases.privileged]
    action_widths = [half.shape[1] for half in bases.action]
    state_widths = [n + m for n, m in zip(obs_widths, velocity_widths, strict=True)]
    value_widths = [heads, 0][:num_halves]  # a mirrored state has the same value: no odd half

    def mlp_widths(inputs, hidden, outputs):
        return [inputs, *([n // num_halves] * num_halves for n in hidden), outputs]

    return dict(
        actor=init_mlp(rng, mlp_widths(state_widths, cfg.hidden, action_widths)),
        critic=init_mlp(rng, mlp_widths(state_widths, cfg.hidden, value_widths)),
        estimator=init_mlp(rng, mlp_widths(obs_widths, cfg.hidden_estimator, velocity_widths)),
        log_std=np.full(bases.pair.max() + 1, cfg.log_std, np.float32),
    )


def init_mlp(rng, widths):
    """Random layers of an MLP, within +- 1 / sqrt(fan-in) as in PyTorch [lab code].

    A half has its own fan-in, as its products have no other inputs.

    widths: of each layer, from the input on, a list with one number for each half
    """

    def uniform(fan_in, *shape):
        scale = np.sqrt(max(fan_in, 1))  # an odd half may be empty
        return (rng.uniform(-1, 1, shape) / scale).astype(np.float32)

    layers = []
    for ins, outs in pairwise(widths):
        weights = tuple(uniform(n, n, m) for n, m in zip(ins, outs, strict=True))
        layers.append(Layer(weights, uniform(ins[0], outs[0])))
    return layers


def plain_policy(params, bases):
    """The same policy as plain MLPs: layers [(W (n, m), b (m,)), ...] of both, and log_std (A,)."""
    obs_size = sum(len(weights) for weights in params["estimator"][0].weights)
    obs = row_of_frames(bases.frame, obs_size // len(bases.frame[0]))
    return dict(
        actor=dense(params["actor"], side_by_side(obs, bases.privileged), bases.action),
        estimator=dense(params["estimator"], obs, bases.privileged),
        log_std=np.asarray(params["log_std"])[bases.pair],
    )
