"""The command line and the run folder: whatever stops a run, its numbers come out the same."""

import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from support import DAMAGES, ROOT, SECONDS, TINY, contents, error_of, heard, started

import eipo
import evaluate
import go1_env
import tasks
import train
from runtime import interrupt, metrics, policy_file, run_folder

pytestmark = pytest.mark.usefixtures("one_compilation", "undrawn")
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


@pytest.fixture
def start():
    """Starts train.py as a process of its own, with these flags and environment variables; returns
    it. It does not outlive the test.
    """
    with ExitStack() as stack:

        def start(*argv, **variables):
            command = [sys.executable, ROOT / "train.py", *argv]
            return stack.enter_context(started(command, env=os.environ | variables))

        yield start


def start_and_wait(start, folder, iterations=20, until=5):
    """Start the same run as a process of its own; returns it when metrics.csv holds `until`
    iterations.
    """
    process, table = (
        start(*FLAGS, "--iterations", iterations, "--out", folder),
        folder / "metrics.csv",
    )
    while not table.exists() or table.read_text().count("\n") < until + 1:
        assert process.poll() is None, "the run ended before it could be stopped"
        time.sleep(0.002)
    return process


def copy(finished, folder):
    """The same run in another folder, which exists."""
    for name, content in contents(finished).items():
        (folder / name).write_bytes(content)


NOT_FINITE = {"alpha": np.nan, "momentum": np.inf}


@pytest.mark.parametrize("name", NOT_FINITE)
def test_a_run_does_not_go_on_without_alpha(name):
    """D44. nan > 0 is false, so that line 13 would put alpha to 0 for good."""
    learner = SimpleNamespace(opt_state=SimpleNamespace(notfinite_count=0))
    dual = eipo.Dual(200.0, 0.0)._replace(**{name: NOT_FINITE[name]})
    state = eipo.State(7, None, learner, learner, dual, None, None)
    with pytest.raises(ValueError, match=r"^alpha and its momentum are .* after iteration 7$"):
        train.check_learned(state, eipo.Config())
    # at lam = 0 its alpha is infinite
    train.check_learned(state._replace(pi_prime=None), eipo.Config(algo="ppo"))


@pytest.mark.parametrize("culprit", ["pi", "pi_prime"])
def test_a_run_ends_when_nothing_was_learned_for_ten_iterations(culprit):
    """D44. 10 iterations of 5 x 4 minibatches, none of which had a finite gradient: 200; one fewer
    goes on.
    """
    learners = {
        name: SimpleNamespace(opt_state=SimpleNamespace(notfinite_count=0))
        for name in ("pi", "pi_prime")
    }
    state = eipo.State(11, None, *learners.values(), eipo.Dual(200.0, 0.0), None, None)
    learners[culprit].opt_state.notfinite_count = 199
    train.check_learned(state, eipo.Config())
    learners[culprit].opt_state.notfinite_count = 200
    with pytest.raises(
        ValueError, match=f"^no gradient of {culprit} was finite in 10 iterations: [^\n]+$"
    ):
        train.check_learned(state, eipo.Config())


def test_two_iterations_fill_the_run_folder(tmp_path):
    """`python train.py` from another folder, as a user would: every promised file is there and says
    what it should.
    """
    command = [
        sys.executable,
        ROOT / "train.py",
        *FLAGS,
        "--task",
        "flat",
        "--iterations",
        "2",
        "--out",
        "mine",
    ]
    # which MuJoCo would refuse, if anything were drawn
    options = dict(env=os.environ | dict(MUJOCO_GL="foo"), timeout=SECONDS)
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, **options)
    assert (done.returncode, done.stderr) == (0, "")
    assert set(contents(tmp_path / "mine")) == {
        "config.json",
        "metrics.csv",
        "checkpoint.npz",
        "policy.npz",
        "curves.png",
        "lock",
    }
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()
    assert [row[0] for row in rows(tmp_path / "mine")] == ["iteration", "1", "2"]
    record = json.loads((tmp_path / "mine" / "config.json").read_text())
    assert (
        record["learner"]["iterations"],
        record["learner"]["lam"],
        record["env"]["history"],
    ) == (2, 0.005, 2)
    (start,) = record["starts"]
    assert (
        start["command"] == shlex.join(["python", *map(str, command[1:])])
        and start["versions"]["mujoco"]
    )


def test_equal_seeds_equal_runs_with_any_number_of_threads(finished, tmp_path):
    run("--iterations", 3, "--threads", 2, "--out", tmp_path / "same")
    assert rows(tmp_path / "same") == rows(finished)[:4]
    run("--iterations", 3, "--seed", 1, "--out", tmp_path / "other")
    assert rows(tmp_path / "other")[3] != rows(finished)[3]


def test_kill_9_and_resume_equals_a_run_that_was_never_stopped(finished, start, tmp_path, capsys):
    """While the process lives, nobody else can train in its folder; kill -9 frees it."""
    process = start_and_wait(start, tmp_path)
    process.send_signal(signal.SIGSTOP)
    before = contents(tmp_path)
    for flags in ["--resume"], FLAGS:
        assert "another process" in error_of(capsys, train.main, "--out", tmp_path, *flags)
    assert contents(tmp_path) == before
    process.kill()
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    run("--iterations", 20, "--out", tmp_path, "--resume")
    assert rows(tmp_path) == rows(finished)


def test_ctrl_c_saves_and_its_last_line_says_how_to_go_on(finished, start, tmp_path):
    process = start_and_wait(start, tmp_path)
    process.send_signal(signal.SIGINT)
    said, complaints = process.communicate()
    assert (process.returncode, complaints) == (130, "")
    assert "Stopping after this iteration" in said
    saved, last = len(rows(tmp_path)) - 1, said.splitlines()[-1]
    assert 5 <= saved < 20 and f"iteration {saved}." in last
    command = shlex.split(last.split("Continue with: ")[1])
    assert command[:2] == ["python", str(ROOT / "train.py")] and train.main(command[2:]) == 0
    assert rows(tmp_path) == rows(finished)


@pytest.mark.slow
def test_a_closed_terminal_saves(finished, start, tmp_path):
    """SIGHUP, when nobody reads any more what is printed. The same is true when Ctrl-C ends `tee`
    as well. test_ctrl_c_twice has SIGHUP without a process of its own.
    """
    process = start_and_wait(start, tmp_path)
    process.stdout.close(), process.stderr.close()
    process.send_signal(signal.SIGHUP)
    assert process.wait() == 130
    assert 5 <= len(rows(tmp_path)) - 1 < 20
    resume(tmp_path)
    assert rows(tmp_path) == rows(finished)


def test_ctrl_c_while_jax_compiles_ends_in_one_line(start, tmp_path):
    """There is nothing to save, so there is nothing to wait for. No other test has a layer of six,
    so the update, which is never compiled to its end, is in no cache.
    """
    process = start(*FLAGS, "--hidden", "6", "--out", tmp_path / "run")
    assert "Compiling" in process.stdout.readline()
    process.send_signal(signal.SIGINT)
    said = process.communicate()
    assert (process.returncode, *said) == (130, "", "Stopped at once: there is no checkpoint\n")
    assert set(contents(tmp_path / "run")) == {"config.json", "lock"}


def test_ctrl_c_while_python_imports_ends_in_one_line(start, tmp_path):
    """Twice, and before there is anything to stop."""
    (tmp_path / "jax.py").write_text(
        "import os, signal\nfor _ in range(2): os.kill(os.getpid(), signal.SIGINT)\n"
    )
    process = start(*FLAGS, "--out", tmp_path / "run", PYTHONPATH=str(tmp_path))
    said = process.communicate()
    assert (process.returncode, *said) == (130, "", "Stopped at once: no training was under way\n")


def test_a_process_of_a_test_hears_ctrl_c_and_does_not_outlive_the_test():
    """In the background of a shell script SIGINT is ignored here. One process is killed where the
    context ends, the other when it is late, for whoever waits for it.
    """
    code = "import signal, time; print(signal.getsignal(signal.SIGINT), flush=True); time.sleep(60)"
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with started([sys.executable, "-c", code]) as one:
            assert "default_int_handler" in one.stdout.readline()
        with started([sys.executable, "-c", code], seconds=0.1) as late:
            late.communicate()
            assert late.returncode == -signal.SIGKILL
        assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)
    assert one.returncode == -signal.SIGKILL


def wait_for(condition):
    """Until it is true, for ten seconds at most."""
    end = time.monotonic() + 10
    while not condition() and time.monotonic() < end:
        time.sleep(0.001)
    assert condition()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize(
    "file, says", [("checkpoint.npz", "--resume"), ("policy.npz", "no checkpoint")]
)
def test_ctrl_c_twice_stops_at_once_and_promises_no_checkpoint_that_is_not_there(
    tmp_path, monkeypatch, file, says, number
):
    """As do SIGTERM, which batch systems send, and SIGHUP of a terminal that closes."""
    (tmp_path / file).touch()
    ends = []
    monkeypatch.setattr(interrupt, "stop_at_once", ends.append)
    with heard(), interrupt.stop_at_boundary(tmp_path) as stop:
        stop.worth_saving = True
        os.kill(os.getpid(), number)
        wait_for(lambda: stop.asked)
        assert not ends
        os.kill(os.getpid(), number)
        wait_for(lambda: ends)
    assert says in ends[0]


def test_a_run_under_nohup_outlives_its_terminal(tmp_path):
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with interrupt.stop_at_boundary(tmp_path):
            assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize(
    "flags",
    [
        ["--algo", "ppo"],
        ["--algo", "ppo", "--lam", "0"],
        ["--lam", "0.02", "--clip", "power"],
        # on other ground than the seed's by the time of the checkpoint
        ["--task", "rough", "--episode-steps", "8"],
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
    """Two rows of two columns, whatever a crash or a full disk made of a third; no row yet; a row
    of something else.
    """
    for torn in ("", "3", "3\n", "3,0.", "3,0.875", "3,0.8,75\n", "\0\0\0\0", "\0\0\n"):
        (tmp_path / "metrics.csv").write_text("iteration,reward\n1,0.5\n2,0.75\n" + torn)
        columns = {name: x.tolist() for name, x in metrics.read(tmp_path).items()}
        assert columns == dict(iteration=[1.0, 2.0], reward=[0.5, 0.75]), torn
    for empty in ("", "iteration,reward", "iteration,reward\n"):
        (tmp_path / "metrics.csv").write_text(empty)
        assert metrics.read(tmp_path) == {}
    (tmp_path / "metrics.csv").write_text("iteration,reward\n1,much\n")
    with pytest.raises(ValueError, match=r"metrics\.csv.*much"):
        metrics.read(tmp_path)


@pytest.mark.parametrize(
    "damage, left",
    [
        (lambda path: os.truncate(path, path.stat().st_size - 60), 19),
        (
            lambda path: path.write_text(
                "".join(path.read_text().splitlines(keepends=True)[:6]) + "6,0.5,7,8,9\n"
            ),
            5,
        ),
        (lambda path: path.write_text("iteration\n"), 0),
        (lambda path: path.write_bytes(b"\xff\x00\n\xff\n"), 0),
        (lambda path: path.unlink(), 0),
    ],
    ids=["torn", "merged", "lost", "binary", "deleted"],
)
def test_a_run_goes_on_without_rows_that_are_lost(finished, tmp_path, capsys, damage, left):
    """The checkpoint is intact, and a curve is not worth a run. The new rows are those of a run
    that lost nothing.
    """
    copy(finished, tmp_path)
    before = rows(tmp_path)
    damage(tmp_path / "metrics.csv")
    resume(tmp_path, "--iterations", 21)
    (line,) = capsys.readouterr().err.splitlines()
    assert f"lacks {20 - left} of 20 rows" in line and str(tmp_path) in line
    assert rows(tmp_path)[:-1] == before[: left + 1]
    assert rows(tmp_path)[-1][0] == "21" and len(rows(tmp_path)[-1]) == len(before[0])
    assert metrics.read(tmp_path)["iteration"].tolist() == [*range(1, left + 1), 21]


def test_rows_of_another_version_keep_their_columns(tmp_path):
    (tmp_path / "metrics.csv").write_text("iteration,steps,old\n1,4,0.5\n")
    log = metrics.Log(tmp_path, 1)
    log.row(2, dict(steps=8, new=0.25))
    columns = metrics.read(tmp_path)
    assert columns["steps"].tolist() == [4, 8]
    assert columns["old"] == pytest.approx([0.5, np.nan], nan_ok=True)
    assert columns["new"] == pytest.approx([np.nan, 0.25], nan_ok=True)
    (tmp_path / "metrics.csv").unlink()  # while the run is going on
    log.row(3, dict(steps=12, new=0.5))
    assert metrics.read(tmp_path)["steps"].tolist() == [4, 12]


def test_levels_of_the_reward_in_the_picture():
    """Standing on flat ground: the mean of exp(-4 v^2) for commands v from 0 to 1 m/s is 0.441,
    sqrt(pi) / 4 erf(2), and 0.5 for not turning; on rough ground 0.15. Eqs. (5), (6), (8).
    """
    levels = {task: metrics.levels(task) for task in tasks.TASKS}
    assert levels["flat"] == pytest.approx({"as told": 1.5, "standing": 0.941}, abs=1e-3)
    assert levels["rough"] == pytest.approx({"as told": 1.15, "standing": 0.591}, abs=1e-3)
    assert (levels["velocity"], levels["curriculum"]) == ({}, {"as told": 1.5})


@pytest.mark.parametrize(("algo", "minutes"), [("eipo", 1.0), ("ppo", 2.0)])
def test_minutes_of_an_iteration(algo, minutes):
    """250 robots, of EIPO's pi 125, take 24 steps of 0.02 s: 125 x 24 x 0.02 s = 60 s."""
    cfg = eipo.Config(algo=algo, num_envs=250, num_steps=24)
    assert metrics.minutes(tasks.task_config("flat"), cfg) == pytest.approx(minutes, rel=1e-12)


@pytest.mark.parametrize(
    "error", [ValueError, TypeError, ImportError, OSError], ids=lambda x: x.__name__
)
def test_drawing_never_stops_training(tmp_path, capsys, monkeypatch, error):
    def draw_curves(folder):
        raise error("no\nfont")

    monkeypatch.setattr(metrics, "draw_curves", draw_curves)
    run("--out", tmp_path)
    (line,) = capsys.readouterr().err.splitlines()
    assert "no font" in line and (tmp_path / "checkpoint.npz").exists()


def edit(path, part, name, x):
    """Another value in config.json."""
    record = json.loads(path.read_text())
    record[part][name] = x
    path.write_text(json.dumps(record))


@pytest.mark.parametrize(
    "part, name, x", [("learner", "seed", 1), ("env", "noise", 0.5), ("env", "friction", [1, 1])]
)
def test_settings_that_were_edited_are_one_line(finished, tmp_path, capsys, part, name, x):
    """The checkpoint has its settings in it, so that a run does not change in silence."""
    copy(finished, tmp_path)
    edit(tmp_path / "config.json", part, name, x)
    before = contents(tmp_path)
    assert f" {name} " in error_of(
        capsys, train.main, "--out", tmp_path, "--resume", "--iterations", 21
    )
    assert contents(tmp_path) == before


def test_a_checkpoint_of_an_earlier_version_goes_on(finished, tmp_path, capsys):
    """It does not tell its settings or JAX's threads."""
    copy(finished, tmp_path)
    arrays = run_folder.read_npz(tmp_path / "checkpoint.npz")
    settings = json.loads(str(arrays.pop("settings")))
    assert set(settings) == {"env", "learner", "jax_threads"}
    np.savez(tmp_path / "checkpoint.npz", **arrays)
    (tmp_path / "lock").unlink()
    resume(tmp_path, "--iterations", 21)
    assert capsys.readouterr().err == ""
    assert rows(tmp_path)[:-1] == rows(finished)


def test_numbers_are_float32_whatever_jax_was_told(finished, tmp_path):
    jax.config.update("jax_enable_x64", True)
    try:
        run("--iterations", 3, "--out", tmp_path)
    finally:
        jax.config.update("jax_enable_x64", False)
    assert rows(tmp_path) == rows(finished)[:4]


@pytest.mark.parametrize(
    "given, began, now, says",
    [
        (None, None, "8", None),
        (None, "8", "8", None),
        (None, "2", "2", "PJRT_NPROC=8"),
        ("4", "2", "4", "differ"),
        ("4", None, "4", None),
    ],
)
def test_threads_of_jax_are_those_of_the_start(monkeypatch, capsys, given, began, now, says):
    """On a machine of 8 cores, for a run that began with some number of threads, if the user sets
    another or does not.

    test_the_number_of_cores_changes_no_bit shows what it is good for.
    """
    monkeypatch.setattr(go1_env, "CORES", 8)
    monkeypatch.delenv("PJRT_NPROC", raising=False)
    if given:
        monkeypatch.setenv("PJRT_NPROC", given)
    train.repeat_arithmetic(began)
    assert os.environ["PJRT_NPROC"] == now
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == bool(says) and all(says in line for line in lines)


@pytest.mark.slow
@pytest.mark.skipif(
    go1_env.CORES < 2 or not hasattr(os, "sched_setaffinity"), reason="needs two cores"
)
def test_the_number_of_cores_changes_no_bit(start, tmp_path, monkeypatch):
    """Begun on two cores, resumed on two and on one. With a product per thread the last digit of kl
    would differ.
    """
    flags = [
        "--algo",
        "ppo",
        "--num-envs",
        64,
        "--num-steps",
        16,
        "--num-minibatches",
        1,
        "--hidden",
        64,
        "--history",
        2,
    ]
    monkeypatch.delenv("PJRT_NPROC", raising=False)
    cores = os.sched_getaffinity(0)
    two, one = tmp_path / "two", tmp_path / "one"
    assert start(*flags, "--iterations", 1, "--out", two).communicate()[1] == ""
    shutil.copytree(two, one)
    assert start("--resume", "--iterations", 3, "--out", two).communicate()[1] == ""
    os.sched_setaffinity(0, {min(cores)})
    try:
        process = start("--resume", "--iterations", 3, "--out", one)
    finally:
        os.sched_setaffinity(0, cores)
    assert "PJRT_NPROC=1" in process.communicate()[1]
    assert rows(one) == rows(two)


@pytest.mark.parametrize(
    "typed, argv, whole, expected",
    [
        ("python train.py --task flat", ["--task", "flat"], 1, "python train.py --task flat"),
        (
            "python -m mine --bonus 3 --task flat",
            ["--task", "flat"],
            2,
            "python -m mine --bonus 3 --task flat",
        ),
        ("python sweep.py", ["--seed", "1"], 1, "python sweep.py --seed 1"),
    ],
    ids=["train.py", "own flags", "sweep"],
)
def test_the_command_is_the_one_that_was_given(monkeypatch, typed, argv, whole, expected):
    """A script that wraps train.py, because its reward is another, must not be told to go on with
    train.py.
    """
    words = shlex.split(typed)
    monkeypatch.setattr(sys, "orig_argv", words)
    monkeypatch.setattr(sys, "argv", ["/path/of/script.py", *words[whole + 1 :]])
    assert train.command_line(argv) == shlex.split(expected)


def test_the_console_shows_the_multiplier_at_work(capsys):
    """What weighs the task, how much that counts beside the energy, and what moves it. PPO has no
    gap to show.
    """
    row = dict(
        iteration=100,
        time_s=1,
        reward=0,
        v_x=0,
        power=0,
        alpha=290.12,
        task_share=0.857,
        steps_per_s=1,
    )
    metrics.report(row | dict(gap=-0.194), row, 600)
    assert "  alpha 290.1  share 0.86  gap -0.19" in capsys.readouterr().out
    metrics.report(row, row, 600)
    assert "share" not in capsys.readouterr().out


def test_the_time_left_leaves_compilation_out(capsys):
    """100 s for the first iteration and 1 s for each of the next 99: the last 600 take ten minutes,
    not 20.
    """
    numbers = dict(reward=0, v_x=0, power=0, alpha=0, steps_per_s=1)
    first, row = (dict(iteration=i, time_s=t) | numbers for i, t in ((1, 100.0), (100, 199.0)))
    metrics.report(row, first, 700)
    assert "  10 min left" in capsys.readouterr().out
    metrics.report(first | dict(iteration=100), first | dict(iteration=100), 700)
    assert "left" not in capsys.readouterr().out  # what the first one took says nothing


def test_the_line_has_the_reward_of_the_task_where_another_is_learned(capsys):
    row = dict(
        iteration=100,
        time_s=0.0,
        reward=7,
        task_reward=1.25,
        v_x=0,
        power=0,
        alpha=0,
        steps_per_s=1,
    )
    metrics.report(row, row, 100)
    assert "  task 1.25  " in capsys.readouterr().out


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


def other_type(path):
    """The same checkpoint with text for numbers."""
    arrays = run_folder.read_npz(path)
    np.savez(path, **arrays | {"env0.age": arrays["env0.age"].astype(str)})


def not_a_number(name):
    """The same checkpoint with one NaN in an array of this name."""

    def damage(path):
        arrays = run_folder.read_npz(path)
        arrays[name].flat[0] = np.nan
        np.savez(path, **arrays)

    return damage


def other_array(name, x):
    """The same checkpoint with another array of this name."""
    return lambda path: np.savez(path, **run_folder.read_npz(path) | {name: np.array(x)})


def other_rng(**changes):
    """The same checkpoint with other numbers in the state of an environment's generator."""

    def damage(path):
        arrays = run_folder.read_npz(path)
        state = json.loads(str(arrays["env0.rng"]))
        state |= {name: x for name, x in changes.items() if name in state}
        state["state"] |= {name: x for name, x in changes.items() if name in state["state"]}
        np.savez(path, **arrays | {"env0.rng": np.array(json.dumps(state))})

    return damage


def other_starts(path):
    """A config.json whose starts are a number."""
    path.write_text(json.dumps(json.loads(path.read_text()) | dict(starts=3)))


def other_settings(text):
    """The same checkpoint with another text for its settings."""
    return lambda path: np.savez(path, **run_folder.read_npz(path) | dict(settings=np.array(text)))


@pytest.mark.parametrize(
    "file, damage",
    [
        *(
            (file, damage)
            for file in ("checkpoint.npz", "config.json")
            for damage in DAMAGES.values()
        ),
        ("checkpoint.npz", other_network),
        ("checkpoint.npz", other_type),
        *(
            ("checkpoint.npz", not_a_number(f"state.{name}"))
            for name in (
                "dual.alpha",
                "dual.momentum",
                "pi.params['actor']['log_std']",
                "pi_prime.params['critic'][0].even",
            )
        ),
        *(
            ("checkpoint.npz", other_settings(text))
            for text in ("7", "[", '{"env": 1}', '{"env": {"moons": 1}}', '{"jax_threads": 2}')
        ),
        *(("checkpoint.npz", not_a_number(name)) for name in ("env0.sim", "state.start[0]")),
        *(("checkpoint.npz", other_array("env0.tile", [x] * 2)) for x in (-1, 16)),
        *(("checkpoint.npz", other_array("env0.rng", x)) for x in ("[" * 5000, "7", "{")),
        ("checkpoint.npz", other_rng(inc=2**200)),
        ("checkpoint.npz", other_rng(inc=-1)),
        ("checkpoint.npz", other_rng(uinteger=2**40)),
        ("config.json", other_starts),
        ("config.json", lambda path: path.write_text("{")),
    ],
)
def test_what_cannot_be_resumed_is_one_line_and_loses_nothing(
    tmp_path, capsys, finished, file, damage
):
    copy(finished, tmp_path)
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


def test_evaluate_prints_a_row_per_run_and_one_line_for_a_folder_that_is_none(
    finished, tmp_path, capsys, monkeypatch
):
    """An untrained policy scores between nothing and everything; what is no run folder is
    one line.
    """
    monkeypatch.setattr(evaluate, "EPISODE_STEPS", 16)
    params, env_cfg = policy_file.load(finished / "policy.npz")
    assert env_cfg.history == 2 and params["actor"]["layers"][0][0].shape == (91, 8)
    assert evaluate.main([str(finished), "--episodes", "11", "--clip", "power"]) == 0
    header, _, row = capsys.readouterr().out.splitlines()
    head, cells = ([x.strip() for x in line.split("|")[1:-1]] for line in (header, row))
    assert 0 < float(dict(zip(head, cells, strict=True))["performance"].split()[0]) < 1.5
    error_of(capsys, evaluate.main, tmp_path)


def test_pi_and_pi_prime_share_one_curriculum(monkeypatch, tmp_path):
    """D23: else the better policy would get the harder commands, and J(pi) - J(pi') would compare
    two tasks.
    """
    made = []
    environment = train.go1_env.Go1Env
    monkeypatch.setattr(
        train.go1_env, "Go1Env", lambda *x, **y: made.append(environment(*x, **y)) or made[-1]
    )
    run("--task", "curriculum", "--out", tmp_path / "run")
    env, env_prime, *_ = made  # and one for the trace of each policy that is saved
    # a success in the corner of the first region
    env_prime.state.cell[:], env_prime.state.tracked[:] = [3, 21], 1000.0
    env_prime._draw_commands(np.array([0]))
    assert env.state.command_weights[4, 22] == pytest.approx(0.2)
    assert (tmp_path / "run" / "commands.png").stat().st_size > 1000
