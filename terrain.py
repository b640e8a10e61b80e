"""Ground to run on: Perlin noise, and a height field made of it. Section IV-A.2 and IV-A.3.

The paper says "Perlin noise" and how rough: 0 to 15 cm, 5 cm. Roughness is the height from the deepest to the highest
point. The lab's code has 4 cells per metre, and 1 in the file of its EIPO code (D22).

All robots share one height field, a row of square tiles with a roughness each. A tile is periodic: what leaves it on
one side finds the same ground on the other, so a robot never runs off the world. Around a tile lies an apron of its own
continuation, so that a foot which is past the edge while the trunk is not stands on the right ground as well.
"""

import numpy as np
from scipy.ndimage import map_coordinates

TILE, APRON = 4.0, 1.0  # m, side of a tile and width of its continuation on every side [ours]
PITCH = TILE + 2 * APRON  # m, from one tile to the next
SPACING = 0.05  # m, between two points of the height field [lab code]


def fade(t):
    """Perlin's quintic 6 t^5 - 15 t^4 + 10 t^3: from 0 to 1 on [0, 1], slope and curvature 0 at both ends."""
    return t**3 * (t * (6 * t - 15) + 10)


def random_gradients(rng, cells):
    """Unit vectors (cells, cells, 2), one for each point of a periodic lattice; rng: numpy Generator."""
    angle = rng.uniform(0, 2 * np.pi, (cells, cells))
    return np.stack([np.cos(angle), np.sin(angle)], -1)


def perlin(x, y, gradients):
    """Perlin noise (...,) [-]: at each corner of the cell a plane through 0 with that gradient, faded into each other.

    x, y:      (...,) [cells]; the noise is 0 where both are whole numbers
    gradients: (n, m, 2) of the lattice points, repeated forever: the noise has period n in x and m in y
    """
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    u, v = x - i, y - j

    def corner(a, b):
        gradient = gradients[(i + a) % gradients.shape[0], (j + b) % gradients.shape[1]]
        return gradient[..., 0] * (u - a) + gradient[..., 1] * (v - b)

    s, t = fade(u), fade(v)
    return (1 - t) * ((1 - s) * corner(0, 0) + s * corner(1, 0)) + t * ((1 - s) * corner(0, 1) + s * corner(1, 1))


def tile(rng, roughness, cells_per_m=4):
    """Heights (n, n) [m] of one period of ground, n = TILE / SPACING; roughness: [m] from lowest to highest point."""
    gradients = random_gradients(rng, round(TILE * cells_per_m))
    along = cells_per_m * SPACING * np.arange(round(TILE / SPACING))
    noise = perlin(*np.meshgrid(along, along, indexing="ij"), gradients)
    return roughness * noise / np.ptp(noise)


def make_ground(roughness, seed=0, cells_per_m=4):
    """The height field (ny, nx) [m] with a tile for each roughness, (tiles,) [m]; every tile has noise of its own.

    The point (i, j) lies at y = i SPACING, x = j SPACING. The tiles follow each other along x.
    """
    rng, margin = np.random.default_rng(seed), round(APRON / SPACING)
    return np.hstack([np.pad(tile(rng, r, cells_per_m), margin, mode="wrap") for r in roughness])


def origin(index):
    """Corner (..., 2) [m] of the tile of that index (...,), which reaches from there to TILE further in x and y."""
    return np.stack([PITCH * index + APRON, np.full(np.shape(index), APRON)], -1)


def wrap(xy, index):
    """The place (..., 2) [m] within the tile `index` (...,) where the ground is as at xy (..., 2) [m]."""
    corner = origin(index)
    return xy - TILE * np.floor((xy - corner) / TILE)


def height(ground, xy):
    """Height of the ground (...,) [m] at xy (..., 2) [m], linear between the points of the field."""
    flat = xy.reshape(-1, 2).T / SPACING
    return map_coordinates(ground, flat[::-1], order=1, mode="nearest").reshape(xy.shape[:-1])
