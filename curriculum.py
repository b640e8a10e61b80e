"""Which commands the robot is ready for: the grid-adaptive curriculum of Section IV-A.4, after
reference [5].

Each cell of a grid over forward velocity and yaw rate has a weight. At first it is 1 where both are
within [-1, 1], and 0 elsewhere. Commands are drawn from the cells in proportion to their weights. A
robot that followed its command well for ten seconds raises the weight of the command's cell and of
the eight around it. So the region of commands grows at its edge, in the directions in which the
robot is already good. Weights never fall.
"""

import numpy as np
from scipy.ndimage import convolve

# ends of v_x [m/s] and yaw rate [rad/s], Section IV-A.4
LOW, HIGH = np.array([-1.0, -10.0]), np.array([10.0, 10.0])
V_Y = (-0.6, 0.6)  # m/s, Section IV-A.4; v_y is drawn from all of it from the start
START = 1.0  # m/s and rad/s: commands within +- this at first, Section IV-A.4
CELL = 0.5  # m/s and rad/s, side of a cell [ours; the lab has 0.4]
# a success adds this to its cell and the neighbours, and once more to its cell [lab code]
BONUS = 0.2
# in a success the means of the two kernels of Eq. (8) are above these [lab code]
LINEAR, ANGULAR = 0.8, 0.5
SMALL = 0.2  # m/s, a shorter command (v_x, v_y) becomes 0 [lab code]


def initial_weights():
    """Weights (22, 40) [-] of the cells over v_x and yaw rate: 1 within +- START, 0 elsewhere."""
    x, yaw = (
        low + CELL * (np.arange(round((high - low) / CELL)) + 0.5)
        for low, high in zip(LOW, HIGH, strict=True)
    )
    return (np.abs(x)[:, None] < START) * (np.abs(yaw) < START) * 1.0


def sample(weights, rng, n):
    """Random commands (n, 3) [m/s, m/s, rad/s], and the cells (n, 2) that they come from.

    A cell is drawn in proportion to its weight, then v_x and yaw rate uniformly within the cell,
    and v_y from V_Y.
    """
    index = rng.choice(weights.size, n, p=weights.ravel() / weights.sum())
    cell = np.column_stack(np.unravel_index(index, weights.shape))
    x, yaw = (LOW + CELL * (cell + rng.uniform(size=(n, 2)))).T
    planar = np.column_stack([x, rng.uniform(*V_Y, n)])
    planar[np.linalg.norm(planar, axis=1) < SMALL] = 0.0
    return np.column_stack([planar, yaw]), cell


def succeeded(linear, angular):
    """Who followed the command, (n,) bool: linear, angular are (n,) ten-second means of kernels."""
    return (linear > LINEAR) & (angular > ANGULAR)


def update(weights, cell, success):
    """The weights after n commands were tried: larger after a success (see BONUS), at most 1.

    weights: (22, 40) or another grid; cell: (n, 2) of each command; success: (n,) bool
    """
    hits = np.zeros_like(weights)
    np.add.at(hits, tuple(cell[success].T), 1.0)
    return np.minimum(
        weights + BONUS * (hits + convolve(hits, np.ones((3, 3)), mode="constant")), 1.0
    )
