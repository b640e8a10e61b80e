"""How a run ends when it is told to, by Ctrl-C or SIGTERM."""

import signal


class StopRequest:
    """From now on the first signal makes `requested` True, and the second one ends the process.

    Made after the first iteration: before that nothing is worth saving, and JAX compiles in C++,
    where a handler in Python would have to wait.
    """

    def __init__(self):
        self.requested = False
        for number in (signal.SIGINT, signal.SIGTERM):
            if signal.getsignal(number) != signal.SIG_IGN:  # a script's `&` lets it ignore SIGINT
                signal.signal(number, self.hear)

    def hear(self, number, _):
        self.requested = True
        signal.signal(number, signal.SIG_DFL)
        print("\nStopping after this iteration. Ctrl-C again stops at once", flush=True)
