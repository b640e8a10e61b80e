"""Sections IV-D and V: what is counted in the episodes of a scripted robot, and statistics whose
values are known.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support import frames

import evaluate
import tasks


class Scripted:
    """A stand-in for Go1Env: three robots whose every step is known. Robot 1 falls in step 3, robot
    2 hardly gets on, and falls in the last step.

    20 steps, v_x of robot 0 is 1, 2, 3, ... 20 m/s, of robot 1 always 2, of robot 2 three times
    17/16 and then -3, so 3/64 in the mean; power 8 W times the number of the robot plus 1; reward
    0.5. After robot 1's fall the next episode has begun: nothing of its 64 counts.
    """

    num_envs, env_cfg = 3, SimpleNamespace(episode_steps=20)

    def reset(self, seed):
        assert seed == evaluate.SEED
        self.t = 0
        return np.zeros((3, 1)), {}

    def step(self, action):
        self.t += 1
        back_and_forth = 17 / 16 if self.t % 4 else -3.0
        speed, power = [self.t, 2.0, back_and_forth], [8.0, 16.0, 24.0]
        log = dict(v_x=speed, power=power)
        over = np.array([False, self.t > 3, False])
        log = {name: np.where(over, 64.0, x) for name, x in log.items()}
        terminated = np.array([False, self.t == 3, self.t == 20])
        truncated = np.array([self.t == 20, False, False])
        return np.zeros((3, 1)), np.where(over, 64.0, 0.5), terminated, truncated, dict(log=log)


@pytest.fixture(scope="module")
def episodes():
    return evaluate.run_episodes(lambda obs: obs, Scripted())


def test_score_counts_early_ends_as_zeros(episodes):
    """Section V-A divides the sum of rewards by the greatest length of an episode, there 1000 steps
    and here 20: 20 * 0.5 / 20 = 0.5. Robot 1 has three steps, 3 * 0.5 / 20 = 0.075. Robot 2 falls
    in the last step and loses nothing.
    """
    measured, _ = episodes
    assert measured.score.tolist() == [0.5, 0.075, 0.5]
    assert measured.fell.tolist() == [False, True, True]


def test_velocity_and_power_are_of_the_first_episode(episodes):
    """D18. Robot 0: (1 + ... + 20) / 20 = 10.5 m/s and 8 W, and 20 m/s at most; robot 1: 2 m/s and
    16 W, and no speed after its fall. Robot 2 is fastest when it goes back, which is no peak.
    """
    measured, v_x = episodes
    assert measured.v_x.tolist() == [10.5, 2.0, 3 / 64]
    assert measured.peak.tolist() == [20.0, 2.0, 17 / 16]
    assert measured.power.tolist() == [8.0, 16.0, 24.0]
    assert v_x[:3, 1].tolist() == [2.0] * 3 and np.isnan(v_x[3:, 1]).all()


def test_energy_per_metre_is_the_ratio_of_means():
    """D27. (100 + 500) W / (1 + 3) m/s = 150 J/m. The mean of ratios is (100 + 167) / 2 = 133."""
    power, v_x = np.array([100.0, 500.0]), np.array([1.0, 3.0])
    assert evaluate.energy_per_metre(power, v_x) == 150
    assert evaluate.energy_per_metre([power, power], [v_x, 2 * v_x]).tolist() == [150, 75]


@pytest.mark.parametrize(
    ("v_x", "energy"), [(1 / 16, 384), (3 / 64, np.inf), (-1 / 16, 384), (-1 / 64, np.inf)]
)
def test_energy_per_metre_needs_robots_that_move(v_x, energy):
    """D27. They stand at 3/64 = 0.047 m/s, and move at 1/16 = 0.0625 m/s: 24 W / (1/16 m/s) = 384
    J/m, ahead or backwards.
    """
    assert evaluate.energy_per_metre([24, 24], [v_x - 1, v_x + 1]) == energy


def test_the_world_that_is_measured():
    """D25, D32. 20 s of one command, the paper's reward over ground, our clip, ground of its own;
    the rest as in training.
    """
    usual = dict(noise=0.5, start_spread=0.25)
    other = dict(reward="shaped", velocity_frame="body", stagger=True, ground_seed=7, clip="torque")
    length = dict(episode_steps=1000, command_steps=1000)
    trained = tasks.task_config(
        "curriculum", episode_steps=300, command_steps=100, **usual, **other
    )
    measured = dict(reward="paper", velocity_frame="heading", stagger=False)
    measured |= dict(ground_seed=evaluate.SEED, clip="power")
    world = tasks.task_config("curriculum", **usual, **measured, **length)
    assert evaluate.evaluation_config(trained) == world
    asked = replace(world, clip="torque", start_spread=0.0)
    assert evaluate.evaluation_config(trained, "torque", nominal=True) == asked


def test_commands_are_kept_and_seen_from_the_first_frame():
    """Robot 0 is asked for 0.25 m/s, robot 1 for 0.75, in all three observations (scale 2)."""
    world = tasks.task_config(episode_steps=3, command_steps=3, noise=0.0, stagger=False)
    env, seen = evaluate.make_env(world, [[0.25, 0, 0], [0.75, 0, 0]]), []

    def act(obs):
        seen.append(frames(obs)[:, :, 3])
        return np.zeros((2, 12))

    evaluate.run_episodes(act, env)
    assert np.array(seen).tolist() == [[[0.5] * 5, [1.5] * 5]] * 3
    assert env.state.command[:, 0].tolist() == [0.25, 0.75]


def test_iqm_by_hand():
    """Of 0 to 7 the middle half is 2, 3, 4, 5: 3.5; the outlier 1000 is not in it. Of 0^2 ... 99^2:
    25^2 ... 74^2.
    """
    for greatest in (7.0, 1000.0):
        assert evaluate.iqm(np.array([greatest, 1, 2, 3, 4, 5, 6, 0])) == 3.5
    assert evaluate.iqm(np.arange(100.0) ** 2) == 2658.5


def test_an_interval_leaves_out_how_far_commands_lie_apart():
    """Of 0 and 2 the variance is 2, of 10 and 10 it is 0: an error of sqrt(2 / 2) / 2. Student's t
    of two degrees of freedom is 4.3027. One episode of a command has no interval.
    """
    low, high = evaluate.interval(np.array([[0.0, 10.0], [2.0, 10.0]]))
    assert (low, high) == pytest.approx((5.5 - 2.15135, 5.5 + 2.15135), abs=1e-4)
    assert np.isnan(evaluate.interval(np.ones((1, 11)))).all()
