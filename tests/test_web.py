"""play.py --web: who may look, and what stands in the way."""

import signal
import socket
import sys
import time
from pathlib import Path
from urllib.request import urlopen

import pytest
from support import ROOT, SECONDS, error_of, make_run, started

import play


def answers(port):
    try:
        with urlopen(f"http://127.0.0.1:{port}/", timeout=5) as page:
            return page.status == 200
    except OSError:
        return False


@pytest.mark.go1
def test_only_this_machine_may_look():
    """`play.py --web` serves the shipped policy on a free port of this machine and on no other
    address. Ctrl-C ends it.
    """
    pytest.importorskip("mujoco.studio")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    argv = ["play.py", "results/flat", "--web", "--port", str(port), "--command", "0.6", "0", "0"]
    with started([sys.executable, *argv], cwd=ROOT) as process:
        late = time.monotonic() + SECONDS
        while not answers(port):
            assert time.monotonic() < late
            time.sleep(0.5)
        table = Path("/proc/net/tcp").read_text()
        listening = [line.split()[1] for line in table.splitlines() if f":{port:04X} " in line]
        assert {address.split(":")[0] for address in listening} == {"0100007F"}
        process.send_signal(signal.SIGINT)
        assert process.wait() == 130


def test_a_taken_port_is_one_line(tmp_path, capsys):
    pytest.importorskip("mujoco.studio")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        says = error_of(capsys, play.main, make_run(tmp_path / "run"), "--web", "--port", port)
    assert "in use" in says


def test_an_older_mujoco_is_one_line(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco.studio", None)
    assert "MuJoCo 4.0" in error_of(capsys, play.main, make_run(tmp_path / "run"), "--web")
