"""play.py --web: the policy in a real browser, where there is one."""

import base64
import io
import json
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from urllib.request import urlopen

import numpy as np
import pytest
from PIL import Image
from support import ROOT, error_of, heard, make_run

import play

BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
SECONDS = 90  # in which the page must have shown a robot; on an idle core it takes 15


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """`play.py --web` of the shipped policy on a free port: the process and its port."""
    pytest.importorskip("mujoco.studio")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    argv = ["play.py", "results/flat", "--web", "--port", str(port), "--command", "0.6", "0", "0"]
    with open(tmp_path_factory.mktemp("web") / "said", "w") as said, heard():
        process = subprocess.Popen([sys.executable, *argv], cwd=ROOT, stdout=said, stderr=said)
    try:
        wait_for(lambda: answers(port))
        yield process, port
    finally:
        process.kill()
        process.wait()


def wait_for(happens):
    """What happens() returns once it is true. Fails after SECONDS."""
    end = time.monotonic() + SECONDS
    while time.monotonic() < end:
        if what := happens():
            return what
        time.sleep(0.5)
    raise AssertionError(f"{happens} did not happen in {SECONDS} s")


def answers(port):
    try:
        with urlopen(f"http://127.0.0.1:{port}/", timeout=5) as page:
            return page.status == 200
    except OSError:
        return False


class Page:
    """A page in a headless browser, which is asked by its own protocol for developers."""

    def __init__(self, url, folder):
        flags = "--headless=new --no-sandbox --use-angle=swiftshader --enable-unsafe-swiftshader"
        flags = [*flags.split(), "--window-size=320,240", "--remote-debugging-port=0"]
        argv = [BROWSER, *flags, f"--user-data-dir={folder}", url]
        self.process = subprocess.Popen(argv, stderr=subprocess.PIPE, text=True)
        said = (line for line in self.process.stderr if "DevTools listening on" in line)
        address = next(said).split("ws://")[1].split("/")[0]
        with urlopen(f"http://{address}/json") as answer:
            pages = json.load(answer)
        self.address = next(x["webSocketDebuggerUrl"] for x in pages if x["type"] == "page")

    def close(self):
        self.process.kill()
        self.process.wait()
        self.process.stderr.close()

    def picture(self):
        """A screenshot, (height, width, 3)."""
        from websockets.sync.client import connect  # MuJoCo 4 brings it

        with connect(self.address, max_size=2**26) as asked:
            asked.send(json.dumps(dict(id=1, method="Page.captureScreenshot")))
            answers = (json.loads(asked.recv(timeout=SECONDS)) for _ in range(100))
            data = next(x for x in answers if x.get("id") == 1)["result"]["data"]
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"), int)


def test_only_this_machine_may_look(server):
    """Nothing listens on the other addresses of this machine."""
    _, port = server
    table = Path("/proc/net/tcp").read_text()
    listening = [line.split()[1] for line in table.splitlines() if f":{port:04X} " in line]
    assert {address.split(":")[0] for address in listening} == {"0100007F"}


@pytest.mark.skipif(not BROWSER, reason="needs Chromium")
def test_a_robot_runs_in_the_browser(server, tmp_path):
    """The page draws the scene, of many colours, and a second later something has moved in its
    middle, where the camera keeps the robot. Ctrl-C ends the server.
    """
    process, port = server
    page = Page(f"http://127.0.0.1:{port}/", tmp_path / "profile")
    try:
        wait_for(lambda: len(np.unique(page.picture()[::4, ::4].reshape(-1, 3), axis=0)) > 300)
        first = page.picture()
        middle = tuple(slice(n // 3, 2 * n // 3) for n in first.shape[:2])
        wait_for(lambda: np.abs(page.picture() - first)[middle].max() > 100)
    finally:
        page.close()
    process.send_signal(signal.SIGINT)
    assert process.wait(30) == 130


def test_a_taken_port_is_one_line(tmp_path, capsys):
    pytest.importorskip("mujoco.studio")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        says = error_of(capsys, play.main, make_run(tmp_path / "run"), "--web", "--port", port)
    assert "in use" in says


def test_an_older_mujoco_is_one_line(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco.studio", None)
    assert "MuJoCo 4.0" in error_of(capsys, play.main, make_run(tmp_path / "run"), "--web")
