"""Even and odd coordinates of what the robot's mirror maps (D28): those in which the networks of `networks.py` work."""

import numpy as np
from scipy.linalg import block_diag

from networks import Layer


def even_odd(mirror):
    """An orthogonal matrix B (n, n) such that x @ B are the even, then the odd coordinates of x; and how many are even.

    mirror: (n, n) signed permutation that is its own inverse. Two entries that it swaps give a coordinate of each kind.
    """
    first = np.argmax(mirror != 0, 1) >= np.arange(len(mirror))  # of two swapped entries the first one
    even, odd = ((np.eye(len(mirror)) + sign * mirror)[:, first] for sign in (1, -1))
    even, odd = (part[:, part.any(0)] / np.linalg.norm(part[:, part.any(0)], axis=0) for part in (even, odd))
    return np.hstack([even, odd]).astype(np.float32), even.shape[1]


class EvenOdd:
    """An environment in even and odd coordinates. Its sizes are pairs: how many are even, and how many are odd.

    env.mirror: {"obs", "privileged", "action"}, a signed permutation each; mirrored: False makes all coordinates even
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
        """params with actor and estimator as plain MLPs in plain coordinates, as `policy.npz` has them; no critic."""
        seen, _ = even_odd(block_diag(self.mirror["obs"], self.mirror["privileged"]))
        pairs = np.square(self.action[:, : len(params["actor"]["log_std"])])
        log_std = pairs @ params["actor"]["log_std"] / pairs.sum(1)
        actor = dict(layers=dense(params["actor"]["layers"], seen, self.action), log_std=log_std)
        return dict(actor=actor, estimator=dense(params["estimator"], self.obs, self.privileged))


def dense(layers, basis_in, basis_out):
    """Layers of the plain MLP that equals a mirrored one. Its hidden units are the right and left ones themselves.

    basis_in, basis_out: matrices of `even_odd` for the input and for the output
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
