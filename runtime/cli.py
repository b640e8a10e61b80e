"""How the commands speak and end: what is refused is one line, and Ctrl-C stops a run."""

import argparse
import errno
import functools
import os
import re
import signal
import sys
from contextlib import contextmanager, suppress
from operator import ge, gt, le, lt
from pathlib import Path

COMPARE = {"at least": ge, "above": gt, "at most": le, "below": lt}  # all are False for nan
# limits of numbers, as `misfit` takes them
COUNT = {"at least": 1, "at most": 10**12}  # a float still counts these one by one
A_SEED = {"at least": 0, "at most": 2**32 - 1}  # JAX takes 32 bits: 2**32 would draw what 0 does
# Windows has no SIGHUP
SIGNALS = [getattr(signal, x) for x in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, x)]
NOBODY_LISTENS = errno.EPIPE, errno.EIO, errno.EBADF
# how the C++ of JAX and MuJoCo says that memory is full, in exceptions of any type
NO_MEMORY = re.compile("bad_alloc|out of memory|RESOURCE_EXHAUSTED|Caught an unknown exception!")


class Refused(Exception):
    """A command cannot do what it was asked: one line says why, and what to do.

    status: the exit status of the command
    """

    def __init__(self, line, status=2):
        super().__init__(line)
        self.status = status


class Parser(argparse.ArgumentParser):
    """An ArgumentParser that takes no abbreviations and complains in one line."""

    def __init__(self, prog, description, **options):
        form = argparse.RawDescriptionHelpFormatter
        about = dict(prog=prog, description=description, formatter_class=form)
        super().__init__(**about, allow_abbrev=False, **options)
        # argparse of Python 3.11 takes -1e-2 and -1. for flags
        self._negative_number_matcher = re.compile(r"-(\.?\d|inf|nan)")

    def error(self, message):
        """As argparse's, without the usage."""
        self.exit(2, f"{self.prog}: {message} (-h lists every flag)\n")


def say(line, is_error=False, end="\n"):
    """Print a line. If its reader has gone, print nothing from now on, and let the run go on.

    On a full disk the line is lost.
    """
    stream = sys.stderr if is_error else sys.stdout
    if not stream:  # it was closed before Python began, and print would take another one
        return
    try:
        print(line, file=stream, end=end, flush=True)
    except OSError as error:
        if error.errno in NOBODY_LISTENS:
            silence(stream)


def silence(stream):
    """Point a stream at the null device, because its buffer would fail again when Python ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def warn(line):
    """Say a line of `train.py` on standard error."""
    say(f"train.py: {line}", is_error=True)


def misfit(values, limits):
    """A line about the first number that is beyond its limits, or None if all are within.

    values: {name of a flag: a number, several, or None}
    limits: {name: {"at least": 0, "below": 1}}, of those flags that are numbers
    """
    for name, ends in limits.items():
        x = values[name]
        for number in x if isinstance(x, list | tuple) else [x]:
            fits = (COMPARE[word](number, end) for word, end in ends.items())
            if number is not None and not all(fits):
                needs = " and ".join(f"{word} {end}" for word, end in ends.items())
                return f"--{name.replace('_', '-')} is {number}: it must be {needs}"
    return None


def a_path(text):
    """A Path, as argparse's type. An empty one is refused: a script's variable that is not set."""
    if not text:
        raise argparse.ArgumentTypeError("it is empty: give a path, or leave it out")
    return Path(text)


def is_place_for(path, suffix):
    """Whether a file of this kind can be written there; path: a Path that somebody gave."""
    is_file = path.suffix.lower() == suffix and not path.is_dir()
    return is_file and path.parent.is_dir() and os.access(path.parent, os.W_OK)


def tuples(settings):
    """The settings with lists turned into tuples, which neither argparse nor JSON makes."""
    return {name: tuple(x) if isinstance(x, list) else x for name, x in settings.items()}


def complaint(error):
    """The line that tells a user of an error, or None for a bug."""
    if isinstance(error, Refused | OSError | MemoryError):
        return " ".join(str(error).split()) or "out of memory"
    return "out of memory" if NO_MEMORY.search(str(error)) else None


def open_descriptors():
    """Open 0 to 2 on the null device where they are closed, as by `>&-`. A file of the run would
    get the number, and with it what a handler of a signal or a library in C++ writes there.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # it takes the lowest number that is free


def program(name):
    """Let a main(argv) return its status: 2, or that of Refused, after a line on stderr if it is
    refused, or if files or memory fail; 130 after Ctrl-C; 1 if what reads its output has closed the
    pipe, as `head` does.

    Any other exception is a bug, perhaps in a reward that somebody is writing, and keeps its
    traceback.
    """

    def wrap(main):
        @functools.wraps(main)
        def guarded(argv):
            open_descriptors()
            for stream in (sys.stdout, sys.stderr):
                if hasattr(stream, "reconfigure"):  # a console may not know a path's letters
                    stream.reconfigure(errors="backslashreplace")
            try:
                status = main(argv)
                if sys.stdout:  # None if it was closed before Python began
                    sys.stdout.flush()
                return status
            except KeyboardInterrupt:
                return 130
            except BrokenPipeError:
                silence(sys.stdout)
                return 1
            except Exception as error:
                if (line := complaint(error)) is None:
                    raise
                say(f"{name}: {line}", is_error=True)
                return getattr(error, "status", 2)

        return guarded

    return wrap


@contextmanager
def signals_given_back():
    """Give signals back to who had them before: a script may train several runs."""
    before = {number: signal.getsignal(number) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler or signal.SIG_DFL)  # None: of a library in C++


class StopRequest:
    """From now on a signal makes `requested` True. A second Ctrl-C, or a second SIGTERM, ends the
    process.

    Made after the first iteration: before that nothing is worth saving, and JAX compiles in C++,
    where a handler in Python would have to wait.
    """

    def __init__(self):
        self.requested = False
        for number in SIGNALS:
            # a script's `&` lets it ignore SIGINT, and nohup SIGHUP
            if signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, self.hear)

    def hear(self, number, _):
        """The handler of SIGNALS."""
        self.requested = True
        if number in (signal.SIGINT, signal.SIGTERM):  # one closed terminal may send SIGHUP twice
            signal.signal(number, signal.SIG_DFL)
            # not by print, in the midst of which the signal may have come
            with suppress(OSError):
                os.write(1, b"\nStopping after this iteration. A second Ctrl-C stops at once,\n")
                os.write(1, b"and --resume then goes on from the last checkpoint\n")
