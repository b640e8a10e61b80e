"""Sections IV-A.2 and 3: Perlin noise and the ground made of it, in dyadic numbers, by hand."""

import numpy as np
import pytest

import terrain
from terrain import fade, height, make_ground, perlin, tile, wrap

# of the lattice points (0, 0), (0, 1) and (1, 0), (1, 1): no two components alike
GRADIENTS = np.array([[[1.0, 3.0], [7.0, -4.0]], [[-2.0, 5.0], [6.0, -9.0]]])


def rng(seed=0):
    return np.random.default_rng(seed)


# ---- noise ----


def test_fade_by_hand():
    """t^3 (t (6 t - 15) + 10), which is flat at both ends:

    t = 1/4:  1/64  (1/4 (6/4 - 15) + 10)  = 6.625 / 64
    t = 1/2:  1/8   (1/2 (3 - 15) + 10)    = 4 / 8
    t = 3/4:  27/64 (3/4 (18/4 - 15) + 10) = 57.375 / 64

    A small h leaves less than 10 h^3, where a slope would leave h and a curvature h^2.
    """
    assert fade(np.arange(5) / 4).tolist() == [0.0, 0.103515625, 0.5, 0.896484375, 1.0]
    h = 2.0**-10
    assert 0 < fade(h) < 10 * h**3 and 0 < 1 - fade(1 - h) < 10 * h**3


@pytest.mark.parametrize(
    ("x", "y", "value"),
    [
        # planes 1/2 + 3/2, 1 + 5/2, 7/2 + 2, -3 + 9/2, which is the mean of 2, 3.5, 5.5, 1.5
        (0.5, 0.5, 3.125),
        (0.25, 0.0, 0.37939453125),  # (1 - s) 1/4 + s (-3/4) (-2) = 0.25 + 1.25 s
        (0.0, 0.25, 0.98291015625),  # (1 - s) 3/4 + s (-3/4) (-4) = 0.75 + 2.25 s
        # planes 1.75, 4, 3.75, 0, so the mean of 1.75 + 2.25 s and 3.75 - 3.75 s
        (0.25, 0.5, 2.67236328125),
        # next cell, whose far corner is the first again: (1 - s) (-1/2) + s (-3/4)
        (1.25, 0.0, -0.52587890625),
        (-0.75, 0.0, -0.52587890625),  # the same one, two cells before
        # on the lattice: the size of a feature
        (np.arange(-4.0, 5.0), np.arange(-4.0, 5.0)[:, None], 0.0),
    ],
)
def test_perlin_by_hand(x, y, value):
    """A corner's plane is gradient * (x - corner), and 0 at its corner, where no other counts.

    At the centre of a cell every fade is 1/2, so that the four planes weigh alike. At 1/4 from a
    corner the next one weighs s = fade(1/4) = 0.103515625.
    """
    assert (perlin(*np.broadcast_arrays(x, y), GRADIENTS) == value).all()


# ---- a tile ----


def test_slopes_are_random_unit_vectors(monkeypatch):
    """IV-A.2. 16 x 16 of them, whose mean of a component has a deviation of sqrt(1/2 / 256) =
    0.044.
    """
    seen, real = [], terrain.perlin
    monkeypatch.setattr(terrain, "perlin", lambda *xyg: seen.append(xyg[2]) or real(*xyg))
    tile(rng(), 0.15, 4)
    (gradients,) = seen
    assert np.linalg.norm(gradients, axis=-1) == pytest.approx(np.ones((16, 16)))
    assert np.abs(gradients.mean((0, 1))).max() < 0.2


@pytest.mark.parametrize(("cells_per_m", "points"), [(1, 20), (2, 10), (4, 5), (5, 4), (10, 2)])
def test_feature_size(cells_per_m, points):
    """Points are 0.05 m apart. With 4 cells per metre every fifth is 0 each way, and no other."""
    heights = tile(rng(), 0.15, cells_per_m)
    assert not heights[::points, ::points].any()
    assert np.count_nonzero(heights) == 80 * 80 - (4 * cells_per_m) ** 2


# ---- the ground ----


def test_make_ground():
    """Three tiles in a row along x, 120 x 360 points, each with its own roughness, in that order,
    and its own noise.

    A resumed run and both policies of one find the same ground. Another seed makes another one,
    and so do settings.
    """
    roughness = [0.0, 0.05, 0.15]
    given = dict(seed=0, cells_per_m=4)
    ground = make_ground(roughness, **given)
    assert ground.shape == (120, 360)
    tiles = ground.reshape(120, 3, 120)  # each with its apron
    assert np.ptp(tiles, (0, 2)) == pytest.approx(roughness, rel=1e-12)
    assert np.abs(tiles[:, 2] / 3 - tiles[:, 1]).max() > 0.01
    assert (make_ground(roughness, **given) == ground).all()
    for other in (dict(seed=1), dict(cells_per_m=2)):
        assert (make_ground(roughness, **given | other) != ground)[:, 120:].mean() > 0.9


# ---- places ----


def test_wrap_by_hand():
    """Whole tiles of 4 m are added or taken, until

    6 index + 1 <= x < 6 index + 5
              1 <= y < 5
    """
    xy, index, place = zip(
        ((2.0, 3.0), 0, (2.0, 3.0)),  # inside
        ((1.0, 1.0), 0, (1.0, 1.0)),  # the near edges belong to the tile,
        ((5.0, 5.0), 0, (1.0, 1.0)),  # the far ones are the near ones again
        ((5.25, 2.0), 0, (1.25, 2.0)),  # just past the far edge
        ((0.75, 0.75), 0, (4.75, 4.75)),  # just before the near ones
        ((13.5, 2.0), 0, (1.5, 2.0)),  # three tiles on
        ((2.0, -10.0), 0, (2.0, 2.0)),  # three tiles back
        ((17.25, 0.5), 2, (13.25, 4.5)),  # tile 2 reaches from 13 to 17, both at once
        ((2.0, 2.0), 2, (14.0, 2.0)),  # it is this tile's ground that counts, not the one below
        ((5.25, 2.0), 1, (9.25, 2.0)),  # every robot within its own tile
        strict=True,
    )
    assert wrap(np.array(xy), np.array(index)).tolist() == [list(xy) for xy in place]


@pytest.mark.parametrize(
    ("x", "y", "value"),
    [
        (0.1, 0.0, 4.0),  # two points along x
        (0.025, 0.025, 2.75),  # amid 0, 1, 2, 8
        (0.0875, 0.05, 14.0),  # three quarters from 8 to 16
        (-0.025, 0.075, 2.0),  # beyond the edges it goes on level
    ],
)
def test_height_by_hand(x, y, value):
    """Points are 0.05 m apart, x along a row, y from row to row, and heights linear in between."""
    ground = np.array([[0.0, 1.0, 4.0], [2.0, 8.0, 16.0]])
    assert height(ground, np.array([x, y])) == pytest.approx(value, abs=1e-12)


def test_height_survives_wrap():
    """A robot that is put back finds the ground it was on, wherever on tile or apron it stood."""
    ground, index = make_ground([0.05, 0.15, 0.1], 0, 4), rng().integers(3, size=1000)
    xy = rng(1).uniform(-1.0, 4.9, (1000, 2)) + np.stack([6.0 * index + 1, np.ones(1000)], -1)
    back = wrap(xy, index)
    assert (np.abs(back - xy).max(-1) > 3).mean() > 0.3
    assert height(ground, back) == pytest.approx(height(ground, xy), abs=1e-12)
