"""Actor, critic and estimator: the MLPs of Section IV-C.b, and what they say.

params    {"actor", "critic", "estimator": MLP, "log_std": (A,) of the action's noise}
D, P, A   widths of an observation, of what is privileged (true velocity) and of an action
K         heads of the critic, the outputs for the value of the task and, for pi, of the cost

An MLP is a function of arrays. Anything that is called like one, and has `layers` like one, may
stand in its place, as in `train.py` (D28). D-numbers are entries of deviations.md; the lab is the
authors' group.
"""

from dataclasses import dataclass
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.stats import norm


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class MLP:
    """A multilayer perceptron, with ELU between its layers."""

    layers: list  # [(W (n, m), b (m,)), ...]

    def __call__(self, x):
        """Outputs (..., m) for inputs (..., n)."""
        for i, (weights, bias) in enumerate(self.layers):
            if i:
                x = jax.nn.elu(x)
            x = x @ weights + bias
        return x


def policy(params, obs):
    """Mean and standard deviation (..., A) of the action for obs (..., D), and estimated (..., P).

    The estimator estimates what is privileged, the true velocity of the body. The actor sees the
    estimate, but the estimator learns from its own error alone (D19).
    """
    estimated = params["estimator"](obs)
    mean = params["actor"](jnp.concatenate([obs, jax.lax.stop_gradient(estimated)], -1))
    std = jnp.exp(params["log_std"])
    return mean, jnp.broadcast_to(std, mean.shape), estimated


def value(params, obs, privileged):
    """The critic's values (..., K) of obs (..., D) with privileged (..., P)."""
    return params["critic"](jnp.concatenate([obs, privileged], -1))


def sample(params, obs, key):
    """Random actions (N, A) of the policy for obs (N, D), and their log-probabilities (N,)."""
    mean, std, _ = policy(params, obs)
    action = mean + std * jax.random.normal(key, mean.shape)
    return action, log_prob(mean, std, action)


def log_prob(mean, std, action):
    """Log-density (...,) of action (..., A) under independent normals."""
    return norm.logpdf(action, mean, std).sum(-1)


def init_params(rng, env, K, cfg):
    """Random parameters, drawn by NumPy, because JAX would take seconds to compile that many draws.

    rng: np.random.Generator
    env: only its obs_size, privileged_size and action_size are used
    K:   heads of the critic
    cfg: ppo.PPOConfig, with the widths of the hidden layers
    """
    obs, privileged, action = env.obs_size, env.privileged_size, env.action_size
    return dict(
        actor=init_mlp(rng, [obs + privileged, *cfg.hidden, action]),
        critic=init_mlp(rng, [obs + privileged, *cfg.hidden, K]),
        estimator=init_mlp(rng, [obs, *cfg.hidden_estimator, privileged]),
        log_std=np.full(action, cfg.log_std, np.float32),
    )


def init_mlp(rng, sizes):
    """A random MLP; sizes: of each layer, from the input on."""
    return MLP([(uniform(rng, n, n, m), uniform(rng, n, m)) for n, m in pairwise(sizes)])


def uniform(rng, fan_in, *shape):
    """Random numbers within +- 1 / sqrt(fan_in), as in PyTorch [lab code]."""
    return np.float32(rng.uniform(-1, 1, shape) / np.sqrt(fan_in))
