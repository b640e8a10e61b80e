"""A sweep: one script trains the lines of a table, two at a time, and goes on where it ended."""

import os
import shutil
import signal
import subprocess
import sys
import time

import pytest
from support import ROOT, SECONDS, TINY, heard

from results.__main__ import main
from runtime import metrics, run_folder

FLAGS = " ".join([*TINY, "--task flat --iterations 40 --checkpoint-every 10"])
NAMES = "flat-eipo-lam0.005-seed1", "flat-ppo-lam0-seed1", "flat-ppo-lam0.02-seed1"
LINES = f"""{NAMES[0]} {FLAGS} --seed 1
{NAMES[1]} {FLAGS} --seed 1 --algo ppo --lam 0
flat-broken {FLAGS} --lam -1
{NAMES[2]} {FLAGS} --seed 1 --algo ppo --lam 0.02
"""


@pytest.fixture
def checkout(tmp_path):
    """A copy of the source, with a table, and this Python as its own."""
    place = tmp_path / "checkout"
    ignored = shutil.ignore_patterns(".git", ".venv", "runs", "*.gif", "*.png", "*.gz", "*.npz")
    shutil.copytree(ROOT, place, ignore=ignored)
    (place / ".venv" / "bin").mkdir(parents=True)
    (place / ".venv" / "bin" / "python").write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n')
    (place / ".venv" / "bin" / "python").chmod(0o755)
    (place / "table").write_text(LINES)
    return place


def sweep(checkout, numbers, **options):
    """Start `seq | xargs sweep.sh` as docs/cluster.md has it, in a process group of its own."""
    command = f"printf '%s\\n' {numbers} | xargs -P 2 -n 1 results/sweep.sh table"
    with heard():
        return subprocess.Popen(
            command, shell=True, cwd=checkout, env=os.environ, start_new_session=True, **options
        )


def contents(folder):
    return {name: x.tobytes() for name, x in run_folder.read_npz(folder / "checkpoint.npz").items()}


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
    folders = [str(runs / name) for name in NAMES]
    tables = ["--results", str(tmp_path), "--episodes", "11"]
    assert main(["add", *folders, *tables]) == 0
    assert main(["tradeoff", str(tmp_path / "flat"), "--out", str(tmp_path)]) == 0
    assert (tmp_path / "tradeoff.png").stat().st_size > 10_000
