"""A sweep: one script trains the lines of a list, two at a time, and goes on where it ended."""

import os
import shutil
import signal
import subprocess
import sys
import time

import pytest
from support import ROOT, SECONDS, TINY, heard, started

from results.__main__ import main
from runtime import metrics, run_folder
from runtime.flags import parse

FLAGS = " ".join([*TINY, "--task flat --iterations 40 --checkpoint-every 10"])
NAMES = "flat-eipo-lam0.005-seed1", "flat-ppo-lam0-seed1", "flat-ppo-lam0.02-seed1"
LINES = f"""{NAMES[0]} {FLAGS} --seed 1
{NAMES[1]} {FLAGS} --seed 1 --algo ppo --lam 0
flat-broken {FLAGS} --lam -1
{NAMES[2]} {FLAGS} --seed 1 --algo ppo --lam 0.02
"""


@pytest.fixture
def checkout(tmp_path):
    """A copy of the source, with a list of runs, and this Python as its own."""
    place = tmp_path / "checkout"
    ignored = shutil.ignore_patterns(".git", ".venv", "runs", "*.gif", "*.png", "*.gz", "*.npz")
    shutil.copytree(ROOT, place, ignore=ignored)
    (place / ".venv" / "bin").mkdir(parents=True)
    (place / ".venv" / "bin" / "python").write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n')
    (place / ".venv" / "bin" / "python").chmod(0o755)
    (place / "list").write_text(LINES)
    return place


def sweep(checkout, numbers, **options):
    """Start `seq | xargs sweep.sh` as docs/runs.md has it, in a process group of its own."""
    command = f"printf '%s\\n' {numbers} | xargs -P 2 -n 1 results/sweep.sh list"
    with heard():
        return subprocess.Popen(
            command, shell=True, cwd=checkout, env=os.environ, start_new_session=True, **options
        )


def contents(folder):
    return {name: x.tobytes() for name, x in run_folder.read_npz(folder / "checkpoint.npz").items()}


def test_a_line_of_a_list_is_what_is_trained(checkout):
    """A stand-in for Python says what it is asked to run. Also as a copy that SLURM has made."""
    (checkout / ".venv/bin/python").write_text('#!/bin/sh\necho "$PJRT_NPROC $@"\n')
    script, folder = checkout / "results/sweep.sh", checkout / "runs" / NAMES[1]
    slurm = shutil.copy(script, checkout.parent / "copy.sh")
    unset = {x: y for x, y in os.environ.items() if not x.startswith(("SLURM", "CORES", "PJRT"))}
    flags = f"train.py {FLAGS} --seed 1 --algo ppo --lam 0"

    def said(*command, cwd=checkout.parent, **env):
        subprocess.run([str(x) for x in command], cwd=cwd, env=unset | env, check=True)
        return (checkout / f"runs/{NAMES[1]}.log").read_text().splitlines()[-1]

    out = f"--out runs/{NAMES[1]}"
    listed = checkout / "list"
    assert said(script, listed, 1) == f"1 {flags} --threads 1 {out}"
    parse(said(script, listed, 1).split()[2:])  # train.py takes it
    assert said(script, listed, 1, CORES="3") == f"3 {flags} --threads 3 {out}"
    # killed in its first save: it starts anew
    for name in ("config.json", "metrics.csv", "policy.npz", "policy_prime.npz"):
        (folder / name).touch()
    array = dict(SLURM_ARRAY_TASK_ID="1", SLURM_CPUS_PER_TASK="2")
    array |= dict(SLURM_SUBMIT_DIR=str(checkout))
    assert said("bash", slurm, listed, CORES="3", **array) == f"2 {flags} --threads 2 {out}"
    assert {path.name for path in folder.iterdir()} == {"lock"}
    (folder / "policy.npz").touch()
    said(script, listed, 1)  # somebody keeps nothing but the policy, and train.py refuses
    assert (folder / "policy.npz").exists()
    (folder / "metrics.csv").write_text("iteration\n1\n2\n")
    said(script, listed, 1)  # somebody has deleted its checkpoint
    assert (folder / "metrics.csv").exists()
    (folder / "checkpoint.npz").touch()
    assert said(script, listed, 1) == f"1 {flags} --resume --threads 1 {out}"
    with pytest.raises(subprocess.CalledProcessError):
        said(script, listed, 4)


@pytest.mark.parametrize("kill", [os.kill, os.killpg], ids=["script", "group"])
def test_who_ends_the_script_ends_the_run(checkout, kill):
    """A stand-in for Python says how often it hears SIGTERM, and takes a while to save."""
    loop = "trap 'echo heard' TERM; echo up; for i in $(seq 20); do sleep 0.1; done; echo saved"
    (checkout / ".venv/bin/python").write_text(f"#!/bin/sh\n{loop}\n")
    log = checkout / f"runs/{NAMES[0]}.log"
    with started([checkout / "results/sweep.sh", "list", "0"], cwd=checkout, process_group=0) as x:
        while not log.exists() or not log.read_text():
            time.sleep(0.01)
        kill(x.pid, signal.SIGTERM)
        assert x.wait() == 0
    said = log.read_text()
    assert said.count("heard") == 1 and said.endswith("saved\n")


@pytest.mark.slow
def test_a_sweep_that_is_killed_goes_on_with_the_same_bits(checkout, tmp_path):
    """The line that is refused ends no other one. Another start of all trains what is left."""
    runs = checkout / "runs"
    killed = sweep(checkout, "0 1")
    late = time.monotonic() + SECONDS
    while not (runs / NAMES[0] / "checkpoint.npz").exists():
        assert time.monotonic() < late and killed.poll() is None
        time.sleep(0.01)
    os.killpg(killed.pid, signal.SIGKILL)
    killed.wait()
    assert metrics.read(runs / NAMES[0])["iteration"][-1] < 40
    assert sweep(checkout, "0 1 2 3").wait(SECONDS) == 123  # what xargs says where one has failed
    assert "--lam" in (runs / "flat-broken.log").read_text()
    for name in NAMES:
        assert metrics.read(runs / name)["iteration"].tolist() == list(range(1, 41))
    before = contents(runs / NAMES[0])
    assert sweep(checkout, "0").wait(SECONDS) == 0  # it is finished, and ends at once
    shutil.rmtree(runs / NAMES[0])
    assert sweep(checkout, "0").wait(SECONDS) == 0
    assert contents(runs / NAMES[0]) == before
    folders = [str(path.parent) for path in runs.glob("flat-*/policy.npz")]
    assert len(folders) == 3
    tables = ["--results", str(tmp_path), "--episodes", "11"]
    assert main(["add", *folders, *tables]) == 0
    assert main(["weights", str(tmp_path / "flat"), "--out", str(tmp_path)]) == 0
    assert (tmp_path / "weights.png").stat().st_size > 10_000
