"""Section IV-A.4: the commands that grow with what the robot can do, cell by cell."""

import numpy as np
import pytest
from support import NOSE_UP, place, quiet, still

from tasks import Grid


def grid(weights):
    """A Grid whose weights are 0 but for some cells: {cell: weight}."""
    commands = Grid()
    commands.weights[:] = 0.0
    for cell, weight in weights.items():
        commands.weights[cell] = weight
    return commands


def draw(commands, n):
    """n commands."""
    return commands.draw(np.random.default_rng(0), np.arange(n))


def centre(cell):
    """The command (v_x, 0, yaw rate) in the middle of a cell of 0.5, from -1 m/s and -10 rad/s."""
    return [-1 + 0.5 * (cell[0] + 0.5), 0.0, -10 + 0.5 * (cell[1] + 0.5)]


def test_start_is_within_one_metre_and_one_radian_per_second():
    """x cells 0 to 3 and yaw cells 18 to 21 lie within [-1, 1], 16 cells of 880."""
    weights = Grid().weights
    assert weights.shape == (22, 40)
    assert (weights[:4, 18:22] == 1).all() and weights.sum() == 16


@pytest.mark.parametrize(
    "weight, cells, corner, after",
    [
        (0.0, [(10, 20)], (9, 19), [[0.2, 0.2, 0.2], [0.2, 0.4, 0.2], [0.2, 0.2, 0.2]]),
        (0.0, [(21, 39)], (20, 38), [[0.2, 0.2], [0.2, 0.4]]),
        (0.5, [(0, 0), (0, 0)], (0, 0), [[1.0, 0.4], [0.4, 0.4]]),
    ],
    ids=["amid", "in a corner", "two in a corner, from 0.5"],
)
def test_a_success_by_hand(weight, cells, corner, after):
    """A success adds 0.2 to the 3 x 3 cells around its command, and another 0.2 to the cell itself:
    0.4 amid 0.2.

    Two count twice, nothing grows out at the other side, and weights stop at 1. A failure, here in
    the cell (5, 5), gives nothing.
    """
    commands, expected = grid({cells[0]: weight}), grid({}).weights
    rows, columns = (slice(start, start + len(after)) for start in corner)
    expected[rows, columns] = after
    command = np.array([centre(cell) for cell in (*cells, (5, 5))])
    kernels = np.array([[0.9, 0.9]] * len(cells) + [[0.1, 0.9]])
    commands.record(command, kernels)
    assert commands.weights == pytest.approx(expected)


@pytest.mark.parametrize(
    ("linear", "angular", "success"),
    [(0.81, 0.51, True), (0.8, 0.9, False), (0.9, 0.5, False)],
)
def test_success_needs_both(linear, angular, success):
    """More than 0.8 of the linear and more than 0.5 of the angular kernel [lab code]."""
    commands = grid({})
    commands.record(np.array([centre((10, 20))]), np.array([[linear, angular]]))
    assert commands.weights.any() == success


@pytest.mark.parametrize(
    ("frame", "expected"), [("heading", [1, np.exp(-1)]), ("body", [np.exp(-1), 1])]
)
def test_success_is_in_the_frame_that_is_rewarded(frame, expected):
    """D25. Nose up by 60 degrees, 1 m/s and 1 rad/s over ground, where 1 m/s and 1/2 rad/s are
    asked. In the body frame both are cos 60 = 1/2 of it. Half too much or too little is
    exp(-0.5^2 / 0.25) = 1/e. What was asked is recorded, not what is asked next. Of 880 cells 16
    have the weight 1.
    """
    env, seen = quiet(1, velocity_frame=frame, command_steps=1), []
    env.commands.record = lambda command, kernels: seen.extend([*command, *kernels])
    place(env, **NOSE_UP)
    env.state.command[:] = 1.0, 0.0, 0.5
    info = still(env)[4]
    command, kernels = seen
    assert command.tolist() == [1, 0, 0.5]
    assert kernels == pytest.approx(expected, abs=1e-4)
    assert info["log"]["command_area"] == pytest.approx([16 / 880])


@pytest.mark.parametrize(
    ("steps", "every", "heard"),
    [(4, 6, [4]), (6, 4, [4, 6]), (8, 4, [4, 8])],
)
def test_success_counts_the_time_that_there_was(steps, every, heard):
    """A robot that does what is asked has kernels of 1 in each step. Episodes of `steps` steps, a
    command every `every` of them: the mean is over the steps that a command was to last, 4 of 6, or
    the last 2 of 6. Where a command and an episode end together nothing is left to count.
    """
    env = quiet(1, episode_steps=steps, command_steps=every)
    env.commands.record = lambda _, kernels: seen.extend(kernels)
    for step in range(1, steps + 1):
        seen = []
        env.state.command[:] = 0.0
        still(env)
        expected = [pytest.approx([1.0, 1.0])] * (step in heard)
        assert [x for x in seen if x.any()] == expected


def test_success_after_a_fall_counts_what_was_planned():
    """Three perfect steps of four, in the last of which the trunk touches the ground: 3/4."""
    env, seen = quiet(1, episode_steps=8, command_steps=4), []
    env.state.command[:] = 0.0
    still(env, 2)
    env.commands.record = lambda _, kernels: seen.extend(kernels)
    env.contacts = np.ones((1, 17))
    assert still(env)[2].all()
    assert seen == [pytest.approx([0.75, 0.75])]


def test_a_command_that_the_first_age_cut_short_does_not_count():
    """With random first ages the first command is a success only where its stretch is whole. From
    the second one on all count.
    """
    env, seen = quiet(64, episode_steps=8, command_steps=4, stagger=True), []
    env.reset(0)
    whole = env.state.age % 4 == 0
    assert 0 < whole.sum() < 64
    env.commands.record = lambda command, kernels: seen.append(kernels)
    for _ in range(8):
        place(env)
        env.state.command[:] = 0.0
        still(env)
    successes = (np.vstack(seen) == 1).all(1).sum()
    # in eight steps each robot's second command ends once, and the first one of `whole`, too
    assert successes == 64 + whole.sum()


def test_commands_come_from_their_cells():
    """The cell (6, 30) has v_x in [2, 2.5] and yaw rate in [5, 5.5]. v_y is in all of [-0.6, 0.6].

    The three are drawn one by one, so that they are not correlated. By chance alone 1000 draws have
    correlations of about 0.03; 0.16 is five times that.
    """
    command = draw(grid({(6, 30): 0.2}), 1000)
    assert len(np.unique(command)) == 3000
    low, high = np.array([2.0, -0.6, 5.0]), np.array([2.5, 0.6, 5.5])
    assert (low <= command.min(0)).all() and (command.min(0) < low + 0.01).all()
    assert (high >= command.max(0)).all() and (command.max(0) > high - 0.01).all()
    assert np.abs(np.corrcoef(command.T) - np.eye(3)).max() < 0.16


def test_commands_are_drawn_in_proportion_to_the_weights():
    """Weights 1 and 0.25: of 5000 commands 4000 come from the first cell, with v_x from 4 to 4.5,
    give or take 140 (5 sigma), the others from 5 to 5.5.
    """
    v_x = draw(grid({(10, 20): 1.0, (12, 22): 0.25}), 5000)[:, 0]
    first, second = ((v_x >= low) & (v_x <= low + 0.5) for low in (4, 5))
    assert abs(first.sum() - 4000) < 140
    assert (first | second).all()


def test_small_planar_commands_are_zero():
    """v_x from 0 to 0.5. Where (v_x, v_y) is shorter than 0.2 m/s both are 0, the yaw rate not."""
    command = draw(grid({(2, 20): 1.0}), 2000)
    speed = np.linalg.norm(command[:, :2], axis=1)
    assert (speed == 0).any() and (command[:, 2] > 0).all()
    assert 0.2 <= speed[speed > 0].min() < 0.21
    assert (command[speed > 0, 0] < 0.2).any()  # what counts is the length of both
