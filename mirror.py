"""An MLP that treats left and right alike, to take the place of a `networks.MLP` (D28).

The mirror M of a Go1 swaps its right and left legs, changes the signs of v_y, the yaw rate, roll
and the angles of the hips, and moves the clock by half a period. Robot and tasks are nearly
symmetric (D28). So is Eq. (9) with the power clip, but not with the torque clip (D3). So with the
power clip a policy loses nothing if it commutes with M: if pi(M s) = M pi(s).

Half of the units of a hidden layer are right ones, and the left ones see the mirrored world with
the same weights. That alone would cost as much as an ordinary MLP. But x is the sum of an even
part, (x + M x) / 2, which M keeps, and of an odd part, (x - M x) / 2, which M negates, and each has
about half as many numbers as x, since the others repeat those, up to signs, or are 0. So

    right units   even @ A + odd @ B + bias
    left units    even @ A - odd @ B + bias

take two products, each of a quarter of an ordinary layer's size: half the time.

A mirror is written as (index, sign): number i of M x is sign[i] x[index[i]]. Arrays one after the
other have a list of mirrors. An environment has such lists for all that it shows or is told, in
`mirror`.
"""

from dataclasses import dataclass, field

import jax
import numpy as np

import networks


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class MirroredMLP:
    """An MLP f with f(M x) = M f(x), which is called like a `networks.MLP`.

    halves: of each layer A (n, m) of n even inputs, B (k, m) of k odd ones, and bias (m,), for m
            pairs of units, or for all m outputs
    enter, leave: the mirrors of inputs and of outputs
    """

    halves: list
    enter: tuple = field(metadata=dict(static=True))
    leave: tuple = field(metadata=dict(static=True))

    def __call__(self, x):
        """Outputs for inputs, as `networks.MLP`."""
        even, odd = parts(x, self.enter)
        for i, (A, B, bias) in enumerate(self.halves):
            if i:
                # ELU is not linear: it needs the right and left units, not their even and odd parts
                right, left = jax.nn.elu(even + odd), jax.nn.elu(even - odd)
                even, odd = (right + left) / 2, (right - left) / 2
            even, odd = even @ A + bias, odd @ B
        # the mean of the outputs for x, and of the images of those for M x
        return (even + odd + reflect(even - odd, self.leave)) / 2

    @property
    def layers(self):
        """The layers [(W (n, m), b (m,)), ...] of the `networks.MLP` that equals this one, float32.

        Of each hidden layer the right units come first.
        """
        layers, mirror = [], self.enter
        for A, B, bias in self.halves:
            even, odd = parts(np.eye(len(mirror[0])), mirror)
            right, left = even @ A + odd @ B, even @ A - odd @ B
            layers.append((np.hstack([right, left]), np.tile(bias, 2)))
            mirror = swap(2 * len(bias))
        last = [np.split(x, 2, -1) for x in layers[-1]]
        layers[-1] = [(right + reflect(left, self.leave)) / 2 for right, left in last]
        return [(np.float32(weights), np.float32(bias)) for weights, bias in layers]


def tied(mlp, enter, leave):
    """The MirroredMLP that has the right units of an MLP, and their images as left ones.

    The right units are the first half of each hidden layer. The MLP's second half is not used.
    enter, leave: the mirrors of inputs and of outputs. Outputs are the mean of what the MLP's last
    layer says of these units, and of the image of what it says of the mirrored ones.
    """
    halves, mirror = [], enter
    for i, (weights, bias) in enumerate(mlp.layers):
        m = len(bias) if i + 1 == len(mlp.layers) else len(bias) // 2
        # a number that stands for a pair gets the weights of both
        twice = 1 + (np.arange(len(weights)) != mirror[0])
        A, B = (part.T for part in parts(twice * weights[:, :m].T, mirror))
        halves.append((np.float32(A), np.float32(B), bias[:m]))
        mirror = swap(len(bias))
    return MirroredMLP(halves, enter, leave)


def init_params(rng, env, K, cfg):
    """As `networks.init_params`, of networks that commute with the mirrors of env."""
    obs, privileged, action = (env.mirror[x] for x in ("obs", "privileged", "action"))
    values = [([0], [1])] * K  # which a mirror does not change
    state = joined(obs + privileged)
    sides = dict(
        actor=(state, joined(action)),
        critic=(state, joined(values)),
        estimator=(joined(obs), joined(privileged)),
    )
    params = networks.init_params(rng, env, K, cfg)
    return params | {net: tied(params[net], *mirrors) for net, mirrors in sides.items()}


# ---- mirrors ----


def reflect(x, mirror):
    """M x for x (..., n)."""
    index, sign = np.array(mirror)
    return sign * x[..., index]


def parts(x, mirror):
    """The even part (..., n) and the odd part (..., k) of x (..., n + k), each number once.

    They begin with one number for each pair. A number without a partner, such as v_y, is even or
    odd, and not in the other part.
    """
    xp = x.__array_namespace__()  # NumPy or JAX, of whichever x is
    index, sign = np.array(mirror)
    here = np.arange(len(index))
    first = np.flatnonzero(here < index)
    right, left = x[..., first], sign[first] * x[..., index[first]]
    even, odd = (x[..., (here == index) & (sign == s)] for s in (1, -1))
    even = xp.concat([(right + left) / 2, even], axis=-1)
    return even, xp.concat([(right - left) / 2, odd], axis=-1)


def swap(n):
    """The mirror of n units, of which the first half are right ones."""
    return (*range(n // 2, n), *range(n // 2)), (1,) * n


def joined(mirrors):
    """The mirror of arrays one after the other. It is of tuples, because JAX wants to hash it."""
    index, sign = [], []
    for part_index, part_sign in mirrors:
        index += [len(index) + int(i) for i in part_index]
        sign += [int(s) for s in part_sign]
    return tuple(index), tuple(sign)
