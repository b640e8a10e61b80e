"""The command line and the run folder: whatever stops a run, its numbers come out the same."""

import json
import shlex
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from support import DAMAGES, ROOT, TINY, contents, error_of

import evaluate
import measure
import run_folder
import train

FLAGS = [*TINY, "--checkpoint-every", "4"]


def run(*flags):
    """Train in this process, two iterations unless told otherwise."""
    assert train.main([*FLAGS, "--iterations", "2", *map(str, flags)]) == 0


def resume(folder, *flags):
    assert train.main(["--out", str(folder), "--resume", *map(str, flags)]) == 0


def rows(folder):
    """metrics.csv without the columns that hold clock time."""
    lines = [line.split(",") for line in (folder / "metrics.csv").read_text().splitlines()]
    keep = [i for i, name in enumerate(lines[0]) if "time" not in name and "per_s" not in name]
    return [[line[i] for i in keep] for line in lines]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run of 20 iterations that nobody disturbed."""
    folder = tmp_path_factory.mktemp("finished") / "run"
    run("--iterations", 20, "--out", folder)
    return folder


def start_and_wait(folder, iterations=20, until=5):
    """Start the same run as a process of its own; returns it when metrics.csv holds `until` iterations."""
    flags = [*FLAGS, "--iterations", str(iterations), "--out", str(folder)]
    process = subprocess.Popen([sys.executable, ROOT / "train.py", *flags], stdout=subprocess.PIPE, text=True)
    metrics = folder / "metrics.csv"
    while not metrics.exists() or metrics.read_text().count("\n") < until + 1:
        assert process.poll() is None, "the run ended before it could be stopped"
        time.sleep(0.002)
    return process


def test_two_iterations_fill_the_run_folder(tmp_path):
    """`python train.py` from another folder, as a user would: every promised file is there and says what it should."""
    command = [sys.executable, ROOT / "train.py", *FLAGS, "--task", "flat", "--iterations", "2", "--out", "mine"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert set(contents(tmp_path / "mine")) == {
        "config.json",
        "metrics.csv",
        "checkpoint.npz",
        "policy.npz",
        "curves.png",
    }
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()
    assert [row[0] for row in rows(tmp_path / "mine")] == ["iteration", "1", "2"]
    record = json.loads((tmp_path / "mine" / "config.json").read_text())
    assert (record["learner"]["iterations"], record["learner"]["lam"], record["env"]["history"]) == (2, 0.005, 2)
    (start,) = record["starts"]
    assert "--iterations 2" in start["command"] and start["versions"]["mujoco"]


def test_equal_seeds_equal_runs_with_any_number_of_threads(finished, tmp_path):
    run("--iterations", 3, "--threads", 2, "--out", tmp_path / "same")
    assert rows(tmp_path / "same") == rows(finished)[:4]
    run("--iterations", 3, "--seed", 1, "--out", tmp_path / "other")
    assert rows(tmp_path / "other")[3] != rows(finished)[3]


def test_kill_9_and_resume_equals_a_run_that_was_never_stopped(finished, tmp_path):
    process = start_and_wait(tmp_path)
    process.kill()
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    run("--iterations", 20, "--out", tmp_path, "--resume")
    assert rows(tmp_path) == rows(finished)


def test_ctrl_c_saves_and_its_last_line_says_how_to_go_on(finished, tmp_path):
    process = start_and_wait(tmp_path)
    process.send_signal(signal.SIGINT)
    said = process.communicate()[0].splitlines()[-1]
    assert process.returncode == 130
    saved = len(rows(tmp_path)) - 1
    assert 5 <= saved < 20 and f"iteration {saved}." in said
    assert train.main(shlex.split(said.split("python train.py ")[1])) == 0
    assert rows(tmp_path) == rows(finished)


@pytest.mark.parametrize(
    "flags",
    [
        ["--algo", "ppo"],
        ["--algo", "ppo", "--lam", "0"],
        ["--lam", "0.02", "--clip", "power"],
        ["--task", "rough", "--episode-steps", "8"],  # on other ground than the seed's by the time of the checkpoint
        ["--task", "velocity", "--roughness", "0.01", "0.02"],
    ],
    ids=" ".join,
)
def test_resume_with_more_iterations_equals_one_long_run(tmp_path, flags):
    run(*flags, "--iterations", 6, "--out", tmp_path / "long")
    run(*flags, "--iterations", 3, "--out", tmp_path / "short")
    resume(tmp_path / "short", "--iterations", 6)
    assert rows(tmp_path / "short") == rows(tmp_path / "long")
    assert run_folder.load_config(tmp_path / "short") == run_folder.load_config(tmp_path / "long")
    starts = json.loads((tmp_path / "short" / "config.json").read_text())["starts"]
    assert ["--resume" in start["command"] for start in starts] == [False, True]


def test_metrics_are_read_as_columns(tmp_path):
    """Two rows of two columns; a last row without its second number, as a full disk would leave it; no row yet."""
    (tmp_path / "metrics.csv").write_text("iteration,reward\n1,0.5\n2,0.75\n3\n")
    columns = run_folder.read_metrics(tmp_path)
    assert list(columns) == ["iteration", "reward"] and columns["iteration"].tolist() == [1.0, 2.0, 3.0]
    assert columns["reward"][:2].tolist() == [0.5, 0.75] and np.isnan(columns["reward"][2])
    (tmp_path / "metrics.csv").write_text("")
    assert run_folder.read_metrics(tmp_path) == {}


@pytest.mark.parametrize(
    "flags, says",
    [
        (["--resume", "--lr", 0.1], "--lr"),
        (["--resume", "--iterations", 4], "--iterations"),
        (["--resume", "--seed", 3], "--seed"),
        (["--resume", "--noise", 0.5], "--noise"),
        (["--iterations", 20], "--resume"),
    ],
)
def test_a_run_is_never_overwritten_and_keeps_its_settings(finished, capsys, flags, says):
    before = contents(finished)
    assert says in error_of(capsys, train.main, "--out", finished, *flags)
    assert contents(finished) == before


def other_network(path):
    """The same checkpoint with one array of another shape."""
    arrays = run_folder.read_npz(path)
    np.savez(path, **arrays | {next(name for name in arrays if "actor" in name): np.ones((2, 2))})


@pytest.mark.parametrize(
    "file, damage",
    [
        *((file, damage) for file in ("checkpoint.npz", "config.json") for damage in DAMAGES.values()),
        ("checkpoint.npz", other_network),
        ("metrics.csv", lambda path: path.write_text("iteration\n")),  # the checkpoint is of a longer run
        ("config.json", lambda path: path.write_text("{")),
    ],
)
def test_what_cannot_be_resumed_is_one_line_and_loses_nothing(tmp_path, capsys, finished, file, damage):
    for name, content in contents(finished).items():
        (tmp_path / name).write_bytes(content)
    damage(tmp_path / file)
    before = contents(tmp_path)
    assert str(tmp_path) in error_of(capsys, train.main, "--out", tmp_path, "--resume")
    assert contents(tmp_path) == before


def test_an_unwritable_folder_is_one_line(tmp_path, capsys):
    (tmp_path / "file").write_text("in the way")
    assert "file" in error_of(capsys, train.main, *TINY, "--out", tmp_path / "file" / "run")


def test_a_crash_while_writing_keeps_the_old_file(tmp_path):
    path = tmp_path / "a.txt"
    run_folder.replace_file(path, lambda file: file.write(b"old"))

    def fail(file):
        file.write(b"ne")
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        run_folder.replace_file(path, fail)
    assert path.read_bytes() == b"old"


def test_evaluate_prints_a_row_per_run_and_one_line_for_a_folder_that_is_none(finished, tmp_path, capsys, monkeypatch):
    """An untrained policy scores between nothing and everything; what is no run folder is one line."""
    monkeypatch.setattr(measure, "EPISODE_STEPS", 16)
    params, env_cfg = run_folder.load_policy(finished / "policy.npz")
    assert env_cfg.history == 2 and params["actor"]["layers"][0][0].shape == (91, 8)
    assert evaluate.main([str(finished), "--episodes", "11", "--clip", "power"]) == 0
    header, _, row = capsys.readouterr().out.splitlines()
    head, cells = ([x.strip() for x in line.split("|")[1:-1]] for line in (header, row))
    assert 0 < float(dict(zip(head, cells, strict=True))["performance"]) < 1.5
    error_of(capsys, evaluate.main, tmp_path)


def test_pi_and_pi_prime_share_one_curriculum(monkeypatch, tmp_path):
    """D23: else the better policy would get the harder commands, and J(pi) - J(pi') would compare two tasks."""
    made = []
    environment = train.go1_env.Go1Env
    monkeypatch.setattr(train.go1_env, "Go1Env", lambda *x: made.append(environment(*x)) or made[-1])
    run("--task", "curriculum", "--out", tmp_path / "run")
    env, env_prime, *_ = made  # and one for the trace of each policy that is saved
    env_prime.state.cell[:], env_prime.state.tracked[:] = [3, 21], 1000.0  # a success in the corner of the first region
    env_prime._draw_commands(np.array([0]))
    assert env.state.weights[4, 22] == pytest.approx(0.2)
    assert (tmp_path / "run" / "commands.png").stat().st_size > 1000
