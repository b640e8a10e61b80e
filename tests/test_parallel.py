"""A run on several processes: the same learner on all, and nobody waits for ever."""

import hashlib
import os
import signal
import socket
import sys
import time
from contextlib import ExitStack

import jax
import numpy as np
import pytest
from support import ROOT, SECONDS, TINY, error_of, started

import ppo
import train
from eipo import Transition
from go1_env import Go1Env
from mirror import Mirrored
from runtime import metrics, parallel

FLAGS = [*TINY, "--num-envs", "8", "--threads", "1", "--checkpoint-every", "4"]
FLAGS += ["--task", "curriculum", "--iterations", "12"]


def one_update():
    """The weights of a learner after `ppo_update` with 640 samples in one minibatch, in a row."""
    cfg = ppo.PPOConfig(num_epochs=4, num_minibatches=1, hidden=(8,), hidden_estimator=(8,))
    rng = np.random.default_rng(0)
    env = Mirrored(Go1Env(1))
    learner = parallel.everywhere(ppo.init_learner(rng, env, ("reward", "cost"), cfg))
    widths = dict(obs=sum(env.obs_size), privileged=3, action=12)
    arrays = {name: rng.normal(size=(10, 64, n)).astype(np.float32) for name, n in widths.items()}
    arrays["log_prob"] = rng.normal(-17, 0.1, (10, 64)).astype(np.float32)
    tau = Transition(**dict.fromkeys(Transition._fields) | arrays)
    target = rng.normal(size=(10, 64, 2)).astype(np.float32)
    advantage = 3 + rng.normal(size=(10, 64)).astype(np.float32)
    key = parallel.everywhere(jax.random.PRNGKey(0))
    learner, _ = ppo.ppo_update(learner, tau, target, advantage, key, cfg)
    return np.concatenate([np.ravel(x) for x in jax.tree.leaves(learner.params)])


def process(out, *flags):
    """What one process of a test does: train slowly, and write down what it holds at its end."""
    held = {}
    sync, train.save = parallel.sync_stop_and_curriculum, keep_hash(train.save, held)
    parallel.sync_stop_and_curriculum = lambda *args: time.sleep(0.5) or sync(*args)
    metrics.draw_curves = lambda *_: None  # takes longer than to train
    status = train.main(list(flags))
    if status == 0:
        np.savez(f"{out}.{jax.process_index()}.npz", **held, update=one_update())
    return status


def keep_hash(save, held):
    """train.save that also puts the SHA-256 of the State's arrays into a dict."""

    def save_and_hash(folder, state, envs, *args):
        save(folder, state, envs, *args)
        leaves = [np.asarray(x).tobytes() for x in jax.tree.leaves(state)]
        held["learner"] = hashlib.sha256(b"".join(leaves)).hexdigest()
        held["weights"] = envs[0].commands.weights
        held["robots"] = envs[0].qpos

    return save_and_hash


def free_port():
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        return server.getsockname()[1]


def start(stack, folder, *flags, others=()):
    """The two processes of a run; others: flags of the second one alone."""
    place = ["--coordinator", f"127.0.0.1:{free_port()}", "--processes", 2, "--process"]
    env = os.environ | dict(PYTHONPATH=f"{ROOT}:{ROOT / 'tests'}", PJRT_NPROC="1")
    command = [sys.executable, __file__, folder, *flags, "--out", folder]
    each = [*command, *place, 0], [*command, *others, *place, 1]
    return [stack.enter_context(started(words, env=env)) for words in each]


def end(processes):
    """Exit statuses, and what was said on stderr."""
    said = [process.communicate()[1] for process in processes]
    return [process.returncode for process in processes], said


def wait_for_rows(folder, processes, rows):
    table, late = folder / "metrics.csv", time.monotonic() + SECONDS
    while not table.exists() or table.read_text().count("\n") <= rows:
        assert time.monotonic() < late and all(process.poll() is None for process in processes)
        time.sleep(0.002)


def held(folder, process):
    with np.load(f"{folder}.{process}.npz") as arrays:
        return dict(arrays)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The folder of a run of 12 iterations on two processes."""
    folder = tmp_path_factory.mktemp("parallel") / "run"
    with ExitStack() as stack:
        assert end(start(stack, folder, *FLAGS))[0] == [0, 0]
    return folder


@pytest.mark.slow
def test_two_processes_hold_one_learner_and_robots_of_their_own(finished):
    first, second = (held(finished, i) for i in range(2))
    assert first["learner"] == second["learner"]
    assert first["weights"].tobytes() == second["weights"].tobytes()
    assert not np.array_equal(first["robots"], second["robots"])
    columns = metrics.read(finished)
    assert columns["iteration"].tolist() == list(range(1, 13))
    assert columns["steps"][-1] == 12 * 4 * 8


@pytest.mark.slow
def test_two_processes_make_the_update_of_one(finished):
    """Only the order of sums differs: some 1e-7 of a gradient."""
    first, second = (held(finished, i)["update"] for i in range(2))
    assert first.tobytes() == second.tobytes()
    np.testing.assert_allclose(first, one_update(), atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("victim", [0, 1])
def test_kill_9_of_one_ends_the_other_and_both_resume(finished, tmp_path, victim):
    """It says why in a line, unless JAX, which notices it as well, ends it first."""
    folder = tmp_path / "run"
    with ExitStack() as stack:
        processes = start(stack, folder, *FLAGS)
        wait_for_rows(folder, processes, 5)
        processes[victim].kill()
        statuses, said = end(processes)
        assert statuses[victim] == -signal.SIGKILL and statuses[1 - victim] not in (0, 130)
        assert said[1 - victim]
    with ExitStack() as stack:
        assert end(start(stack, folder, "--resume"))[0] == [0, 0]
    for i in range(2):
        assert held(folder, i)["learner"] == held(finished, i)["learner"]
        assert held(folder, i)["robots"].tobytes() == held(finished, i)["robots"].tobytes()


@pytest.mark.slow
def test_a_stop_that_one_is_asked_for_stops_both(tmp_path):
    folder = tmp_path / "run"
    with ExitStack() as stack:
        processes = start(stack, folder, *FLAGS)
        wait_for_rows(folder, processes, 5)
        processes[1].send_signal(signal.SIGTERM)
        assert end(processes)[0] == [130, 130]
    assert 5 <= len(metrics.read(folder)["iteration"]) < 12


@pytest.mark.slow
def test_other_flags_of_another_process_are_a_line(tmp_path):
    with ExitStack() as stack:
        statuses, said = end(start(stack, tmp_path / "run", *FLAGS, others=["--lr", "1e-4"]))
    assert statuses == [2, 2]
    assert all("train.py: the processes have different flags" in text for text in said)
    assert not (tmp_path / "run").exists()


PLACE = ["--coordinator", "127.0.0.1:9", "--processes", "2", "--process"]


@pytest.mark.parametrize(
    "flags, says",
    [
        (["--processes", "2"], "--coordinator"),
        (PLACE[:4], "--process"),
        ([*PLACE, "2"], "2"),
        (["--coordinator", "127.0.0.1", *PLACE[2:], "0"], "HOST:PORT"),
        ([*PLACE, "0", "--num-envs", "6"], "multiple of 4"),
        ([*PLACE, "1", "--algo", "ppo", "--num-envs", "2", "--num-steps", "3"], "equal shares"),
    ],
)
def test_flags_that_do_not_fit_are_one_line(tmp_path, capsys, flags, says):
    assert says in error_of(capsys, train.main, *flags, "--out", tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_alone_nothing_is_changed():
    """Nor copied: without the flags a run is the same to the bit."""
    tree = dict(a=np.ones(2), b=(1, 2.5))
    for function in parallel.everyone, parallel.everywhere:
        assert function(tree) is tree
    weights, before = np.array([0.1, 1.0]), np.array([0.3, 0.0])
    assert parallel.sync_stop_and_curriculum(True, weights, before) is True
    assert weights.tolist() == [0.1, 1.0]


if __name__ == "__main__":
    sys.exit(process(*sys.argv[1:]))
