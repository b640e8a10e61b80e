"""An environment in coordinates in which the robot's mirror changes signs alone (D28).

The mirror M of a Go1 swaps its right and left legs, changes the signs of v_y, the yaw rate, roll
and the angles of the hips, and moves the clock by half a period. Robot and tasks are symmetric, but
for some millimetres (D28). So is Eq. (9) with the power clip, but not with the torque clip (D3). So
with the power clip a policy loses nothing if it commutes with M: if pi(M s) = M pi(s).

M keeps (right + s left) / sqrt 2, which is even, and negates (right - s left) / sqrt 2, which is
odd. s is the sign that M gives to the pair, -1 for hips. An entry without a partner, such as v_y,
is even or odd by itself. In these coordinates one product of n x m becomes two of about n/2 x m/2
(`networks.py`).

`Mirrored` shows what an environment shows in these coordinates, the even ones first, and turns
actions back. Whoever learns from it need not know. Without it everything works as well, with
networks that know no mirror.
"""

import numpy as np
from scipy.linalg import block_diag

from networks import join, sum_and_difference


def basis(index, sign):
    """Even and odd coordinates for M with (M x)[i] = sign[i] x[index[i]]: two matrices (n, m).

    Their columns are orthonormal, and x @ matrix are the coordinates of x. M is its own inverse.
    """
    index, here = np.array(index), np.arange(len(index))
    identity = np.eye(len(index))
    M = np.array(sign)[:, None] * identity[index]
    # M keeps the columns of I + M and negates those of I - M, where each pair has one column twice,
    # up to its sign, and one of the two columns of an entry without a partner is 0
    parts = [(identity + s * M)[:, here <= index] for s in (1, -1)]
    parts = [part[:, part.any(0)] for part in parts]
    return [(part / np.linalg.norm(part, axis=0)).astype(np.float32) for part in parts]


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
        self.history = env.obs_size // len(frame[0])
        self.obs_size = [self.history * part.shape[1] for part in frame]
        self.privileged_size = [part.shape[1] for part in privileged]
        self.action_size = [part.shape[1] for part in action]
        self.frame_basis = frame
        self.privileged_basis, self.action_basis = np.hstack(privileged), np.hstack(action)

    def reset(self, seed):
        """Start new episodes. Returns obs and an empty info."""
        self.env.reset(seed)
        return self.observe()[0], {}

    def observe(self):
        """obs (N, D) and the privileged part (N, P), in these coordinates."""
        return self.turned(*self.env.observe())

    def step(self, action):
        """As that of the environment; action (N, A), obs and what is final in these coordinates."""
        _, *result, info = self.env.step(action @ self.action_basis.T)
        obs, privileged = self.turned(info["final_obs"], info["final_privileged"])
        info |= dict(final_obs=obs, final_privileged=privileged)
        return self.observe()[0], *result, info

    def turned(self, obs, privileged):
        """obs (N, D) and the privileged part (N, P) of the environment, in these coordinates."""
        frames = obs.reshape(len(obs), self.history, -1)
        parts = [(frames @ part).reshape(len(obs), -1) for part in self.frame_basis]
        return np.hstack(parts), privileged @ self.privileged_basis


def coordinates(env):
    """Matrices for obs (D, D), privileged (P, P) and action (A, A): env shows x @ matrix.

    Without a mirror these are identities.
    """
    if not isinstance(env, Mirrored):
        return [np.eye(n) for n in (env.obs_size, env.privileged_size, env.action_size)]
    obs = np.hstack([np.kron(np.eye(env.history), part) for part in env.frame_basis])
    return obs, env.privileged_basis, env.action_basis


def plain_policy(params, env):
    """The policy that learned from env as plain MLPs, for whatever knows no mirror.

    Returns layers [(W (n, m), b (m,)), ...] of actor and estimator, by name, float32.
    """
    obs, privileged, action = coordinates(env)
    zeros = np.zeros((len(obs), len(privileged)))
    state = np.vstack([join(params, obs, zeros), join(params, zeros.T, privileged)])
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
        if i + 1 < len(layers):  # plain hidden units are right ones, then left ones
            parts = np.split(np.eye(len(bias)), len(layer.weights), 1)
            after = np.hstack(sum_and_difference(parts))
        else:
            after = leave
        # from plain inputs to coordinates, through the layer, and back
        both = enter @ weights @ after.T, bias @ after.T
        result.append(tuple(x.astype(np.float32) for x in both))
        enter = after
    return result
