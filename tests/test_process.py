"""What a program meets in its process: settings of JAX, closed descriptors, a full memory."""

import subprocess
import sys
from types import SimpleNamespace

import jax
import pytest
from support import ROOT, TINY, error_of

import train
from runtime import checkpoint, cli, jax_setup, metrics, run_folder


@pytest.fixture
def folder(tmp_path):
    """A run of one iteration."""
    assert train.main([*TINY, "--iterations", "1", "--out", str(tmp_path / "run")]) == 0
    return tmp_path / "run"


def test_any_setting_of_jax_is_kept_and_compared(folder, capsys, monkeypatch):
    """What the environment sets stands in config.json. Nothing is said of what was not known
    before, of a log, or of a path, which is not kept.
    """

    def said(iterations, **settings):
        config = SimpleNamespace(values=dict(jax.config.values) | settings)
        monkeypatch.setattr(jax_setup, "jax", SimpleNamespace(config=config, devices=jax.devices))
        again = "--out", str(folder), "--resume", "--iterations", str(iterations)
        assert train.main(again) == 0
        return capsys.readouterr().err

    capsys.readouterr()
    assert said(2, jax_new=1, jax_gone=1, jax_log=1, jax_file="/home/me") == ""
    monkeypatch.setenv("JAX_NEW", "2")
    monkeypatch.setenv("XLA_FLAGS", "--xla_file=/home/me")
    assert "began with jax_new 1 and not 2: last" in said(3, jax_new=2, jax_log=2, jax_file="/home")
    kept = [start["jax"].get("jax_new") for start in run_folder.starts(folder)]
    assert kept == [None, None, "2"]
    *_, kept = checkpoint.load_settings(folder / "checkpoint.npz")
    assert "/home" not in str(kept) and kept["jax_threefry_partitionable"] == "True"


def test_a_terminal_renews_one_line_whatever_its_width(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setattr(metrics, "console_line", lambda *_: "x" * 120)
    log = metrics.Log(tmp_path, 0, 6)
    for columns, shown in (("80", 79), ("160", 120)):
        monkeypatch.setenv("COLUMNS", columns)
        log.show(dict(iteration=1, time_s=1))
        assert capsys.readouterr().out == "\r" + "x" * shown + "\x1b[K"


def test_what_a_program_opens_is_no_standard_stream():
    """`train.py <&- >&- 2>&-` closes them, and its lock would be number 0. The status is 3, the
    number of what is opened here.
    """
    code = """
import os
from runtime.cli import program
os.closerange(0, 3)
raise SystemExit(program("any.py")(lambda argv: os.open(os.devnull, os.O_RDONLY))([]))
"""
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 3


@pytest.mark.skipif(sys.platform != "linux", reason="needs /dev/full")
def test_a_full_disk_under_the_console_ends_no_run():
    """Linux has a device that is a full disk."""
    code = "from runtime.cli import program, say"
    code += "; raise SystemExit(program('any.py')(lambda argv: say('lost') or 3)([]))"
    with open("/dev/full", "w") as full:
        assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, stdout=full).returncode == 3


@pytest.mark.parametrize(
    "error",
    [
        ValueError("std::bad_alloc"),  # of MuJoCo's Batch
        RuntimeError("Caught an unknown exception!"),  # of its Batch.expand
        RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 8 bytes"),  # of JAX
    ],
    ids=str,
)
def test_what_c_plus_plus_cannot_allocate_is_one_line(capsys, error):
    def main(argv):
        raise error

    assert cli.program("any.py")(main)([]) == 2
    assert capsys.readouterr().err == "any.py: out of memory\n"


def test_a_refusal_fits_a_screen():
    """However much of a file the error quotes."""
    with pytest.raises(cli.Refused) as refused, run_folder.reading("runs.csv"):
        raise ValueError("x" * 14_000)
    assert 200 < len(str(refused.value)) < 300


@pytest.mark.parametrize("threads", ["abc", "0", "-1", ""])
def test_a_number_of_threads_that_is_none_is_refused(tmp_path, capsys, monkeypatch, threads):
    monkeypatch.setenv("PJRT_NPROC", threads)
    said = error_of(capsys, train.main, *TINY, "--out", tmp_path / "run")
    assert f"PJRT_NPROC is {threads}: it must be a number" in said
