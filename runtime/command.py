"""How the commands speak: a flag that does not fit, or work that is refused, is one line."""

import argparse
import functools
import math
import sys


class Refused(Exception):
    """What a command cannot do for its user: one line that says why, and what to do."""


class Parser(argparse.ArgumentParser):
    """An ArgumentParser that takes no abbreviations and complains in one line."""

    def __init__(self, prog, description, **options):
        form = argparse.RawDescriptionHelpFormatter
        about = dict(prog=prog, description=description, formatter_class=form)
        super().__init__(**about, allow_abbrev=False, **options)

    def error(self, message):
        self.exit(2, f"{self.prog}: {message} (-h lists every flag)\n")


def finite(text):
    """A number from the command line, which argparse refuses if it is nan or infinite."""
    if not math.isfinite(x := float(text)):
        raise argparse.ArgumentTypeError(f"{text} is not a finite number")
    return x


def positive(text):
    """A finite number above 0 from the command line."""
    if (x := finite(text)) <= 0:
        raise argparse.ArgumentTypeError(f"{text} is not above 0")
    return x


def complaint(error):
    """The line that tells a user of an error, or None for a bug."""
    from_jax_or_mujoco = "RESOURCE_EXHAUSTED", "Caught an unknown exception"
    if isinstance(error, MemoryError) or any(x in str(error) for x in from_jax_or_mujoco):
        return "there is too little memory: take fewer robots or episodes"
    return " ".join(str(error).split()) if isinstance(error, Refused | OSError) else None


def command(name):
    """Let a main(argv) return 2 after a line on stderr if it is refused, and 130 after Ctrl-C.

    Any other exception is a bug, perhaps in a reward that somebody is writing, and keeps its
    traceback.
    """

    def wrap(main):
        @functools.wraps(main)
        def guarded(argv):
            try:
                return main(argv)
            except KeyboardInterrupt:
                return 130
            except Exception as error:
                if (line := complaint(error)) is None:
                    raise
                print(f"{name}: {line}", file=sys.stderr, flush=True)
                return 2

        return guarded

    return wrap
