"""The command line and the run folder: whatever stops a run, its numbers come out the same."""

import errno
import json
import os
import resource
import shlex
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest
from support import ROOT, SECONDS, TINY, error_of, started

import eipo
import go1_env
import mirror
import rewards
import tasks
import train
from runtime import cli, flags, jax_setup, metrics, run_folder, start

FLAGS = [*TINY, "--checkpoint-every", "4"]
SIGNALS = signal.SIGINT, signal.SIGTERM, signal.SIGHUP


@pytest.fixture(autouse=True)
def signals_as_before():
    """After each test: a script may train several runs, and each leaves it its handlers."""
    before = [signal.getsignal(number) for number in SIGNALS]
    yield
    assert [signal.getsignal(number) for number in SIGNALS] == before


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


def contents(folder):
    """Every file of a folder, by name."""
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run of 20 iterations that nobody disturbed."""
    folder = tmp_path_factory.mktemp("finished") / "run"
    run("--iterations", 20, "--out", folder)
    return folder


@pytest.fixture
def copied(finished, tmp_path):
    """The same run in another folder."""
    for name, content in contents(finished).items():
        (tmp_path / name).write_bytes(content)
    return tmp_path


def wait_for(iterations, folder, process):
    """Until a process has trained and saved so many iterations."""
    table = folder / "metrics.csv"
    while not table.exists() or table.read_text().count("\n") <= iterations:
        assert process.poll() is None, "the run ended before it could be stopped"
        time.sleep(0.002)


@contextmanager
def half_done(folder):
    """The same run as a process of its own, as soon as it has saved five iterations of 20."""
    command = [sys.executable, ROOT / "train.py", *FLAGS, "--iterations", 20, "--out", folder]
    with started(command) as process:
        wait_for(5, folder, process)
        yield process


# ---- what a run leaves behind ----


def test_two_iterations_fill_the_run_folder(tmp_path):
    """`python train.py` from another folder, as a user would, who looks at it through a pipe that
    does not know the letters of a path.
    """
    command = [sys.executable, ROOT / "train.py", *FLAGS, "--iterations", "2", "--out", "训练"]
    # MuJoCo would refuse its foo, if anything were drawn
    env = os.environ | dict(MUJOCO_GL="foo", PYTHONIOENCODING="cp1252")
    options = dict(env=env, timeout=SECONDS, capture_output=True, text=True)
    done = subprocess.run(command, cwd=tmp_path, **options)
    assert (done.returncode, done.stderr) == (0, "")
    shown = [line.split()[0] for line in done.stdout.splitlines() if line]
    assert shown == [r"\u8bad\u7ec3:", "1/2", "2/2", "Done:"]
    assert f"Look: {sys.executable} {ROOT / 'play.py'} " in done.stdout  # which works from there
    folder = tmp_path / "训练"
    names = "config.json metrics.csv checkpoint.npz policy.npz policy_prime.npz curves.png lock"
    assert set(contents(folder)) == set(names.split())
    table = metrics.read(folder)  # four robots in all, and four steps of each in an iteration
    assert (table["iteration"].tolist(), table["steps"].tolist()) == ([1, 2], [16, 32])
    record = json.loads((folder / "config.json").read_text())
    assert (record["learner"]["iterations"], record["learner"]["lam"]) == (2, 0.005)
    assert record["env"]["history"] == 2
    (start,) = record["starts"]
    assert start["command"] == shlex.join(["python", "train.py", *map(str, command[2:])])
    assert start["commit"] == run_folder.commit() and start["machine"]
    assert start["jax"]["mujoco"] and start["cores"] >= 1 and start["jax"]["cpu"]
    assert start["jax"]["device"] == "cpu"  # the tests ask JAX for nothing else


def test_each_policy_is_saved_under_its_own_name_and_mirrored(finished, tmp_path):
    """D28: pi(M s) = M pi(s), unless told otherwise. Without a mirror a policy's last layer is that
    of the checkpoint.
    """
    env = go1_env.Go1Env(1, tasks.task_config(history=2), 1)
    obs = np.random.default_rng(0).normal(size=(1, env.obs_size))

    def image(x, part):
        index, sign = mirror.joined(env.mirror[part])
        return np.array(sign) * x[..., list(index)]

    def is_mirrored(pi):
        there, here = pi.mean(image(obs, "obs")), image(pi.mean(obs), "action")
        return np.allclose(there, here, atol=1e-5)

    run("--no-mirror", "--out", tmp_path / "run")
    arrays = run_folder.read_npz(tmp_path / "run" / "checkpoint.npz")
    lasts = [arrays[f"state.{x}.params['actor'].layers[1][0]"] for x in ("pi", "pi_prime")]
    assert not np.array_equal(*lasts)
    for name, last in zip(("policy.npz", "policy_prime.npz"), lasts, strict=True):
        pi, _ = run_folder.load_policy(finished / name)
        assert pi.about | dict(iteration=20, algo="eipo", lam=0.005, seed=0) == pi.about
        assert is_mirrored(pi)
        pi, _ = run_folder.load_policy(tmp_path / "run" / name)
        assert np.array_equal(pi.actor[1][0], last) and not is_mirrored(pi)


@pytest.mark.parametrize(
    "flags",
    [
        ["--algo", "ppo", "--lam", "0"],
        # on other ground than the seed's by the time of the checkpoint
        ["--task", "rough", "--episode-steps", "8"],
        ["--task", "curriculum"],
    ],
    ids=" ".join,
)
def test_resume_with_more_iterations_equals_one_long_run(tmp_path, flags):
    run(*flags, "--iterations", 4, "--out", tmp_path / "long")
    run(*flags, "--out", tmp_path / "short")
    resume(tmp_path / "short", "--iterations", 4)
    assert rows(tmp_path / "short") == rows(tmp_path / "long")
    short, long = (
        json.loads((tmp_path / x / "config.json").read_text()) for x in ("short", "long")
    )
    assert (short["env"], short["learner"]) == (long["env"], long["learner"])
    assert len(short["starts"]) == 2


def test_pi_and_pi_prime_share_one_curriculum():
    """D23: else the better policy would get the harder commands, and J(pi) - J(pi') would compare
    two tasks.
    """
    envs = train.make_envs(tasks.task_config("curriculum"), eipo.Config(num_envs=4), 1)
    for env in envs:
        env.reset(0)
    # a success in the corner of the first region
    envs[1].commands.record(np.array([[0.75, 0.0, 0.75]]), np.ones((1, 2)))
    assert envs[0].state.command_weights[4, 22] == pytest.approx(0.2)


def test_each_file_is_replaced_in_one_step_and_the_checkpoint_last(tmp_path, monkeypatch):
    """Killed before it, a run goes on from the previous one. Only the picture comes later."""
    real, names = os.replace, []
    monkeypatch.setattr(os, "replace", lambda a, b: names.append(b) or real(a, b))
    run("--iterations", 1, "--out", tmp_path)
    first = "config.json", "metrics.csv", "policy.npz", "policy_prime.npz"
    assert [path.name for path in names] == [*first, "checkpoint.npz", "curves.png"]


def test_checkpoints_are_as_far_apart_as_asked(tmp_path, monkeypatch):
    """The first one, each fourth, and the last one."""
    saved = []
    monkeypatch.setattr(train, "save", lambda folder, log, state, *_: saved.append(state.iteration))
    run("--iterations", 22, "--out", tmp_path / "run")
    assert saved == [1, 4, 8, 12, 16, 20, 22]


@pytest.mark.parametrize(("given", "threads"), [(3, 3), (None, 5)])
def test_threads_are_as_many_as_asked_or_one_for_each_core(monkeypatch, given, threads):
    seen, real = [], go1_env.Batch
    monkeypatch.setattr(go1_env, "CORES", 5)
    monkeypatch.setattr(go1_env, "Batch", lambda *x: seen.append(x[1:]) or real(*x))
    train.make_envs(tasks.Config(), eipo.Config(num_envs=4), given)
    assert seen == [(2, threads)] * 2


@pytest.mark.parametrize(
    ("given", "began_with", "threads"), [(None, None, "7"), (None, "3", "3"), ("4", "3", "4")]
)
def test_jax_has_a_thread_for_each_core_or_as_at_the_start(monkeypatch, given, began_with, threads):
    """Unless the user sets another number."""
    monkeypatch.setenv("PJRT_NPROC", given or "")
    if not given:
        monkeypatch.delenv("PJRT_NPROC")
    monkeypatch.setattr(jax_setup, "CORES", 7)
    jax_setup.set_threads(began_with)
    assert os.environ["PJRT_NPROC"] == threads


# ---- how a run ends ----


def test_kill_9_and_resume_equals_a_run_that_was_never_stopped(finished, tmp_path, capsys):
    """While the process lives, nobody else can train in its folder; kill -9 frees it. It may come
    between the log and the checkpoint, so later rows are computed again.
    """
    with half_done(tmp_path) as process:
        process.send_signal(signal.SIGSTOP)
        before = contents(tmp_path)
        assert "another process" in error_of(capsys, train.main, "--out", tmp_path, "--resume")
        assert "--resume" in error_of(capsys, train.main, "--out", tmp_path, *FLAGS)
        assert contents(tmp_path) == before
        process.kill()
        process.communicate()
    with open(tmp_path / "metrics.csv", "a") as file:
        file.write("20,1,2\n")
    resume(tmp_path)
    assert rows(tmp_path) == rows(finished)


def test_ctrl_c_saves_and_its_last_line_says_how_to_go_on(finished, tmp_path):
    with half_done(tmp_path) as process:
        process.send_signal(signal.SIGINT)
        said, complaints = process.communicate()
    assert (process.returncode, complaints) == (130, "")
    assert "Stopping after this iteration" in said
    saved, last = len(rows(tmp_path)) - 1, said.splitlines()[-1]
    assert 5 <= saved < 20 and f"iteration {saved}." in last
    command = shlex.split(last.split("Continue with: ")[1])
    assert shutil.which(command[0]) and (ROOT / command[1]).samefile(train.__file__)
    assert train.main(command[2:]) == 0
    assert rows(tmp_path) == rows(finished)


def test_a_console_that_goes_away_costs_nothing(finished, tmp_path):
    """`train.py | head -1` trains on and complains of nothing. A terminal that is closed then may
    send SIGHUP twice: what was learned is saved.
    """
    with half_done(tmp_path) as process:
        process.stdout.close()
        wait_for(7, tmp_path, process)
        process.send_signal(signal.SIGHUP)
        time.sleep(0.01)
        process.send_signal(signal.SIGHUP)
        assert (process.stderr.read(), process.wait()) == ("", 130)
    assert 7 <= len(rows(tmp_path)) - 1 < 20
    resume(tmp_path)
    assert rows(tmp_path) == rows(finished)


def test_memory_or_an_output_that_is_not_there_is_no_traceback(capsys, monkeypatch):
    """`train.py >&-` closes standard output, and Python then has none."""
    assert cli.program("any.py")(lambda argv: np.zeros(10**15))([]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("any.py: Unable to allocate ")
    monkeypatch.setattr(sys, "stdout", None)
    assert cli.program("any.py")(lambda argv: 0)([]) == 0


def test_ctrl_c_before_the_first_iteration_ends_at_once(tmp_path):
    """There is nothing to save. No other test has layers of six, so JAX has to compile."""
    command = [sys.executable, ROOT / "train.py", *FLAGS, "--hidden", "6", "--out", tmp_path]
    with started(command) as process:
        assert "Compiling" in process.stdout.readline()
        process.send_signal(signal.SIGINT)
        assert process.communicate()[1] == "" and process.returncode == -signal.SIGINT
    assert "checkpoint.npz" not in contents(tmp_path)


@pytest.mark.parametrize("number", SIGNALS[:2])
def test_the_second_signal_ends_a_run_and_an_ignored_one_stays_ignored(number):
    code = f"""
import os, signal
from runtime.cli import StopRequest
ask = lambda: os.kill(os.getpid(), {int(number)})
signal.signal({int(number)}, signal.SIG_IGN)
stop = StopRequest()
ask(), ask()
assert not stop.requested
signal.signal({int(number)}, signal.SIG_DFL)
stop = StopRequest()
ask()
print(stop.requested, flush=True)
ask()
print("still here")
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == -number and done.stdout.split()[-1] == "True"


# ---- what stands in the way ----


def test_a_file_that_is_in_use_costs_no_iteration(finished, tmp_path, capsys, monkeypatch):
    """Another program has it open in iterations 10 to 12, and it is tried again after each."""
    real, left = os.replace, [None] * 3

    def busy(*args):
        if left and (tmp_path / "curves.png").exists():
            left.pop()
            raise PermissionError(13, "in use")
        return real(*args)

    monkeypatch.setattr(os, "replace", busy)
    run("--iterations", 20, "--checkpoint-every", 10, "--out", tmp_path)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("train.py: ") and "in use" in line and "tries again" in line
    assert not left and rows(tmp_path) == rows(finished)
    for name in ("checkpoint.npz", "policy.npz"):
        ours, theirs = (run_folder.read_npz(x / name) for x in (tmp_path, finished))
        assert all(x.tobytes() == theirs[key].tobytes() for key, x in ours.items())


def test_who_trained_while_another_got_ready_keeps_its_run(finished, tmp_path, capsys, monkeypatch):
    """The folder is free when the second one looks, and not when it has its environments."""
    folder, real = tmp_path / "new", train.make_envs

    def make_envs(*given):
        shutil.copytree(finished, folder)
        return real(*given)

    monkeypatch.setattr(train, "make_envs", make_envs)
    assert "already holds" in error_of(capsys, train.main, *FLAGS, "--out", folder)
    assert contents(folder) == contents(finished)


def test_a_file_is_no_run_folder_and_what_cannot_go_on_may_go(tmp_path, capsys):
    path = tmp_path / "config.json"
    path.write_text("{}")
    assert "is a file" in error_of(capsys, train.main, *FLAGS, "--out", path)
    assert "or empty the folder" in error_of(capsys, train.main, *FLAGS, "--out", tmp_path)


def test_a_file_system_without_locks_is_a_warning(tmp_path, capsys, monkeypatch):
    def no_locks(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(run_folder.fcntl, "flock", no_locks)
    with run_folder.lock(tmp_path):
        (line,) = capsys.readouterr().err.splitlines()
    assert "cannot be locked" in line


def test_a_run_goes_on_with_the_threads_of_its_start(copied, monkeypatch):
    began = json.loads((copied / "config.json").read_text())["starts"][0]["jax"]["threads"]
    asked = []
    monkeypatch.setattr(jax_setup, "set_threads", asked.append)
    start.resumed(copied, flags.Options(), {})
    assert asked == [began]


def test_a_complaint_never_goes_to_standard_output(capsys, monkeypatch):
    """`2>&-` leaves Python without a sys.stderr; what is piped on stays clean."""
    monkeypatch.setattr(sys, "stderr", None)
    cli.warn("lost")
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    "flags, says",
    [
        (["--resume", "--lr", 0.1], "--lr"),
        (["--resume", "--iterations", 4], "--iterations"),
        (["--iterations", 20], "--resume"),
    ],
)
def test_a_run_is_never_overwritten_and_keeps_its_settings(finished, capsys, flags, says):
    before = contents(finished)
    assert says in error_of(capsys, train.main, "--out", finished, *flags)
    resume(finished)  # there is nothing left to train, so nothing is recorded
    assert contents(finished) == before


def test_any_file_of_a_run_is_kept(finished, tmp_path, capsys):
    """Those that a run leaves, but for its picture and its lock."""
    for name in contents(finished).keys() - {"curves.png", "lock"}:
        (tmp_path / name).mkdir()
        assert name in error_of(capsys, train.main, *TINY, "--out", tmp_path)
        (tmp_path / name).rmdir()
    assert not [*tmp_path.iterdir()]


def test_a_device_that_jax_does_not_have_is_one_line(tmp_path):
    command = [sys.executable, ROOT / "train.py", *FLAGS, "--out", tmp_path / "run"]
    options = dict(env=os.environ | dict(JAX_PLATFORMS="cuda"), timeout=SECONDS)
    done = subprocess.run(command, capture_output=True, text=True, **options)
    says = "train.py: JAX finds no device, and JAX_PLATFORMS is cuda"
    assert done.returncode == 2 and done.stderr.splitlines()[-1].startswith(says)
    assert "Traceback" not in done.stderr and not (tmp_path / "run").exists()


def test_a_reward_of_the_wrong_shape_shows_its_own_line(tmp_path, monkeypatch):
    """tutorial.md invites people to write one. A bug keeps its traceback, and nothing is kept."""

    def mine(velocity, command):
        return rewards.flat(velocity, command) + np.zeros(3)

    monkeypatch.setitem(tasks.TASKS, "flat", tasks.TASKS["flat"]._replace(reward=mine))
    with pytest.raises(ValueError, match="broadcast") as shown:
        run("--out", tmp_path / "run")
    assert shown.traceback[-1].name == "mine"
    assert set(contents(tmp_path / "run")) <= {"lock"}


def test_a_picture_that_cannot_be_drawn_is_one_line(finished, capsys, monkeypatch):
    monkeypatch.setattr(metrics, "PANELS", {"too few": "panels"})
    metrics.draw_curves(finished)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("train.py: no picture")


def test_the_commit_is_that_of_this_source(tmp_path, monkeypatch):
    """With a + once it was changed, and unknown where git does not track it, as in a copy."""

    def changed(name, text="# other"):
        (tmp_path / name).write_text(text)
        return run_folder.commit()

    monkeypatch.setattr(run_folder, "__file__", str(tmp_path / "run_folder.py"))
    assert changed("run_folder.py") == changed("go1.xml") == "unknown"
    user = ["-c", "user.name=x", "-c", "user.email=x"]
    for command in ("init -q", "add .", "commit -q -m x"):
        subprocess.run(["git", *user, *command.split()], cwd=tmp_path, check=True)
    monkeypatch.setenv("GIT_DIR", str(ROOT / "nowhere"))  # somebody's shell, of something else
    clean = run_folder.commit()
    assert len(clean) == 40 and changed("table") == clean  # which is no source
    for name in ("run_folder.py", "go1.xml"):
        assert changed(name, "mine") == clean + "+" and changed(name) == clean
    assert changed("new.py") == clean + "+"
    monkeypatch.setattr(run_folder, "__file__", str(tmp_path / "new.py"))
    assert run_folder.commit() == "unknown"
    monkeypatch.undo()
    monkeypatch.setenv("PATH", "")  # there is no git
    assert run_folder.commit() == "unknown"


def without_a_setting(path):
    """As an older checkpoint may be: today's default would go on with another learner."""
    arrays = run_folder.read_npz(path)
    settings = json.loads(str(arrays["settings"]))
    del settings["learner"]["target_kl"]
    np.savez(path, **arrays | dict(settings=np.array(json.dumps(settings))))


@pytest.mark.parametrize(
    ("file", "damage", "says"),
    [
        ("checkpoint.npz", lambda path: path.unlink(), "No such file or directory"),
        ("checkpoint.npz", without_a_setting, "settings and ours differ in target_kl"),
        ("checkpoint.npz", lambda path: path.write_bytes(path.read_bytes()[:-500]), "is damaged"),
        ("config.json", lambda path: path.unlink(), "No such file or directory"),
        (
            "metrics.csv",
            lambda path: path.write_text(path.read_text().replace("reward", "mine", 1)),
            "has other columns",
        ),
        (
            "metrics.csv",
            lambda path: path.write_text("".join(path.read_text().splitlines(True)[:-1])),
            "ends before iteration 20 of the checkpoint: move it away",
        ),
    ],
    ids=[
        "missing",
        "of an older learner",
        "truncated",
        "without its record",
        "other columns",
        "a row short",
    ],
)
def test_what_cannot_be_resumed_is_one_line_and_loses_nothing(copied, capsys, file, damage, says):
    damage(copied / file)
    before = contents(copied)
    said = error_of(capsys, train.main, "--out", copied, "--resume", "--iterations", 22)
    assert file in said and says in said and contents(copied) == before


@contextmanager
def full_disk(size):
    """Meanwhile no file can grow beyond `size` bytes, which the system reports much as it reports a
    full disk.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


# NumPy 2.0 leaves an archive open that it could not write, which complains when it is collected
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_full_disk_is_one_line_and_loses_nothing(copied, capsys):
    """The checkpoint does not fit, which is said once, and at the end. The old one goes on as if
    nothing had happened.
    """
    before = (copied / "checkpoint.npz").read_bytes()
    with full_disk(20_000):
        again = "--out", copied, "--resume", "--iterations", 22
        assert train.main([str(x) for x in again]) == 1
    tried, lost = capsys.readouterr().err.splitlines()
    assert "too large" in tried and "tries again" in tried and "checkpoint is lost" in lost
    assert (copied / "checkpoint.npz").read_bytes() == before
    assert not [name for name in contents(copied) if name.endswith(".tmp")]
    resume(copied, "--iterations", 22)
    assert [row[0] for row in rows(copied)[1:]] == [str(i) for i in range(1, 23)]


def test_a_folder_that_cannot_be_is_one_line(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    assert "file" in error_of(capsys, train.main, *TINY, "--out", "file/run")


# ---- the numbers of a run ----


NUMBERS = dict(reward=0, task_reward=1.25, v_x=0, power=0, alpha=290.12)
NUMBERS |= dict(steps_per_s=1, time_s=1, iteration=1)


@pytest.mark.parametrize("terminal, shown", [(True, [1, 2, 3, 4, 5, 6]), (False, [1, 4, 6])])
def test_the_console(tmp_path, capsys, monkeypatch, terminal, shown):
    """A pipe shows the first row at once and then one in half a minute. The first iteration also
    compiled, so what it took does not count: 360 s for three, so four minutes for the last two.
    """
    monkeypatch.setattr(sys.stdout, "isatty", lambda: terminal)
    log = metrics.Log(tmp_path, 0, 6)
    for iteration, seconds in enumerate((2000, 2010, 2029, 2360, 2370, 2375), 1):
        log.show(NUMBERS | dict(iteration=iteration, time_s=seconds))
    lines = [line for line in capsys.readouterr().out.replace("\r", "\n").split("\n") if line]
    assert [int(line.split("/")[0]) for line in lines] == shown
    assert "left" not in lines[0] and "task 1.25" in lines[0]
    assert "  4 min left" in lines[shown.index(4)]


def test_steps_per_second_are_of_this_process(tmp_path, monkeypatch):
    """Of 20 iterations of 96 steps 18 were there. The other two took 4 s."""
    monkeypatch.setattr(metrics, "time", SimpleNamespace(monotonic=iter((0.0, 4.0)).__next__))
    log = metrics.Log(tmp_path, 18, 20)
    log.add(20, NUMBERS | dict(steps=20 * 96))
    row = dict(zip(*(line.split(",") for line in log.lines), strict=True))
    assert (row["time_s"], row["steps_per_s"]) == ("4.0", "48.0")


# ---- what JAX is told ----

OFF = "--xla_cpu_experimental_ynn_fusion_type="


@pytest.mark.parametrize(
    ("jaxlib", "given", "flags"),
    [
        ("0.10.0", "", []),
        ("0.12.0", "--a=1", ["--a=1", OFF]),
        ("0.12.1", "", []),
        ("0.11.0", f"{OFF}2", [f"{OFF}2"]),
    ],
)
def test_train_turns_ynn_off_where_it_is_known(monkeypatch, jaxlib, given, flags):
    monkeypatch.setattr(jax_setup, "version", lambda package: jaxlib)
    monkeypatch.setenv("XLA_FLAGS", given)
    with pytest.raises(SystemExit):
        train.main(["-h"])
    assert os.environ["XLA_FLAGS"].split() == flags
