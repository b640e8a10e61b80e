"""evaluate.py: the line that it prints for a run folder."""

import shutil

import numpy as np
import pytest
from support import error_of, make_run, rewrite

import evaluate


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return make_run(tmp_path_factory.mktemp("runs") / "run", "rough")


@pytest.fixture
def asked(monkeypatch):
    """Instead of episodes: robot k of them performs at k % 2, at 1 m/s and on 100 W per m/s that it
    was asked for. Peaks are 2 m/s, but for the first robot's. A list of what was asked for.
    """
    seen = []

    def run_episodes(policy, env):
        seen.append((env.env_cfg, env.commands.command))
        k, power = np.arange(env.num_envs), 100 * env.commands.command[:, 0]
        peak = np.where(k, 2.0, 1000.0)
        return evaluate.Episodes(k % 2.0, k % 2.0, np.ones(len(k)), power, peak), None

    monkeypatch.setattr(evaluate, "run_episodes", run_episodes)
    return seen


def test_the_line_of_a_run(folder, asked, capsys):
    """20 episodes become 22, two of each of 11 commands in turn, on the 15 cm of Section V-B. Half
    of them perform at 1, so the mean is 1/2. They draw 0, 10, ... 100 W, 50 in the mean, and 55
    where they are asked to move. One peak of 1000 does not count [D26]. Each command has 0 and 1: a
    variance of 1/2, an error of the mean of sqrt(11 / 4) / 11, and 2.201 of it with 11 degrees of
    freedom are 0.3318.
    """
    assert evaluate.main([str(folder), "--episodes", "20", "--clip", "torque"]) == 0
    head, _, line = capsys.readouterr().out.splitlines()
    row = dict(zip(head.split(" | "), line.split(" | "), strict=True))
    assert (row["score"], row["fell"], row["power"]) == ("0.5", "0.5", "50")
    assert (row["episodes"], row["peak"], row["v_x"], row["J/m |"]) == ("22", "2", "1", "55 |")
    assert (row["95 % from"], row["to"]) == ("0.1682", "0.8318")
    ((env_cfg, commands),) = asked
    assert env_cfg.roughness == (0.15, 0.15) and env_cfg.start_spread == 0.5
    assert (env_cfg.clip, env_cfg.episode_steps) == ("torque", 1000)
    assert commands[:, 0].tolist() == [*np.arange(11) / 10] * 2


def test_all_runs_are_measured_by_one_formula_of_power(asked, tmp_path, capsys):
    """Also the one that learned from the printed clip, unless --clip says so for all of them. Two
    folders of one name are told apart by the way to them.
    """
    torque, power = (make_run(tmp_path / name) for name in "ab")
    rewrite(torque / "policy.npz", clip="torque")
    for flags, clip in (([], "power"), (["--clip", "torque"], "torque")):
        runs = [str(folder) for folder in (torque, power)]
        assert evaluate.main([*runs, "--episodes", "11", *flags]) == 0
        assert [env_cfg.clip for env_cfg, _ in asked[-2:]] == [clip, clip]
        assert [line[:4] for line in capsys.readouterr().out.splitlines()[2:]] == ["| a ", "| b "]
    (tmp_path / "c").mkdir()
    other = shutil.copytree(power, tmp_path / "c" / "b")
    assert evaluate.main([str(power), str(other), "--episodes", "11"]) == 0
    shown = [line.split(" | ")[0] for line in capsys.readouterr().out.splitlines()[2:]]
    assert shown == [f"| {power}", f"| {other}"]


def test_curriculum_is_asked_for_at_most_1_metre_per_second():
    """D32, although it trains many more."""
    asked = evaluate.commands_of("curriculum").tolist()
    assert asked == [[i / 10, 0, 0] for i in range(11)]


def test_no_seed_of_training_draws_what_evaluation_draws():
    """Environments of training have seeds below 2^33, and those of their ground are smaller."""
    assert evaluate.SEED >= 2**33


def test_what_stands_in_the_way_is_one_line(folder, asked, capsys):
    assert "nowhere/policy.npz" in error_of(capsys, evaluate.main, folder, "nowhere")
    assert not asked  # nothing was played before
    assert "--episodes is 0" in error_of(capsys, evaluate.main, folder, "--episodes", "0")


def test_prime_is_the_rival(tmp_path, asked, capsys):
    """Its file is policy_prime.npz, which PPO does not have."""
    folder = make_run(tmp_path / "run")
    assert "policy_prime.npz: No such" in error_of(capsys, evaluate.main, folder, "--prime")
    (folder / "policy.npz").rename(folder / "policy_prime.npz")
    assert evaluate.main([str(folder), "--prime", "--episodes", "11"]) == 0
    assert "policy.npz" in error_of(capsys, evaluate.main, folder)
