"""Actor, critic and estimator (Section IV-C.b) as functions of their parameters, tied by the
robot's mirror symmetry (D28).

The mirror M of a Go1 swaps its right and left legs and changes the sign of what points sideways.
Robot and tasks are symmetric, but for 2 mm in the trunk's centre of mass, and so is Eq. (9) with
the power clip (D3). So a policy loses nothing by pi(M s) = M pi(s). An MLP obeys this if its hidden
units are pairs (right, left) that M swaps. In each pair, even = (right + left) / sqrt 2 is the same
after M, and odd = (right - left) / sqrt 2 changes its sign. A linear layer then maps even
coordinates to even ones and odd to odd ones. Its two products have half the width and half the
height of the dense layer's, so half the weights and arithmetic.

Observations, actions and privileged states are plain outside of this file. A network turns its
input into even and odd coordinates by itself, and its output back. A plain MLP (--no-mirror) is the
same network without a mirror, in which all coordinates are even.

params    {"actor": {"layers", "log_std"}, "critic": layers, "estimator": layers, "mirror": Mirror};
          layers are [Layer, ...]; without a "mirror" the networks are plain MLPs
D, P, A   widths of an observation, of the privileged part of a state and of an action
K         outputs, or heads, of the critic: the value of the task and, for pi, that of the cost
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import block_diag
from jax.scipy.stats import norm


@jax.tree_util.register_static
@dataclass(frozen=True)
class Mirror:
    """The mirror M, which is its own inverse, in three spaces; not learned.

    Each field is a pair (index, sign) of tuples of int: (M x)[i] = sign[i] x[index[i]].
    """

    obs: tuple
    privileged: tuple
    action: tuple


class Pairs(NamedTuple):
    """How an array of n entries and its even and odd coordinates are made of each other."""

    even: np.ndarray  # which entries stand for an even coordinate, and
    odd: np.ndarray  # for an odd one; of two entries that M swaps, the first stands for both
    weight: np.ndarray  # (n,) of each entry in its coordinates
    pair: np.ndarray  # (n,) the number of the pair that each entry is in


class Layer(NamedTuple):
    """A linear layer. Only even outputs have a bias, because right and left units share one."""

    even: jax.Array  # (even in, even out)
    odd: jax.Array  # (odd in, odd out)
    bias: jax.Array  # (even out,)


# ---- even and odd coordinates ----


@lru_cache
def pairs(mirror):
    """The Pairs of a mirror (index, sign).

    An entry that M maps onto itself is an even coordinate if it keeps its sign, and an odd one if
    not.
    """
    index, sign = map(np.array, mirror)
    here = np.arange(len(index))
    fixed = index == here
    first = index >= here
    even = np.flatnonzero(first & ~(fixed & (sign < 0)))
    odd = np.flatnonzero(first & ~(fixed & (sign > 0)))
    weight = np.where(fixed, 0.5, np.sqrt(0.5)).astype(np.float32)
    pair = (np.cumsum(first) - 1)[np.minimum(here, index)]
    return Pairs(even, odd, weight, pair)


def reflect(x, mirror):
    """M x, for x (..., n); mirror: (index, sign)."""
    index, sign = mirror
    return np.array(sign, np.float32) * x[..., np.array(index)]


def even_odd(x, mirror):
    """The even and the odd coordinates of x (..., n): (x + M x) / sqrt 2 and (x - M x) / sqrt 2.

    An entry that M maps onto itself, or onto its negative, is its own coordinate.

    mirror: (index, sign), or None: then all coordinates are even
    """
    if mirror is None:
        return x, x[..., :0]
    even, odd, weight, _ = pairs(mirror)
    image = reflect(x, mirror)
    return (weight * (x + image))[..., even], (weight * (x - image))[..., odd]


def joined(even, odd, mirror):
    """The x (..., n) that has these even and odd coordinates: the inverse of `even_odd`."""
    if mirror is None:
        return even
    firsts = []
    for part, where in ((even, pairs(mirror).even), (odd, pairs(mirror).odd)):
        column = np.full(len(mirror[0]), len(where))  # a column of zeros, where nothing stands
        column[where] = np.arange(len(where))
        zero = jnp.zeros((*part.shape[:-1], 1), part.dtype)
        firsts.append(jnp.concatenate([part, zero], -1)[..., column])
    weight = pairs(mirror).weight
    return weight * (firsts[0] + firsts[1]) + reflect(weight * (firsts[0] - firsts[1]), mirror)


def widths(size, mirror):
    """How many of `size` coordinates are even, and how many are odd."""
    return (size, 0) if mirror is None else (len(pairs(mirror).even), len(pairs(mirror).odd))


# ---- networks ----


def init_params(key, sizes, mirror, heads, cfg):
    """Random parameters of actor, critic and estimator.

    sizes:  (D, P, A); mirror: a Mirror, or None for plain MLPs
    heads:  K; cfg: eipo.Config, with the widths of the hidden layers
    """
    spaces = (mirror.obs, mirror.privileged, mirror.action) if mirror else (None,) * 3
    obs, privileged, action = map(widths, sizes, spaces)
    both = obs[0] + privileged[0], obs[1] + privileged[1]

    def layers(units):
        return [(n // 2, n // 2) if mirror else (n, 0) for n in units]

    hidden = layers(cfg.hidden)
    deviations = 1 + max(pairs(mirror.action).pair) if mirror else sizes[2]  # one for each pair
    k_actor, k_critic, k_estimator = jax.random.split(key, 3)
    params = dict(
        actor=dict(
            layers=init_mlp(k_actor, (both, *hidden, action)),
            log_std=jnp.full(deviations, cfg.log_std, jnp.float32),
        ),
        critic=init_mlp(k_critic, (both, *hidden, (heads, 0))),
        estimator=init_mlp(k_estimator, (obs, *layers(cfg.hidden_estimator), privileged)),
    )
    return params | (dict(mirror=mirror) if mirror else {})


def init_mlp(key, sizes):
    """Random layers of an MLP, within +- 1/sqrt(fan-in) as in PyTorch [lab code].

    sizes: [(even, odd), ...]
    """

    def uniform(key, fan_in, *shape):
        return jax.random.uniform(key, shape, minval=-1, maxval=1) / np.sqrt(max(fan_in, 1))

    layers = []
    keys = jax.random.split(key, len(sizes) - 1)
    for k, ((even_in, odd_in), (even, odd)) in zip(keys, pairwise(sizes), strict=True):
        k_even, k_odd, k_bias = jax.random.split(k, 3)
        layer = Layer(
            even=uniform(k_even, even_in, even_in, even),
            odd=uniform(k_odd, odd_in, odd_in, odd),
            bias=uniform(k_bias, even_in, even),
        )
        layers.append(layer)
    return layers


def elu(even, odd):
    """ELU of hidden units with even (..., n) and odd (..., n) coordinates.

    It acts on the right and left units themselves.
    """
    if odd.shape[-1] == 0:
        return jax.nn.elu(even), odd
    right, left = jax.nn.elu((even + odd) / np.sqrt(2)), jax.nn.elu((even - odd) / np.sqrt(2))
    return (right + left) / np.sqrt(2), (right - left) / np.sqrt(2)


def mlp(layers, even, odd):
    """Even and odd outputs for even (..., n) and odd (..., m) inputs, ELU between the layers."""
    *hidden, last = layers
    for layer in hidden:
        even, odd = elu(even @ layer.even + layer.bias, odd @ layer.odd)
    return even @ last.even + last.bias, odd @ last.odd


def mirror_of(params, space):
    """The mirror of a space, "obs", "privileged" or "action", or None of plain MLPs."""
    return getattr(params.get("mirror"), space, None)


def policy(params, obs):
    """Mean and deviation (..., A) of the action for obs (..., D), and estimated velocity (..., P).

    The actor sees the estimate, but the estimator learns from its own error alone.
    """
    obs = even_odd(obs, mirror_of(params, "obs"))
    velocity = mlp(params["estimator"], *obs)
    blind = jax.lax.stop_gradient(velocity)
    seen = [jnp.concatenate(parts, -1) for parts in zip(obs, blind, strict=True)]
    mirror = mirror_of(params, "action")
    mean = joined(*mlp(params["actor"]["layers"], *seen), mirror)
    std = jnp.exp(params["actor"]["log_std"])
    std = std if mirror is None else std[pairs(mirror).pair]  # right and left are equally noisy
    velocity = joined(*velocity, mirror_of(params, "privileged"))
    return mean, jnp.broadcast_to(std, mean.shape), velocity


def sample(params, obs, key):
    """Random actions (N, A) of the policy for obs (N, D)."""
    mean, std, _ = policy(params, obs)
    noise = jax.random.normal(key, mean.shape)
    mirror = mirror_of(params, "action")
    even, odd = jnp.split(noise, [widths(mean.shape[-1], mirror)[0]], -1)
    return mean + std * joined(even, odd, mirror)  # which is normal as well: `joined` is orthogonal


@jax.jit
def value(params, obs, privileged):
    """The critic's values (..., K) of obs (..., D) with privileged (..., P).

    A mirrored state has the same value.
    """
    obs = even_odd(obs, mirror_of(params, "obs"))
    privileged = even_odd(privileged, mirror_of(params, "privileged"))
    seen = (jnp.concatenate(parts, -1) for parts in zip(obs, privileged, strict=True))
    return mlp(params["critic"], *seen)[0]


def log_prob(mean, std, action):
    """Log-density (...,) of action (..., A) under independent normals."""
    return norm.logpdf(action, mean, std).sum(-1)


# ---- the same policy as plain MLPs ----


def dense(params):
    """params as plain MLPs without a mirror, as `policy.npz` has them; no critic."""
    actor, estimator = params["actor"], params["estimator"]
    if "mirror" not in params:
        return dict(actor=actor, estimator=estimator)
    m = params["mirror"]
    n = len(m.obs[0])
    both = (*m.obs[0], *(n + i for i in m.privileged[0])), m.obs[1] + m.privileged[1]
    layers = dense_layers(actor["layers"], both, m.action)
    return dict(
        actor=dict(layers=layers, log_std=np.asarray(actor["log_std"])[pairs(m.action).pair]),
        estimator=dense_layers(estimator, m.obs, m.privileged),
    )


def dense_layers(layers, seen, answered):
    """Layers of the plain MLP that equals a mirrored one, with right and left hidden units.

    seen, answered: the mirrors, (index, sign), of its input and of its output
    """

    def basis(mirror):  # x @ basis are the even, then the odd coordinates of x
        return np.hstack(even_odd(np.eye(len(mirror[0]), dtype=np.float32), mirror))

    plain = []
    entry = basis(seen)
    for i, layer in enumerate(layers):
        n = layer.odd.shape[1]
        swap = (*range(n, 2 * n), *range(n)), (1,) * (2 * n)
        exit = basis(answered if i + 1 == len(layers) else swap)
        weights = entry @ np.asarray(block_diag(layer.even, layer.odd)) @ exit.T
        bias = exit[:, : len(layer.bias)] @ layer.bias
        plain.append(Layer(weights, np.zeros((0, 0), np.float32), bias))
        entry = exit
    return plain
