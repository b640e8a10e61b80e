"""Section IV-A.4: the command curriculum, cell by cell."""

import numpy as np
import pytest

import curriculum


def rng():
    return np.random.default_rng(0)


def grid(weights, shape=(22, 40)):
    """Weights that are 0 but for some cells: {cell: weight}."""
    result = np.zeros(shape)
    for cell, weight in weights.items():
        result[cell] = weight
    return result


def test_start_is_within_one_metre_and_one_radian_per_second():
    """Cells of 0.5 from -1 and from -10: x cells 0 to 3 and yaw cells 18 to 21 lie within [-1, 1];
    16 of 880.
    """
    weights = curriculum.initial_weights()
    assert weights.shape == (22, 40) and weights.sum() == 16 and (weights[:4, 18:22] == 1).all()


@pytest.mark.parametrize(
    "weights, successes, after",
    [
        ({}, [(1, 1)], [[0.2, 0.2, 0.2], [0.2, 0.4, 0.2], [0.2, 0.2, 0.2]]),
        ({(0, 0): 0.5}, [(0, 0), (0, 0)], [[1.0, 0.4, 0.0], [0.4, 0.4, 0.0], [0.0, 0.0, 0.0]]),
        ({}, [(2, 2)], np.pad([[0.2, 0.2, 0.2], [0.2, 0.4, 0.2], [0.2, 0.2, 0.2]], 1)),
    ],
    ids=["amid", "in a corner", "far from an edge"],
)
def test_update_by_hand(weights, successes, after):
    """A success in the middle of 3 x 3: 0.2 for its cell and 0.2 for all nine, so 0.4 amid 0.2. A
    failure is nothing.

    Two in one corner count twice, nothing grows out at the other side, and weights stop at 1.
    """
    cell, success = np.array([*successes, (2, 2)]), np.array([True] * len(successes) + [False])
    assert curriculum.update(grid(weights, np.shape(after)), cell, success) == pytest.approx(
        np.array(after)
    )


@pytest.mark.parametrize(
    ("linear", "angular", "success"),
    [(0.81, 0.51, True), (0.8, 0.9, False), (0.9, 0.5, False), (0.5, 0.9, False)],
)
def test_success_needs_both(linear, angular, success):
    """More than 0.8 of the linear and more than 0.5 of the angular kernel [lab code]."""
    assert curriculum.succeeded(np.array([linear]), np.array([angular])).tolist() == [success]


def test_commands_come_from_their_cells():
    """A single cell (6, 30) has v_x in [2, 2.5] and yaw rate in [5, 5.5]; v_y is in all of [-0.6,
    0.6].

    The three are drawn one by one, so that they are not correlated: 1000 draws are, by chance, by
    0.03 (5 sigma 0.16).
    """
    command, cell = curriculum.sample(grid({(6, 30): 0.2}), rng(), 1000)
    assert (cell == [6, 30]).all() and len(np.unique(command)) == 3000
    assert (command.min(0) >= [2.0, -0.6, 5.0]).all() and (command.max(0) <= [2.5, 0.6, 5.5]).all()
    assert (command.min(0) < [2.01, -0.59, 5.01]).all() and (
        command.max(0) > [2.49, 0.59, 5.49]
    ).all()
    assert np.abs(np.corrcoef(command.T) - np.eye(3)).max() < 0.16


def test_commands_are_drawn_in_proportion_to_the_weights():
    """Weights 1 and 0.25: four of five commands come from the first cell, 4000 of 5000 give or take
    140 (5 sigma).
    """
    _, cell = curriculum.sample(grid({(10, 20): 1.0, (12, 22): 0.25}), rng(), 5000)
    assert (
        abs((cell == [10, 20]).all(1).sum() - 4000) < 140 and (cell == [12, 22]).all(1).sum() > 800
    )


def test_small_planar_commands_are_zero():
    """Cell x in [0, 0.5]: below 0.2 m/s both planar components are 0 and the yaw rate is kept."""
    command, _ = curriculum.sample(grid({(2, 20): 1.0}), rng(), 2000)
    speed = np.linalg.norm(command[:, :2], axis=1)
    assert (
        ((speed == 0) | (speed >= 0.2)).all() and (speed == 0).any() and (command[:, 2] > 0).all()
    )
    assert 0.2 <= speed[speed > 0].min() < 0.21
    assert (command[speed > 0, 0] < 0.2).any()  # what counts is the length of both


def test_perfect_tracking_fills_the_grid_and_failure_keeps_it():
    """From its 16 cells the region reaches all of 22 x 40 if everything succeeds, and nothing more
    if nothing does.
    """
    grown = kept = curriculum.initial_weights()
    draws = rng()
    for _ in range(150):
        _, cell = curriculum.sample(grown, draws, 256)
        grown = curriculum.update(grown, cell, np.ones(256, bool))
        kept = curriculum.update(kept, cell, np.zeros(256, bool))
    assert grown.min() == grown.max() == 1 and (kept == curriculum.initial_weights()).all()
