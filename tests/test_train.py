"""The command line and the run folder: whatever stops a run, its numbers come out the same."""

import json
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import evaluate
import run_folder
import train

ROOT = Path(train.__file__).parent
TINY = ["--num-envs", "4", "--num-steps", "4", "--hidden", "8", "--hidden-estimator", "8", "--history", "2",
        "--checkpoint-every", "4"]  # fmt: skip


def run(*flags):
    """Train in this process; returns the exit status. Two iterations unless told otherwise."""
    return train.main([*TINY, "--iterations", "2", *map(str, flags)])


def error_of(capsys, *flags):
    """The one line that a failing command prints; a resumed one is given nothing else, any other is tiny."""
    assert (train.main(list(map(str, flags))) if "--resume" in flags else run(*flags)) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("train.py: ")
    return line


def rows(folder):
    """metrics.csv without the columns that hold clock time."""
    lines = [line.split(",") for line in (folder / "metrics.csv").read_text().splitlines()]
    keep = [i for i, name in enumerate(lines[0]) if "time" not in name and "per_s" not in name]
    return [[line[i] for i in keep] for line in lines]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run of 20 iterations that nobody disturbed."""
    folder = tmp_path_factory.mktemp("finished") / "run"
    assert run("--iterations", 20, "--out", folder) == 0
    return folder


def start_and_wait(folder, iterations=20, until=5):
    """Start the same run as a process of its own; returns it when metrics.csv holds `until` iterations."""
    flags = [*TINY, "--iterations", str(iterations), "--out", str(folder)]
    process = subprocess.Popen([sys.executable, ROOT / "train.py", *flags], stdout=subprocess.PIPE, text=True)
    metrics = folder / "metrics.csv"
    while not metrics.exists() or metrics.read_text().count("\n") < until + 1:
        assert process.poll() is None, "the run ended before it could be stopped"
        time.sleep(0.002)
    return process


def test_two_iterations_fill_the_run_folder(tmp_path):
    """`python train.py` from another folder, as a user would: every promised file is there and says what it should."""
    command = [sys.executable, ROOT / "train.py", *TINY, "--task", "flat", "--iterations", "2", "--out", "mine"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    names = {"config.json", "metrics.csv", "checkpoint.npz", "policy.npz", "curves.png"}
    assert {path.name for path in (tmp_path / "mine").iterdir()} == names
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()
    assert [row[0] for row in rows(tmp_path / "mine")] == ["iteration", "1", "2"]
    record = json.loads((tmp_path / "mine" / "config.json").read_text())
    assert (record["learner"]["iterations"], record["learner"]["lam"], record["env"]["history"]) == (2, 0.005, 2)
    (start,) = record["starts"]
    assert "--iterations 2" in start["command"] and start["versions"]["mujoco"]


def test_equal_seeds_equal_runs(finished, tmp_path):
    assert run("--iterations", 20, "--out", tmp_path) == 0
    assert rows(tmp_path) == rows(finished)
    assert run("--iterations", 3, "--seed", 1, "--out", tmp_path / "other") == 0
    assert rows(tmp_path / "other")[3] != rows(finished)[3]


def test_kill_9_and_resume_equals_a_run_that_was_never_stopped(finished, tmp_path):
    process = start_and_wait(tmp_path)
    process.kill()
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    assert run("--iterations", 20, "--out", tmp_path, "--resume") == 0
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
    assert run(*flags, "--iterations", 6, "--out", tmp_path / "long") == 0
    assert run(*flags, "--iterations", 3, "--out", tmp_path / "short") == 0
    assert train.main(["--out", str(tmp_path / "short"), "--resume", "--iterations", "6"]) == 0
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
    "task, history, lam, iterations",
    [("flat", 5, 0.005, 4000), ("rough", 10, 0.0002, 4000), ("velocity", 10, 0.0002, 10_000)],
)
def test_paper_settings_of_each_task(task, history, lam, iterations):
    """V-A, V-B, V-D: H, the first lambda and the length of training; whatever is given wins, the rest stays."""
    env_cfg, cfg = train.settle(dict(task=task), {})
    assert (env_cfg.task, env_cfg.history, cfg.lam, cfg.iterations) == (task, history, lam, iterations)
    env_cfg, cfg = train.settle(dict(task=task, history=3), dict(lam=0.5))
    assert (env_cfg.task, env_cfg.history, cfg.lam, cfg.iterations) == (task, 3, 0.5, iterations)


def test_threads_do_not_change_the_numbers(finished, tmp_path):
    assert run("--iterations", 3, "--threads", 2, "--out", tmp_path) == 0
    assert rows(tmp_path) == rows(finished)[:4]


@pytest.mark.parametrize(
    "flags, says",
    [
        (["--task", "moon"], "moon"),
        (["--algo", "sac"], "sac"),
        (["--num-envs", "-4"], "num_envs"),
        (["--num-envs", "3"], "even"),
        (["--iterations", "0"], "iterations"),
        (["--checkpoint-every", "0"], "checkpoint_every"),
        (["--threads", "-1"], "threads"),
        (["--seed", "-1"], "seed"),
        (["--lam", "nan"], "lam"),
        (["--lam", "-0.1"], "lam"),
        (["--lam", "0"], "lam"),
        (["--lr", "inf"], "lr"),
        (["--history", "0"], "history"),
        (["--log-std", "2"], "log_std"),
        (["--seed", "5000000000"], "seed"),
        (["--algo", "ppo", "--alpha0", "100"], "alpha0"),
        (["--hidden", "0"], "hidden"),
        (["--clip", "voltage"], "voltage"),
        (["--friction", "1", "0"], "friction"),
        (["--payload", "nan", "1"], "payload"),
        (["--friction", "1"], "friction"),
        (["--timestep", "0"], "timestep"),
        (["--noise", "nan"], "noise"),
        (["--roughness", "0.15", "0"], "roughness"),
        (["--cells-per-m", "11"], "cells_per_m"),
    ],
)
def test_bad_settings_are_one_line_and_leave_nothing_behind(tmp_path, capsys, flags, says):
    assert says in error_of(capsys, *flags, "--out", tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    "flags", [["--num-envs", "many"], ["--threads", "many"], ["--speed", "3"], ["--iter", "2"], ["--lr"]]
)
def test_flags_that_do_not_parse_are_one_line(capsys, flags):
    with pytest.raises(SystemExit, match="2"):
        train.main(flags)
    (line,) = capsys.readouterr().err.splitlines()
    assert flags[0] in line


def test_none_switches_off_what_a_task_sets():
    """IV-A.4: the curriculum ends an episode at 800 W, unless told otherwise."""
    limits = [train.settle(*train.parse(["--task", "curriculum", *flags])[1:])[0].max_power
              for flags in ([], ["--max-power", "none"], ["--max-power", "700"])]  # fmt: skip
    assert limits == [800.0, None, 700.0]


def test_a_run_is_never_overwritten(finished, capsys):
    before = {path.name: path.read_bytes() for path in finished.iterdir()}
    assert "--resume" in error_of(capsys, "--iterations", 20, "--out", finished)
    assert {path.name: path.read_bytes() for path in finished.iterdir()} == before


@pytest.mark.parametrize("flags, says", [(["--lr", 0.1], "--lr"), (["--iterations", 4], "--iterations"),
                                         (["--seed", 3], "--seed"), (["--noise", 0.5], "--noise")])  # fmt: skip
def test_a_resumed_run_keeps_its_settings(finished, capsys, flags, says):
    assert says in error_of(capsys, "--out", finished, "--resume", *flags)


def damage(kind, folder):
    checkpoint = folder / "checkpoint.npz"
    if kind == "missing":
        checkpoint.unlink()
    elif kind == "truncated":
        checkpoint.write_bytes(checkpoint.read_bytes()[:-1000])
    elif kind == "empty":
        checkpoint.write_bytes(b"")
    elif kind == "not an archive":
        checkpoint.write_text("hello")
    elif kind == "of another program":
        np.savez(checkpoint, weights=np.ones(3))
    elif kind == "of another network":
        arrays = run_folder.read_npz(checkpoint)
        wrong = next(name for name in arrays if "actor" in name)
        np.savez(checkpoint, **arrays | {wrong: np.ones((2, 2))})
    elif kind == "of a longer run":
        (folder / "metrics.csv").write_text("iteration\n")
    elif kind == "config damaged":
        (folder / "config.json").write_text("{")
    elif kind == "config missing":
        (folder / "config.json").unlink()


KINDS = ["missing", "truncated", "empty", "not an archive", "of another program", "of another network",
         "of a longer run", "config damaged", "config missing"]  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_what_cannot_be_resumed_is_one_line_and_loses_nothing(tmp_path, capsys, kind):
    assert run("--iterations", 2, "--out", tmp_path) == 0
    damage(kind, tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert str(tmp_path) in error_of(capsys, "--out", tmp_path, "--resume")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_an_unwritable_folder_is_one_line(tmp_path, capsys):
    (tmp_path / "file").write_text("in the way")
    assert "file" in error_of(capsys, "--out", tmp_path / "file" / "run")


def test_a_crash_while_writing_keeps_the_old_file(tmp_path):
    path = tmp_path / "a.txt"
    run_folder.replace_file(path, lambda file: file.write(b"old"))

    def fail(file):
        file.write(b"ne")
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        run_folder.replace_file(path, fail)
    assert path.read_bytes() == b"old"


def test_evaluate_prints_a_row_per_run_and_one_line_for_a_folder_that_is_none(finished, tmp_path, capsys):
    """An untrained policy scores between nothing and everything; what is no run folder is one line."""
    params, env_cfg = run_folder.load_policy(finished / "policy.npz")
    assert env_cfg.history == 2 and params["actor"]["layers"][0][0].shape == (91, 8)
    assert evaluate.main([str(finished), "--episodes", "11", "--clip", "power"]) == 0
    header, _, row = capsys.readouterr().out.splitlines()
    head, cells = ([x.strip() for x in line.split("|")[1:-1]] for line in (header, row))
    assert 0 < float(dict(zip(head, cells, strict=True))["performance"]) < 1.5
    assert evaluate.main([str(tmp_path)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_pi_and_pi_prime_share_one_curriculum(monkeypatch, tmp_path):
    """D23: else the better policy would get the harder commands, and J(pi) - J(pi') would compare two tasks."""
    made = []
    environment = train.go1_env.Go1Env
    monkeypatch.setattr(train.go1_env, "Go1Env", lambda *x: made.append(environment(*x)) or made[-1])
    assert run("--task", "curriculum", "--out", tmp_path / "run") == 0
    env, env_prime = made
    env_prime.state.cell[:], env_prime.state.tracked[:] = [3, 21], 1000.0  # a success in the corner of the first region
    env_prime._draw_commands(np.array([0]))
    assert env.state.weights[4, 22] == pytest.approx(0.2)
    assert (tmp_path / "run" / "commands.png").stat().st_size > 1000
