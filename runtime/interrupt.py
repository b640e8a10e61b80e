"""How a run ends when it is told to: Ctrl-C, SIGTERM, or SIGHUP of a terminal that closes."""

import os
import signal
import sys


class StopRequest:
    """From now on the first signal makes `requested` True, and the second one ends the process.

    Made after the first iteration: before that nothing is worth saving, and JAX compiles in C++,
    where a handler in Python would have to wait.
    """

    def __init__(self):
        self.requested = False
        names = [name for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
        numbers = [getattr(signal, name) for name in names]
        self.numbers = [n for n in numbers if signal.getsignal(n) != signal.SIG_IGN]  # nohup
        for number in self.numbers:
            signal.signal(number, self.hear)

    def hear(self, *_):
        self.requested = True
        for number in self.numbers:
            signal.signal(number, signal.SIG_DFL)
        say("\nStopping after this iteration. Ctrl-C again stops at once")


def say(text, end="\n"):
    """Print, whether or not anybody still listens."""
    try:
        print(text, end=end, flush=True)
    except OSError:  # a terminal that was closed must not end a run before it is saved
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
