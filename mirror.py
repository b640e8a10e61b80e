"""An environment in coordinates in which the robot's mirror changes signs alone (D28).

The mirror M of a Go1 swaps its right and left legs and negates what points sideways. Robot and
tasks are symmetric, but for some millimetres (D28). So is Eq. (9) with the power clip, but not with
the torque clip (D3). So a policy loses nothing if it commutes with M, that is, if
pi(M s) = M pi(s).

In the coordinates (right + left) / sqrt 2 and (right - left) / sqrt 2 the mirror keeps the first
kind, which is even, and negates the second, which is odd. A linear layer that commutes with M maps
even to even and odd to odd, and all its other weights are zero. So one product of n x m becomes two
of n/2 x m/2, which `networks.mlp` takes.

`Mirrored` shows what an environment shows in these coordinates, the even ones first, and turns
actions back. Whoever learns from it sees plain arrays. Without it everything works as well, with
networks that know no mirror.
"""

import numpy as np
from scipy.linalg import block_diag

from networks import join, sum_and_difference


def basis(index, sign):
    """Even and odd coordinates for M with (M x)[i] = sign[i] x[index[i]]: two matrices (n, m).

    Their columns are orthonormal.
    """
    index, here = np.array(index), np.arange(len(index))
    identity = np.eye(len(index))
    reflection = np.array(sign)[:, None] * identity[index]
    halves = [(identity + s * reflection)[:, here <= index] for s in (1, -1)]  # one column per pair
    halves = [half[:, half.any(0)] for half in halves]  # an entry without a partner is even or odd
    return [(half / np.linalg.norm(half, axis=0)).astype(np.float32) for half in halves]


class Mirrored:
    """An environment in even and odd coordinates.

    A size is two numbers: how many coordinates are even and how many are odd. In obs (N, D) the
    even ones of all frames come first.
    """

    def __init__(self, env):
        """env: as go1_env.Go1Env, whose `mirror` has index and sign of frame, privileged, action"""
        self.env, self.num_envs = env, env.num_envs
        frame, privileged, action = (
            basis(*env.mirror[name]) for name in ("frame", "privileged", "action")
        )
        history = env.obs_size // len(frame[0])
        self.obs_size = [history * half.shape[1] for half in frame]
        self.privileged_size = [half.shape[1] for half in privileged]
        self.action_size = [half.shape[1] for half in action]
        self.frame = frame
        self.privileged, self.action = np.hstack(privileged), np.hstack(action)

    def reset(self, seed):
        """Start new episodes. Returns obs and an empty info."""
        self.env.reset(seed)
        return self.observe()[0], {}

    def observe(self):
        """obs (N, D) and the privileged part (N, P), in these coordinates."""
        return self.turned(*self.env.observe())

    def step(self, action):
        """As that of the environment; action (N, A), obs and what is final in these coordinates."""
        _, *result, info = self.env.step(action @ self.action.T)
        final = self.turned(info["final_obs"], info["final_privileged"])
        info |= dict(zip(("final_obs", "final_privileged"), final, strict=True))
        return self.observe()[0], *result, info

    def turned(self, obs, privileged):
        """obs (N, D) and the privileged part (N, P) of a plain environment in these coordinates."""
        frames = obs.reshape(len(obs), -1, len(self.frame[0]))
        halves = [(frames @ half).reshape(len(obs), -1) for half in self.frame]
        return np.hstack(halves), privileged @ self.privileged


def coordinates(env):
    """What an environment shows of a plain one: obs (D, D), privileged (P, P), action (A, A).

    A column is a coordinate. Without a mirror these are identities.
    """
    if not isinstance(env, Mirrored):
        return [np.eye(n) for n in (env.obs_size, env.privileged_size, env.action_size)]
    history = np.eye(env.env.obs_size // len(env.frame[0]))
    obs = np.hstack([np.kron(history, half) for half in env.frame])
    return obs, env.privileged, env.action


def plain_policy(params, env):
    """The policy that learned from env as plain MLPs, for what is not mirrored.

    Returns layers [(W (n, m), b (m,)), ...] of actor and estimator, by name.
    """
    obs, privileged, action = coordinates(env)
    none = np.zeros((len(obs), len(privileged)))
    state = np.vstack([join(params, obs, none), join(params, none.T @ obs, privileged)])
    return dict(
        actor=plain(params["actor"], state, action),
        estimator=plain(params["estimator"], obs, privileged),
    )


def plain(layers, enter, leave):
    """The layers [(W (n, m), b (m,)), ...] of the plain MLP that equals `layers`.

    enter, leave: (n, n) and (m, m), whose columns are coordinates of what enters and what leaves
    """
    result = []
    for i, layer in enumerate(layers):
        weights = block_diag(*layer.weights)
        bias = np.pad(layer.bias, (0, weights.shape[1] - len(layer.bias)))
        if i + 1 < len(layers):  # hidden units are right ones, then left ones
            here = np.hstack(sum_and_difference(np.split(np.eye(len(bias)), len(layer.weights), 1)))
        else:
            here = leave
        result.append((enter @ weights @ here.T, bias @ here.T))
        enter = here
    return result
