"""The coordinates in which an MLP that keeps to the robot's mirror symmetry costs half (D28).

The mirror M of a Go1 swaps its right and left legs and negates what points sideways. Robot and
tasks are symmetric, but for some millimetres (D28). So is Eq. (9) with the power clip, but not with
the torque clip (D3). So a policy loses nothing if it commutes with M, that is, if
pi(M s) = M pi(s).

An MLP commutes with M if its hidden units come in pairs (right, left) that M swaps. Each pair has
an even coordinate, (right + left) / sqrt 2, which M keeps, and an odd one, (right - left) / sqrt 2,
which M negates. A linear layer that commutes maps even coordinates to even ones and odd to odd
ones, and all other weights are zero. So one product of n x m becomes two of n/2 x m/2.

In these coordinates an array is a list of two halves, [even, odd], and a basis is a tuple of two
matrices with orthonormal columns, one for each half. For a plain MLP both have a single entry, and
the code is the same.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag


class Bases(NamedTuple):
    """The coordinates of what a policy sees and does. Nothing here is learned."""

    frame: tuple  # basis of one frame of the observation, which is a row of such frames
    privileged: tuple  # basis of the privileged part of a state
    action: tuple  # basis of an action
    pair: np.ndarray  # (A,) for each entry of an action, the number of its pair


def make_bases(mirror, frame_size, privileged_size, action_size):
    """The Bases of a mirror, or with None those of plain MLPs.

    mirror: {"frame", "privileged", "action"}, each (index, sign): (M x)[i] = sign[i] x[index[i]]
    """
    if mirror is None:
        sizes = frame_size, privileged_size, action_size
        return Bases(*map(plain_basis, sizes), np.arange(action_size))
    index = np.array(mirror["action"][0])
    pair = np.unique(np.minimum(np.arange(len(index)), index), return_inverse=True)[1]
    return Bases(*(basis(*mirror[name]) for name in ("frame", "privileged", "action")), pair)


def basis(index, sign):
    """The basis of even and odd coordinates for M with (M x)[i] = sign[i] x[index[i]]."""
    index, here = np.array(index), np.arange(len(index))
    identity = np.eye(len(index))
    reflection = np.array(sign)[:, None] * identity[index]
    halves = [(identity + s * reflection)[:, here <= index] for s in (1, -1)]  # one column per pair
    halves = [half[:, half.any(0)] for half in halves]  # an entry without a partner is even or odd
    return tuple((half / np.linalg.norm(half, axis=0)).astype(np.float32) for half in halves)


def plain_basis(n):
    """The basis of an array (..., n) without a mirror: every entry is its own coordinate."""
    return (np.eye(n, dtype=np.float32),)


def split(x, basis):
    """The coordinates of x (..., n) in a basis: a list of halves (..., m)."""
    return [x @ half for half in basis]


def split_frames(obs, basis):
    """The coordinates of obs (..., H n), which is H frames of n entries, in a frame's basis."""
    frames = obs.reshape(*obs.shape[:-1], -1, len(basis[0]))
    return [half.reshape(*obs.shape[:-1], -1) for half in split(frames, basis)]


def join(halves, basis):
    """The x (..., n) with these coordinates: the inverse of `split`."""
    return sum(half @ columns.T for half, columns in zip(halves, basis, strict=True))


def sum_and_difference(halves):
    """[right, left] hidden units from [even, odd], or back, as this is its own inverse."""
    if len(halves) == 1:
        return halves
    first, second = halves
    return [(first + second) / np.sqrt(2), (first - second) / np.sqrt(2)]


def dense(layers, basis_in, basis_out):
    """The layers [(weights (n, m), bias (m,))] of the plain MLP that equals `layers`.

    basis_in, basis_out: of what enters the first layer and of what leaves the last
    """
    plain = []
    for i, layer in enumerate(layers):
        is_last = i + 1 == len(layers)
        out = basis_out if is_last else hidden_basis(len(layer.bias), len(layer.weights))
        parts = zip(basis_in, layer.weights, out, strict=True)
        weights = sum(a @ np.asarray(w) @ b.T for a, w, b in parts)
        plain.append((weights, out[0] @ np.asarray(layer.bias)))
        basis_in = out
    return plain


def hidden_basis(n, num_halves):
    """The basis of n right and then n left hidden units or, with one half, of n plain ones."""
    one = np.eye(n, dtype=np.float32)
    if num_halves == 1:
        return (one,)
    return np.vstack([one, one]) / np.sqrt(2), np.vstack([one, -one]) / np.sqrt(2)


def row_of_frames(basis, history):
    """The basis of `history` frames side by side, from that of one."""
    return tuple(np.kron(np.eye(history, dtype=np.float32), half) for half in basis)


def side_by_side(first, second):
    """The basis of two arrays side by side, from those of each."""
    return tuple(block_diag(a, b).astype(np.float32) for a, b in zip(first, second, strict=True))
