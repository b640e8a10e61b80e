"""Ctrl-C, SIGTERM, a closed terminal: how a run ends when it is told to, and how it says so."""

import ctypes
import os
import signal
import socket
import sys
import tempfile
import threading
from contextlib import contextmanager
from types import SimpleNamespace

STDERR = [2]  # its file descriptor, the last one


def say(text, file=None, end="\n"):
    """Print, whoever listens: Ctrl-C ends `tee` as well, and a terminal may be closed."""
    try:
        print(text, file=file, end=end, flush=True)
    except OSError:
        os.dup2(STDERR[-1], 1)  # from here on stdout is stderr, which may still reach someone


def stop_at_once(why):
    """End this process, with a line. Python's own way waits for JAX's threads, or crashes."""
    say("\n" * sys.stderr.isatty() + f"Stopped at once: {why}", sys.stderr)
    os._exit(130)


def stop_imports():
    """Let Ctrl-C end the process at once during imports, which take seconds."""
    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
        signal.signal(signal.SIGINT, lambda *_: stop_at_once("no training was under way"))


@contextmanager
def stop_at_boundary(folder):
    """Yields a namespace. Ctrl-C, SIGTERM or SIGHUP set its `asked`, to stop after this iteration.

    Asked again, or before the first iteration has set `worth_saving`, the process ends at once. A
    thread sees to that: a signal handler in Python would have to wait for the C++ that compiles.
    """
    stop = SimpleNamespace(asked=False, worth_saving=False)
    names = [name for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    numbers = [getattr(signal, name) for name in names]
    numbers = [n for n in numbers if signal.getsignal(n) != signal.SIG_IGN]  # nohup: no SIGHUP
    receive, send = socket.socketpair()

    def listen():
        with receive:
            while number := receive.recv(1):
                if number[0] in numbers and stop.worth_saving and not stop.asked:
                    stop.asked = True
                    say("\nStopping after this iteration. Ctrl-C again stops at once")
                elif number[0] in numbers and (folder / "checkpoint.npz").exists():
                    stop_at_once("--resume goes on from the last checkpoint")
                elif number[0] in numbers:
                    stop_at_once("there is no checkpoint")

    send.setblocking(False)
    threading.Thread(target=listen, daemon=True).start()
    wakeup = signal.set_wakeup_fd(send.fileno())
    before = {n: signal.signal(n, lambda *_: None) for n in numbers}
    try:
        yield stop
    finally:
        signal.set_wakeup_fd(wakeup)
        for number, handler in before.items():
            signal.signal(number, handler)
        send.close()


# ---- of one of several processes ----

LEAVING = threading.Lock()


def leave(why):
    """End one of several processes at once, with a line. Python's own way waits for lost ones."""
    LEAVING.acquire()  # for good: the first thread to come says why
    try:
        print(f"train.py: {why}", file=sys.stderr, flush=True)
    finally:  # also where nobody listens
        os._exit(2)


def leave_on_abort(why):
    """Leave, from now on, where C++ aborts: with the line why(text), where text is what C++ said.

    What C++ says goes to a file and not to stderr, which is left to Python.
    """
    said = tempfile.TemporaryFile()  # noqa: SIM115, it is needed to the end
    STDERR.append(os.dup(2))
    sys.stderr = os.fdopen(STDERR[-1], "w", buffering=1)
    os.dup2(said.fileno(), 2)

    @ctypes.CFUNCTYPE(None, ctypes.c_int)
    def aborted(_):
        leave(why(os.pread(said.fileno(), 2**20, 0).decode(errors="replace")))

    ctypes.CDLL(None).signal(signal.SIGABRT, aborted)
    leave_on_abort.handler = aborted  # keeps it alive
