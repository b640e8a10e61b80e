"""Ground to run on: Perlin noise, and a height field made of it. Sections IV-A.2 to IV-A.4.

The paper says that the ground is Perlin noise, and how rough it is on each task. We take roughness
to be the height from the lowest to the highest point of a tile. The paper does not say how fine the
noise is (D22).

All robots share one height field, a row of square tiles, each with its own roughness. A tile is
periodic: where a robot leaves it, the ground goes on as at the opposite edge, and there the robot
is put. So no robot runs off the world. Each tile has an apron, which continues it on all sides, for
feet that are past the edge while the trunk is not.
"""

import numpy as np
from scipy.ndimage import map_coordinates

TILE, APRON = 4.0, 1.0  # m, side of a tile and width of its apron [ours]
PITCH = TILE + 2 * APRON  # m, from one tile to the next
SPACING = 0.05  # m, between two points of the height field [lab code]


def fade(t):
    """Perlin's quintic 6 t^5 - 15 t^4 + 10 t^3, from 0 to 1, flat and uncurved at both ends."""
    return t**3 * (t * (6 * t - 15) + 10)


def perlin(x, y, gradients):
    """Perlin noise (...,) [-]: planes through 0 at a cell's four corners, faded into each other.

    x, y:      (...,) [cells] where to take the noise, along the first and the second axis of
               gradients; it is 0 at the lattice points, where both are whole numbers
    gradients: (n, m, 2) slopes of the planes of the lattice points, repeated with periods n and m
    """
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    u, v = x - i, y - j

    def corner(a, b):
        gradient = gradients[(i + a) % gradients.shape[0], (j + b) % gradients.shape[1]]
        return gradient[..., 0] * (u - a) + gradient[..., 1] * (v - b)

    s, t = fade(u), fade(v)
    low = (1 - s) * corner(0, 0) + s * corner(1, 0)
    high = (1 - s) * corner(0, 1) + s * corner(1, 1)
    return (1 - t) * low + t * high


def tile(rng, roughness, cells_per_m):
    """Heights (n, n) [m] of a tile, n = TILE / SPACING; roughness: [m] from lowest to highest."""
    cells = round(TILE * cells_per_m)
    angle = rng.uniform(0, 2 * np.pi, (cells, cells))
    gradients = np.stack([np.cos(angle), np.sin(angle)], -1)  # random unit vectors
    along = cells_per_m * SPACING * np.arange(round(TILE / SPACING))
    noise = perlin(*np.meshgrid(along, along, indexing="ij"), gradients)
    return roughness * noise / np.ptp(noise)


def make_ground(roughness, seed, cells_per_m):
    """The height field (ny, nx) [m]: tiles side by side along x, each with noise of its own.

    roughness: (tiles,) [m] of each tile. The height [i, j] is that at y = i SPACING and x = j
        SPACING.
    """
    rng = np.random.default_rng(seed)
    margin = round(APRON / SPACING)
    return np.hstack([np.pad(tile(rng, r, cells_per_m), margin, mode="wrap") for r in roughness])


def origin(index):
    """The corner (..., 2) [m] of the tile `index` (...,). The tile ends TILE further in x and y."""
    return np.stack([PITCH * index + APRON, np.full(np.shape(index), APRON)], -1)


def wrap(xy, index):
    """xy (..., 2) [m] moved into the tile `index` (...,), to where the ground is the same."""
    corner = origin(index)
    return xy - TILE * np.floor((xy - corner) / TILE)


def height(ground, xy):
    """Height (...,) [m] of the field `ground` at xy (..., 2) [m], linear between its points."""
    row_column = xy.reshape(-1, 2).T[::-1] / SPACING  # flat, because SciPy takes no single point
    return map_coordinates(ground, row_column, order=1, mode="nearest").reshape(xy.shape[:-1])
