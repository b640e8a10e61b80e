"""Actor, critic and estimator as functions of their parameters (Section IV-C.b), with a left and a right (D28).

A Go1 has a left and a right. Its mirror M swaps the legs and turns the sign of what points sideways. Robot, tasks and
Eq. (9) stay the same under M, so a policy may obey pi(M s) = M pi(s). An MLP does, if M swaps its hidden units in pairs
(right, left). Then even = (right + left) / sqrt 2 stays the same under M, odd = (right - left) / sqrt 2 changes its
sign, and every linear layer falls apart into a product of the even coordinates and a product of the odd ones. Each has
half the width and half the height, so together they have half the weights, and take half the arithmetic, of the dense
layer that they equal. `EvenOdd` is an environment in these coordinates. In a plain MLP all coordinates are even.

params    {"actor": {"layers", "log_std"}, "critic": layers, "estimator": layers}, layers: [Layer, ...]
D, P, A   widths of an observation, of what is privileged, and of an action: even coordinates first, then odd ones
K         heads of the critic (task, cost)
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.stats import norm
from scipy.linalg import block_diag


class Layer(NamedTuple):
    """A linear layer. Only even outputs have a bias: it is the same for right and left."""

    even: jax.Array  # (even in, even out)
    odd: jax.Array  # (odd in, odd out)
    bias: jax.Array  # (even out,)


def init_mlp(key, sizes):
    """Layers of an MLP, uniform in +- 1/sqrt(fan-in) [lab code: PyTorch's default]; sizes: [(even, odd), ...]."""

    def uniform(key, fan_in, *shape):
        return jax.random.uniform(key, shape, minval=-1, maxval=1) / np.sqrt(max(fan_in, 1))

    layers = []
    for k, (even_in, odd_in), (even, odd) in zip(jax.random.split(key, len(sizes) - 1), sizes, sizes[1:], strict=False):
        k_even, k_odd, k_bias = jax.random.split(k, 3)
        weights = uniform(k_even, even_in, even_in, even), uniform(k_odd, odd_in, odd_in, odd)
        layers.append(Layer(*weights, uniform(k_bias, even_in, even)))
    return layers


def elu(even, odd):
    """ELU of the hidden units, right and left, which the coordinates (..., n), (..., n) stand for."""
    if odd.shape[-1] == 0:
        return jax.nn.elu(even), odd
    right, left = jax.nn.elu((even + odd) / np.sqrt(2)), jax.nn.elu((even - odd) / np.sqrt(2))
    return (right + left) / np.sqrt(2), (right - left) / np.sqrt(2)


def mlp(layers, even, odd):
    """Even and odd outputs of even (..., n) and odd (..., m) inputs, ELU between the layers."""
    *hidden, last = layers
    for layer in hidden:
        even, odd = elu(even @ layer.even + layer.bias, odd @ layer.odd)
    return even @ last.even + last.bias, odd @ last.odd


def split(x, even):
    """The even coordinates of x (..., n), which come first, and the odd ones."""
    return x[..., :even], x[..., even:]


def policy(params, obs):
    """Mean and standard deviation (..., A) of the action, and the estimate (..., P) of what is privileged.

    obs: (..., D). The estimate is an input of the actor, but learns from its own error alone (D19).
    """
    obs = split(obs, len(params["estimator"][0].even))
    estimate = mlp(params["estimator"], *obs)
    seen = [jnp.concatenate(pair, -1) for pair in zip(obs, jax.lax.stop_gradient(estimate), strict=True)]
    mean = jnp.concatenate(mlp(params["actor"]["layers"], *seen), -1)
    std = jnp.exp(params["actor"]["log_std"])
    std = jnp.concatenate([std, std[: mean.shape[-1] - len(std)]])  # right and left are equally noisy
    return mean, jnp.broadcast_to(std, mean.shape), jnp.concatenate(estimate, -1)


@jax.jit
def value(params, obs, privileged):
    """The critic: (..., K) values of obs (..., D), privileged (..., P). A value is even."""
    obs = split(obs, len(params["estimator"][0].even))
    privileged = split(privileged, len(params["estimator"][-1].bias))
    return mlp(params["critic"], *(jnp.concatenate(pair, -1) for pair in zip(obs, privileged, strict=True)))[0]


def log_prob(mean, std, action):
    """Log-density (...,) of action (..., A) under independent normals."""
    return norm.logpdf(action, mean, std).sum(-1)


# ---- even and odd coordinates ----


def even_odd(mirror):
    """Orthogonal matrix (n, n) from plain coordinates x to even and odd ones, x @ matrix, and how many are even.

    mirror: (n, n) signed permutation that is its own inverse. Entries that it swaps give one coordinate of each kind.
    """
    first = np.argmax(mirror != 0, 1) >= np.arange(len(mirror))  # of the two that are swapped
    even, odd = ((np.eye(len(mirror)) + sign * mirror)[:, first] for sign in (1, -1))
    even, odd = (part[:, part.any(0)] / np.linalg.norm(part[:, part.any(0)], axis=0) for part in (even, odd))
    return np.hstack([even, odd]).astype(np.float32), even.shape[1]


class EvenOdd:
    """An environment in even and odd coordinates. Its sizes are pairs: how many are even, how many odd.

    env.mirror: {"obs", "privileged", "action"}: signed permutations; if not mirrored, all coordinates are even
    """

    def __init__(self, env, mirrored=True):
        self.env, self.mirror = env, env.mirror if mirrored else {n: np.eye(len(m)) for n, m in env.mirror.items()}
        (self.obs, n), (self.privileged, m), (self.action, k) = (even_odd(self.mirror[name]) for name in env.mirror)
        self.obs_size, self.privileged_size = (n, len(self.obs) - n), (m, len(self.privileged) - m)
        self.action_size = k, len(self.action) - k

    def reset(self, seed):
        """As env.reset."""
        obs, info = self.env.reset(seed)
        return obs @ self.obs, info | dict(privileged=info["privileged"] @ self.privileged)

    def step(self, action):
        """As env.step."""
        obs, *rest, info = self.env.step(action @ self.action.T)
        seen = {name: info[name] @ self.privileged for name in ("privileged", "final_privileged")}
        return obs @ self.obs, *rest, info | seen | dict(final_obs=info["final_obs"] @ self.obs)

    def dense(self, params):
        """The actor and the estimator in plain coordinates, as plain MLPs: what a policy is elsewhere."""
        seen, _ = even_odd(block_diag(self.mirror["obs"], self.mirror["privileged"]))
        pairs = np.square(self.action[:, : len(params["actor"]["log_std"])])
        log_std = pairs @ params["actor"]["log_std"] / pairs.sum(1)
        actor = dict(layers=dense(params["actor"]["layers"], seen, self.action), log_std=log_std)
        return dict(actor=actor, estimator=dense(params["estimator"], self.obs, self.privileged))


def dense(layers, basis_in, basis_out):
    """Layers of the plain MLP that equals a mirrored one: its units are right and left ones, its coordinates even.

    basis_in, basis_out: from plain coordinates to even and odd ones, of the input and of the output
    """
    plain = []
    for i, layer in enumerate(layers):
        odd = layer.odd.shape[1]
        swap = np.kron([[0, 1], [1, 0]], np.eye(odd)) if odd else np.eye(len(layer.bias))
        basis = basis_out if i + 1 == len(layers) else even_odd(swap)[0]
        w = basis_in @ block_diag(layer.even, layer.odd) @ basis.T
        plain.append(Layer(w, np.zeros((0, 0), np.float32), basis[:, : len(layer.bias)] @ layer.bias))
        basis_in = basis
    return plain
