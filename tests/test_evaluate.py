"""evaluate.py: the line that it prints for a run folder."""

import sys

import numpy as np
import pytest
from support import error_of, make_run

import evaluate


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return make_run(tmp_path_factory.mktemp("runs") / "run", "rough")


@pytest.fixture
def asked(monkeypatch):
    """Instead of episodes: robot k of them performs at k % 2. A list of what was asked for."""
    seen = []

    def run_episodes(policy, env, commands):
        seen.append((env.env_cfg, commands))
        columns = [np.arange(env.num_envs) % 2.0] * len(evaluate.Episodes._fields)
        return evaluate.Episodes(*columns)

    monkeypatch.setattr(evaluate, "run_episodes", run_episodes)
    return seen


def test_the_line_of_a_run(folder, asked, capsys):
    """11 commands, 22 of 25 episodes: half of them perform at 1, so the mean is 1/2. From random
    starts, then from nominal ones, on the 15 cm of Section V-B.
    """
    assert evaluate.main([str(folder), "--episodes", "25"]) == 0
    head, _, line = capsys.readouterr().out.splitlines()
    row = dict(zip(head.split(" | "), line.split(" | "), strict=True))
    mean, low, high = row["performance"].replace("[", "").replace("]", "").replace(",", "").split()
    assert float(mean) == 0.5 and 0.2 < float(low) < 0.5 < float(high) < 0.8
    assert (row["fell"], row["power [W]"], row["v_x at 0.1"]) == ("0.5", "0.5", "0.5")
    assert [env_cfg.start_spread for env_cfg, _ in asked] == [0.5, 0.0]
    assert all(env_cfg.roughness == (0.15, 0.15) for env_cfg, _ in asked)
    assert asked[0][1][:, 0].tolist() == np.repeat(np.arange(11) / 10, 2).tolist()


def test_flags_reach_the_world(folder, asked):
    argv = [str(folder), "--episodes", "11", "--clip", "torque", "--roughness", "0.03"]
    assert evaluate.main(argv) == 0
    assert {(c.clip, c.roughness, c.episode_steps) for c, _ in asked} == {
        ("torque", (0.03, 0.03), 1000)
    }


def test_interval_of_a_mean():
    """0 and 1 alike: the mean of 400 has a standard deviation of 1/40, so 95 % are 0.45 to 0.55.
    One episode has no interval.
    """
    low, high = evaluate.interval([np.arange(400) % 2.0])
    assert (low, high) == (pytest.approx(0.451, abs=0.01), pytest.approx(0.549, abs=0.01))
    assert np.isnan(evaluate.interval(np.ones((1, 1)))).all()


def test_progress_is_for_terminals(folder, monkeypatch, capsys):
    """Two steps are halves. A log file would fill with it."""
    for shown in (True, False):
        monkeypatch.setattr(sys.stderr, "isatty", lambda shown=shown: shown)
        monkeypatch.setattr(evaluate, "EPISODE_STEPS", 2)
        policy, env = evaluate.load(folder, 1)
        list(evaluate.play_episode(policy, env))
        said = capsys.readouterr().err
        assert said == ("50% played\x1b[K\r100% played\x1b[K\r" if shown else "")


@pytest.mark.parametrize("episodes", ["0", "1000000"])
def test_too_few_or_too_many_episodes_are_one_line(folder, capsys, episodes):
    with pytest.raises(SystemExit):
        evaluate.main([str(folder), "--episodes", episodes])
    (said,) = capsys.readouterr().err.splitlines()
    assert f"--episodes is {episodes}" in said


def test_what_is_no_run_folder_is_one_line_before_anything_is_played(folder, asked, capsys):
    assert "nowhere/policy.npz" in error_of(capsys, evaluate.main, folder, "nowhere")
    assert not asked


def test_ctrl_c_is_no_traceback(folder, monkeypatch):
    """Evaluating takes minutes. 130 is the shell's status for it, 128 + SIGINT's 2."""

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(evaluate, "run_episodes", interrupted)
    assert evaluate.main([str(folder)]) == 130


def test_prime_is_the_rival(tmp_path, asked, monkeypatch, capsys):
    """Its file is policy_prime.npz, which PPO does not have."""
    folder = make_run(tmp_path / "run")
    assert "policy_prime.npz" in error_of(capsys, evaluate.main, folder, "--prime")
    (folder / "policy.npz").rename(folder / "policy_prime.npz")
    assert evaluate.main([str(folder), "--prime", "--episodes", "11"]) == 0
    assert "policy.npz" in error_of(capsys, evaluate.main, folder)
