"""Which commands the robot is ready for: the grid-adaptive curriculum of Section IV-A.4, after reference [5]. NumPy.

A grid over forward velocity and yaw rate has a weight for every cell, at first 1 where both are within [-1, 1] and 0
elsewhere. Commands are drawn from the cells in proportion to their weight. A robot that followed its command well for
ten seconds raises the weight of the command's cell and of the eight around it, so the region of commands grows from
its edge, in the directions in which the robot is already good. Weights never fall.
"""

import numpy as np
from scipy.ndimage import convolve

LOW, HIGH = np.array([-1.0, -10.0]), np.array([10.0, 10.0])  # v_x [m/s], yaw rate [rad/s], Section IV-A.4
V_Y = (-0.6, 0.6)  # m/s, Section IV-A.4: always all of it
START = 1.0  # m/s and rad/s: commands within +- this at first, Section IV-A.4
CELL = 0.5  # m/s and rad/s, side of a cell [ours, D23; the lab: 0.4]
BONUS = 0.2  # weight that a success adds to its cell and, once more, to it and its neighbours [lab code]
LINEAR, ANGULAR = 0.8, 0.5  # of the tracking kernels' largest value, to be exceeded by their means [lab code]
SMALL = 0.2  # m/s: a planar command below this becomes 0 [lab code]


def initial_weights():
    """Weights (22, 40) [-] over v_x and yaw rate: 1 for the cells within +- START."""
    x, yaw = (low + CELL * (np.arange(round((high - low) / CELL)) + 0.5) for low, high in zip(LOW, HIGH, strict=True))
    return (np.abs(x)[:, None] < START) * (np.abs(yaw) < START) * 1.0


def sample(weights, rng, n):
    """Commands (n, 3) [m/s, m/s, rad/s] and the cells (n, 2) that they come from.

    Cells in proportion to their weight, uniform within the cell; v_y uniform in its range. rng: numpy Generator
    """
    index = rng.choice(weights.size, n, p=weights.ravel() / weights.sum())
    cell = np.column_stack(np.unravel_index(index, weights.shape))
    x, yaw = (LOW + CELL * (cell + rng.uniform(size=(n, 2)))).T
    planar = np.column_stack([x, rng.uniform(*V_Y, n)])
    planar[np.linalg.norm(planar, axis=1) < SMALL] = 0.0
    return np.column_stack([planar, yaw]), cell


def succeeded(linear, angular):
    """Who followed the command (n,): means over ten seconds of the two kernels of Eq. (8), (n,) in [0, 1] each."""
    return (linear > LINEAR) & (angular > ANGULAR)


def update(weights, cell, success):
    """The weights after some commands have been tried: a success counts BONUS for its cell and for all nine around.

    weights: (22, 40), any grid; cell: (n, 2) of the commands; success: (n,) bool; returns new weights, at most 1
    """
    hits = np.zeros_like(weights)
    np.add.at(hits, tuple(cell[success].T), 1.0)
    return np.minimum(weights + BONUS * (hits + convolve(hits, np.ones((3, 3)), mode="constant")), 1.0)
