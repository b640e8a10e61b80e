"""A run on several processes: the same learner on all, one run folder, and whoever is left says why
it ends.
"""

import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import ExitStack

import jax
import numpy as np
import pytest
from support import ROOT, SECONDS, TINY, error_of

import ppo
import train
from eipo import Config, Estimate, Rollout
from runtime import metrics, parallel, run_folder

FLAGS = [
    *TINY,
    "--num-envs",
    "8",
    "--threads",
    "1",
    "--checkpoint-every",
    "4",
    "--task",
    "curriculum",
    "--iterations",
]
ONE_BATCH = Config(
    num_epochs=4, num_minibatches=1, hidden=(8,), hidden_estimator=(8,), mirror=False
)


def data_of_an_update(processes=1, process=0):
    """A learner, and what `ppo_update` takes: that process's share of 64 environments, not of its
    own making.
    """
    rng, widths = np.random.default_rng(0), (6, 3, 4)
    learner = ppo.init_learner(jax.random.key(0), widths, None, 2, ONE_BATCH)
    obs, privileged, action = (rng.normal(size=(10, 64, n)).astype(np.float32) for n in widths)
    advantage, likely = (
        3 + rng.normal(size=(10, 64)).astype(np.float32),
        rng.normal(-6, 0.1, (10, 64)),
    )
    target = rng.normal(size=(10, 64, 2)).astype(np.float32)
    share = np.arange(64).reshape(processes, -1)[process]
    obs, privileged, action, advantage, likely, target = (
        x[:, share] for x in (obs, privileged, action, advantage, likely.astype(np.float32), target)
    )
    tau = Rollout(obs, privileged, action, None, None, None, None, None)
    return (
        learner,
        tau,
        Estimate(None, target, likely),
        advantage,
        jax.random.key(process),
        ONE_BATCH,
    )


def arrays_of(learner, log):
    """A Learner and a log by name."""
    return {
        jax.tree_util.keystr(path): np.asarray(x)
        for path, x in jax.tree_util.tree_leaves_with_path((learner, log))
    }


def process(out, *flags):
    """What one process of a test does: train, keep what it holds at each checkpoint, and compute
    one update.
    """
    save, meet = train.save, train.meet

    def meet_and_wait(*args):
        time.sleep(float(os.environ["PAUSE"]))
        return meet(*args)

    def save_and_keep(folder, state, envs, cfg, params):
        save(folder, state, envs, cfg, params)
        np.savez(f"{out}.{jax.process_index()}.npz", **run_folder.checkpoint_arrays(state, envs))

    train.save, train.meet = save_and_keep, meet_and_wait
    metrics.draw = lambda folder, weights: None  # takes longer than to train
    status = train.main(list(flags))
    if status or "--resume" in flags:
        return status
    update = arrays_of(
        *ppo.ppo_update(*data_of_an_update(jax.process_count(), jax.process_index()))
    )
    np.savez(f"{out}.{jax.process_index()}.update.npz", **update)
    return status


def free_port():
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        return server.getsockname()[1]


def start(folder, *flags, port=None, processes=2, only=None, pause=0):
    """Start the processes of a run, or only those named. pause: s that each waits after an
    iteration.
    """
    flags = [
        *flags,
        "--out",
        folder,
        "--coordinator",
        f"127.0.0.1:{port or free_port()}",
        "--processes",
        processes,
    ]
    command = [sys.executable, __file__, folder, *flags, "--process"]
    pipes = dict(stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    env = os.environ | dict(PYTHONPATH=f"{ROOT}:{ROOT / 'tests'}", PJRT_NPROC="1", PAUSE=str(pause))
    return [
        subprocess.Popen([str(x) for x in (*command, i)], env=env, **pipes)
        for i in only or range(processes)
    ]


def ended(processes, seconds=SECONDS):
    """Exit statuses and what was said on stderr, of all; none may take longer."""
    end = time.monotonic() + seconds
    with ExitStack() as stack:
        for process in processes:
            stack.enter_context(process)
            stack.callback(process.kill)
        said = [
            process.communicate(timeout=max(1, end - time.monotonic()))[1] for process in processes
        ]
    return [process.returncode for process in processes], said


def wait_for_rows(folder, processes, rows):
    """Until metrics.csv has so many. If it never has, the processes are killed."""
    table, end = folder / "metrics.csv", time.monotonic() + SECONDS
    with ExitStack() as stack:
        for process in processes:
            stack.callback(process.kill)
        while not table.exists() or table.read_text().count("\n") <= rows:
            assert time.monotonic() < end and all(process.poll() is None for process in processes)
            time.sleep(0.002)
        stack.pop_all()


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run of 12 iterations on two processes, and what each of them holds at its end.

    Each process compiles for itself, which takes a minute on one core.
    """
    folder = tmp_path_factory.mktemp("parallel") / "run"
    assert ended(start(folder, *FLAGS, 12)) == ([0, 0], ["", ""])
    return folder


def held(folder, process):
    return run_folder.read_npz(folder.with_name(f"{folder.name}.{process}.npz"))


@pytest.mark.slow
def test_two_processes_hold_one_learner_and_environments_of_their_own(finished):
    """The learner, alpha and the curriculum are equal to the bit; simulations are not, and the
    checkpoint has both.
    """
    first, second = (held(finished, i) for i in range(2))
    assert set(first) == set(second) and "state.pi.params['critic'][0].even" in first
    own = "env", "state.key", "state.start"
    common = {name for name in first if name.endswith("weights") or not name.startswith(own)}
    assert [name for name in common if first[name].tobytes() != second[name].tobytes()] == []
    names = ["env0.sim", "env1.sim", "env0.command", "state.key"]
    for name in [*names, "state.start[0]", "state.start_prime[0]"]:
        assert len(first[name]) == 2 and not np.array_equal(first[name], second[name])
    stored = run_folder.read_npz(finished / "checkpoint.npz")
    expected = first | {
        f"1/{name}": second[name]
        for name in set(second) - common | {"env0.command_weights", "env1.command_weights"}
    }
    assert set(expected) | {"settings"} == set(stored)
    assert [name for name, x in expected.items() if x.tobytes() != stored[name].tobytes()] == []
    columns = metrics.read(finished)
    assert (
        columns["iteration"].tolist() == list(range(1, 13)) and columns["steps"][-1] == 12 * 4 * 8
    )


@pytest.mark.slow
def test_two_processes_make_the_update_of_one(finished):
    """With half of the environments each, and one minibatch, so that its samples are the same.

    Only the order of the sums differs: some 1e-7 of a gradient in float32. Adam divides a gradient
    by its own size, so that a weight moves by 3e-4 in each of the four updates; 1e-3 of that is
    allowed.
    """
    whole = arrays_of(*ppo.ppo_update(*data_of_an_update()))
    halves = [
        run_folder.read_npz(finished.with_name(f"{finished.name}.{i}.update.npz")) for i in range(2)
    ]
    before = data_of_an_update()[0].params["critic"][0].even
    name = "[0].params['critic'][0].even"
    assert np.abs(whole[name] - before).max() > 1e-3
    for name, x in whole.items():
        assert halves[0][name].tobytes() == halves[1][name].tobytes(), name
        np.testing.assert_allclose(halves[0][name], x, rtol=1e-5, atol=3e-7, err_msg=name)


def test_alone_nothing_is_changed():
    """Nor copied: without the flags a run is the same to the bit."""
    tree, key = dict(a=np.float64(0.1), b=(1, 2.5)), jax.random.PRNGKey(0)
    assert parallel.average(tree) is tree and parallel.own_key(key) is key
    assert parallel.pooled(dict(mean=0.1, count=3)) == dict(mean=0.1, count=3.0)
    assert parallel.gather(tree)[0] is tree and len(parallel.gather(tree)) == 1
    weights, before = np.array([0.1, 1.0]), np.array([0.3, 0.0])
    assert train.meet(False, weights, before) is False and train.meet(True, weights, before) is True
    assert weights.tolist() == [0.1, 1.0]


PLACE = ["--coordinator", "127.0.0.1:9", "--processes", "2", "--process"]


@pytest.mark.parametrize(
    "flags, says",
    [
        (["--processes", "2"], "--coordinator"),
        (PLACE[:4], "--process"),
        ([*PLACE[2:], "1"], "--coordinator"),
        ([*PLACE, "2"], "2"),
        ([*PLACE, "-1"], "-1"),
        (["--coordinator", "127.0.0.1", *PLACE[2:], "0"], "HOST:PORT"),
        ([*PLACE, "0", "--num-envs", "6"], "multiple of 4"),
        ([*PLACE, "1", "--num-envs", "4", "--num-steps", "2"], "num_minibatches"),
        ([*PLACE, "1", "--algo", "ppo", "--num-envs", "3"], "multiple of 2"),
    ],
)
def test_flags_that_do_not_fit_are_one_line(tmp_path, capsys, flags, says):
    assert says in error_of(capsys, train.main, *flags, "--out", tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_another_number_of_processes_cannot_resume(finished, capsys):
    before = (finished / "checkpoint.npz").read_bytes()
    assert "2 process" in error_of(capsys, train.main, "--out", finished, "--resume")
    assert (finished / "checkpoint.npz").read_bytes() == before


def resumes(finished, folder):
    """Resume the run on two processes; it ends with the bits of the one that was never stopped."""
    assert ended(start(folder, "--resume"))[0] == [0, 0]
    for i in range(2):
        one, other = held(finished, i), held(folder, i)
        assert [name for name in one if one[name].tobytes() != other[name].tobytes()] == []


@pytest.mark.slow
@pytest.mark.parametrize("victim", [0, 1])
def test_kill_9_of_one_ends_the_other_and_both_resume(finished, tmp_path, victim):
    folder = tmp_path / "run"
    processes = start(folder, *FLAGS, 12, pause=0.5)
    wait_for_rows(folder, processes, 5)
    processes[victim].kill()
    # on a busy machine; it is told within one
    statuses, said = ended(processes, 3 * parallel.SILENCE)
    assert statuses[victim] == -signal.SIGKILL and statuses[1 - victim] == 2
    (line,) = said[1 - victim].splitlines()
    assert line.startswith("train.py: another process has ended") and "--resume" in line
    resumes(finished, folder)


@pytest.mark.slow
def test_a_stop_that_one_is_asked_for_stops_both(finished, tmp_path):
    folder = tmp_path / "run"
    processes = start(folder, *FLAGS, 12, pause=0.5)  # or all is done before they are asked
    wait_for_rows(folder, processes, 5)
    processes[1].send_signal(signal.SIGTERM)
    assert ended(processes)[0] == [130, 130]
    assert 5 <= len(metrics.read(folder)["iteration"]) < 12
    resumes(finished, folder)


@pytest.mark.slow
def test_other_flags_of_another_process_are_one_line(tmp_path):
    folder, port = tmp_path / "run", free_port()
    lrs = enumerate((1e-4, 2e-4))
    statuses, said = ended(
        [p for i, lr in lrs for p in start(folder, *FLAGS, 2, "--lr", lr, port=port, only=[i])]
    )
    assert statuses == [2, 2] and all(len(text.splitlines()) == 1 for text in said)
    assert any("--lr" in text for text in said)


@pytest.mark.slow
def test_a_taken_port_and_others_who_do_not_come_are_one_line(tmp_path):
    with socket.create_server(("::", 0), family=socket.AF_INET6, dualstack_ipv6=True) as server:
        port = server.getsockname()[1]
        taken = ended(start(tmp_path / "run", *FLAGS, 2, port=port, only=[0]))
    for (statuses, (text,)), says in (
        (taken, "port taken"),
        (ended(start(tmp_path / "run", *FLAGS, 2, only=[1])), "not all of 2 processes"),
        (ended(start(tmp_path / "run", *FLAGS, 2, only=[0])), "not all of 2 processes"),
    ):
        (line,) = text.splitlines()
        assert statuses == [2] and line.startswith("train.py: ") and says in line
    assert not (tmp_path / "run").exists()


if __name__ == "__main__":
    sys.exit(process(*sys.argv[1:]))
