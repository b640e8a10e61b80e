"""Actor, critic and estimator as functions of their parameters (Section IV-C.b), with a left and a right (D28).

A Go1 has a left and a right. Let M mirror a state: legs swapped, signs of what points sideways turned. The robot, its
tasks and Eq. (9) do not change under M, so neither should a policy: pi(M s) = M pi(s). An MLP is such a policy if its
hidden units come in pairs (right, left) which M swaps. In the coordinates

    even = (right + left) / sqrt 2    which M leaves alone         odd = (right - left) / sqrt 2    which M negates

every linear layer of it falls apart into one product of the even coordinates and one of the odd ones, each of half the
width and half the height: half the weights and half the arithmetic of the dense layer which it equals. So `EvenOdd`
gives the learner an environment in these coordinates, even ones first, and `dense` turns a trained network back. A
plain MLP is the case in which all coordinates are even.

params    {"actor": {"layers", "log_std"}, "critic": layers, "estimator": layers}, layers: [Layer, ...]
D, P, A   widths of an observation, of what is privileged, and of an action
K         heads of the critic (task, cost)
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.stats import norm
from scipy.linalg import block_diag


class Layer(NamedTuple):
    """A linear layer from (even, odd) to (even, odd) coordinates. A bias may only be even."""

    even: jax.Array  # (even in, even out)
    odd: jax.Array  # (odd in, odd out)
    bias: jax.Array  # (even out,)


def init_mlp(key, sizes):
    """Layers of an MLP, uniform in +- 1/sqrt(fan-in) [lab code: PyTorch's default]; sizes: [(even, odd), ...]."""
    layers = []
    for k, (even_in, odd_in), (even, odd) in zip(jax.random.split(key, len(sizes) - 1), sizes, sizes[1:], strict=False):
        k_even, k_odd = jax.random.split(k)
        both = jax.random.uniform(k_even, (even_in + 1, even), minval=-1, maxval=1) / np.sqrt(even_in)
        odd = jax.random.uniform(k_odd, (odd_in, odd), minval=-1, maxval=1) / np.sqrt(max(odd_in, 1))
        layers.append(Layer(both[:-1], odd, both[-1]))
    return layers


def elu(even, odd):
    """ELU of the hidden units themselves, right and left, which the coordinates (..., n), (..., n) stand for."""
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


def halves(x, even):
    """The even and the odd coordinates of x (..., n), of which the first `even` are even."""
    return x[..., :even], x[..., even:]


def join(*pairs):
    """Pairs (even, odd) side by side: one pair."""
    return [jnp.concatenate(part, -1) for part in zip(*pairs, strict=True)]


def policy(params, obs):
    """Mean and standard deviation (..., A) of the action, and the estimate (..., P) of what is privileged.

    obs: (..., D). The estimate is an input of the actor, but learns from its own error alone (D19).
    """
    obs = halves(obs, len(params["estimator"][0].even))
    estimate = mlp(params["estimator"], *obs)
    mean = jnp.concatenate(mlp(params["actor"]["layers"], *join(obs, jax.lax.stop_gradient(estimate))), -1)
    std = jnp.exp(params["actor"]["log_std"])
    std = jnp.concatenate([std, std[: mean.shape[-1] - len(std)]])  # right and left are equally noisy
    return mean, jnp.broadcast_to(std, mean.shape), jnp.concatenate(estimate, -1)


@jax.jit
def value(params, obs, privileged):
    """The critic: (..., K) values of obs (..., D), privileged (..., P). A value is even."""
    first, last = params["estimator"][0], params["estimator"][-1]
    return mlp(params["critic"], *join(halves(obs, len(first.even)), halves(privileged, len(last.bias))))[0]


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
    basis = [part[:, part.any(0)] / np.linalg.norm(part[:, part.any(0)], axis=0) for part in (even, odd)]
    return np.hstack(basis).astype(np.float32), basis[0].shape[1]


class EvenOdd:
    """An environment in even and odd coordinates, even ones first. Sizes are pairs (even, odd).

    env.mirror: {"obs", "privileged", "action"}: signed permutations. mirrored: if False, everything is even.
    """

    def __init__(self, env, mirrored=True):
        self.env, self.mirror = env, env.mirror if mirrored else {n: np.eye(len(m)) for n, m in env.mirror.items()}
        self.basis, even = {}, {}
        for name, mirror in self.mirror.items():
            self.basis[name], even[name] = even_odd(mirror)
        self.obs_size, self.privileged_size, self.action_size = (
            (even[name], len(self.mirror[name]) - even[name]) for name in ("obs", "privileged", "action")
        )

    def _see(self, info):
        return info | {name: x @ self.basis[name.split("_")[-1]] for name, x in info.items() if name in self.SEEN}

    SEEN = ("privileged", "final_obs", "final_privileged")

    def reset(self, seed):
        """As env.reset."""
        obs, info = self.env.reset(seed)
        return obs @ self.basis["obs"], self._see(info)

    def step(self, action):
        """As env.step."""
        obs, reward, terminated, truncated, info = self.env.step(action @ self.basis["action"].T)
        return obs @ self.basis["obs"], reward, terminated, truncated, self._see(info)

    def dense(self, params):
        """The actor and the estimator as plain MLPs of plain coordinates, with all coordinates even: see `dense`."""
        obs, privileged, action = (self.basis[name] for name in ("obs", "privileged", "action"))
        both, _ = even_odd(block_diag(self.mirror["obs"], self.mirror["privileged"]))
        noise = np.square(action[:, : len(params["actor"]["log_std"])])
        log_std = noise @ params["actor"]["log_std"] / noise.sum(1)
        actor = dict(layers=dense(params["actor"]["layers"], both, action), log_std=log_std)
        return dict(actor=actor, estimator=dense(params["estimator"], obs, privileged))


def dense(layers, basis_in, basis_out):
    """The plain MLP which equals a mirrored one: layers of (right, left) units, all coordinates of which are even.

    basis_in, basis_out: from plain coordinates to those of the first layer's input and the last one's output
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
