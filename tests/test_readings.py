"""lab/readings.py: the readings of the paper that we tried and do not ship."""

import csv
import math

import jax.numpy as jnp
import pytest
from support import ROOT, TINY

import eipo
import ppo
import tasks
import train
from lab import readings

# two samples, streams r and lam f: means 5 and 1, standard deviations 2 and 4, so normalised (1,
# -1) and (-1, 1)
ADVANTAGE = jnp.array([[[7.0, -3.0]], [[3.0, 5.0]]])


pytestmark = pytest.mark.usefixtures("one_compilation", "undrawn")
RUN = [*TINY, "--iterations", "2"]


def rows(folder):
    """The rows of metrics.csv."""
    with (folder / "metrics.csv").open() as file:
        return list(csv.DictReader(file))


def test_normalised_weighs_the_streams_by_alpha_lam():
    """alpha lam = 1/2: 0.5 x 1 - (-1) = 1.5 and 0.5 x (-1) - 1 = -1.5. With lam = 0: 7 and 3 as
    they are.
    """
    assert readings.mix_normalised(ADVANTAGE, 2.0, 0.25).ravel().tolist() == [1.5, -1.5]
    assert readings.mix_normalised(ADVANTAGE, math.inf, 0).ravel().tolist() == [7, 3]


def test_fixed_weighs_the_streams_whatever_alpha_and_lam_are():
    """1.5 x 1 - (-1) = 2.5 and -2.5."""
    assert readings.mix_fixed(ADVANTAGE, 2.0, 0.25).ravel().tolist() == [2.5, -2.5]


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Trains with `readings FLAGS` in this process, which changes modules only until the test
    ends; returns the rows of metrics.csv.
    """
    monkeypatch.setattr(eipo, "eipo", eipo.eipo)
    monkeypatch.setattr(eipo, "ppo", eipo.ppo)

    def trained(*flags):
        assert readings.main(flags[0], [*flags[1:], *RUN, "--out", str(tmp_path / "run")]) == 0
        return rows(tmp_path / "run")

    return trained


def test_noisy_trains_with_a_floor_under_the_noise(monkeypatch):
    """Its standard deviation, so the exponential of the range's lower end, is 0.6 while training.
    test_algorithm1_line09_ppo_keeps_the_noise_in_its_range shows that the range is kept.
    """
    monkeypatch.setattr(ppo, "LOG_STD_RANGE", ppo.LOG_STD_RANGE)
    monkeypatch.setattr(train, "main", lambda argv: (argv, ppo.LOG_STD_RANGE))
    argv, (low, high) = readings.main("noisy", ["--seed", "1"])
    assert (argv, high) == (["--seed", "1"], 1.0) and math.exp(low) == pytest.approx(0.6)


def test_own_curricula_are_two():
    """The usual environments hold one array of weights, and those of this reading hold two, 1.8 %
    of each at first.
    """
    env_cfg, cfg = tasks.task_config("curriculum", roughness=(0.0, 0.0)), eipo.Config(num_envs=4)
    shared = [env.state.command_weights for env in train.make_envs(env_cfg, cfg, 1)]
    own = [
        env.state.command_weights
        for env in readings.with_own_commands(train.make_envs)(env_cfg, cfg, 1)
    ]
    assert shared[0] is shared[1] and own[0] is not own[1]
    assert [weights.sum() for weights in own] == [16, 16]


def test_exchange_weighs_what_it_borrows(here):
    """A weight is min(1, ratio of probabilities), so its mean is in (0, 1]. Both policies are new:
    it is not yet 0.
    """
    assert all(0 < float(row["borrowed"]) <= 1 for row in here("exchange"))


def test_yoked_takes_alpha_from_another_run(here, tmp_path):
    """The other run has alpha 100 in iteration 1 and 300 in iteration 3, so iteration 2 has 200.

    A run of results/ is found by its name there, with every tenth iteration. Its alpha starts at
    1 / 0.01 = 100 and moves by less than 10 in the first ten, see D38.
    """
    leader = tmp_path / "leader"
    leader.mkdir()
    (leader / "metrics.csv").write_text("iteration,alpha\n1,100\n3,300\n")
    led = here("yoked", str(leader), "--algo", "ppo", "--lam", "0.5")
    assert [float(row["alpha"]) for row in led] == [100, 200]
    kept = ROOT / "results" / "velocity" / "binding1000-eipo-lam0.01-seed0"
    iterations, alphas = readings.alpha_of(kept)
    assert iterations[0] == 10 and iterations[-1] == 1000 and 100 <= alphas[0] < 110


def test_an_unknown_reading_is_named(capsys):
    assert readings.main("fxied", []) == 2
    assert "unknown reading 'fxied'" in capsys.readouterr().err
