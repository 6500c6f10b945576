"""What the commands share: how errors and Ctrl-C end them. Light, since it is loaded first."""

import contextlib
import os
import signal
import sys
from collections.abc import Callable, Iterator
from enum import StrEnum
from types import FrameType

from runtime.errors import SSDNetError

ERROR, INTERRUPTED = 1, 130  # exit codes
SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Provider(StrEnum):
    """The providers that can be asked for."""

    cpu = "cpu"
    cuda = "cuda"


def end_quietly() -> None:
    """Let Ctrl-C and SIGTERM end the process at once, as the first thing that a command does.

    For as long as it imports and reads: a KeyboardInterrupt in the middle of an import comes out as
    a traceback, or as another error.
    """
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as a shell starts background jobs
            signal.signal(number, end_now)


def end_now(number: int, frame: FrameType | None) -> None:
    """End the process as `end_quietly` says: a signal handler."""
    os._exit(INTERRUPTED)


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM raise KeyboardInterrupt in the block, which cleans up after itself.

    A second one ends the process at once.
    """
    before = {number: signal.getsignal(number) for number in SIGNALS}

    def interrupt(number: int, frame: FrameType | None) -> None:
        end_quietly()
        raise KeyboardInterrupt

    for number, handler in before.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, interrupt)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler or signal.SIG_DFL)


@contextlib.contextmanager
def stop_asked() -> Iterator[Callable[[], bool]]:
    """Yield what says whether Ctrl-C or SIGTERM came, which do nothing else in the block.

    An exception could come between the writing of a frame and its line in the table. What is left
    to do after a signal is three frames and the report: whoever stops a service wants it, too.
    """
    came: list[int] = []
    before = {number: signal.getsignal(number) for number in SIGNALS}
    for number, handler in before.items():
        if handler is not signal.SIG_IGN:  # as a shell starts what runs in its background
            signal.signal(number, lambda number, frame: came.append(number))
    try:
        yield lambda: bool(came)
    finally:
        for number, handler in before.items():
            if handler is end_now:  # the command is done: nothing is left to stop
                handler = signal.SIG_IGN
            signal.signal(number, handler or signal.SIG_DFL)


@contextlib.contextmanager
def reported_errors(extras: str) -> Iterator[None]:
    """Turn what a command's block raises into a line on stderr and an exit code.

    SSDNetError is exit code 1, and so is ImportError, which says to install ``ssdnet[extras]``;
    KeyboardInterrupt is exit code 130 without a line.
    """
    try:
        yield
    except SSDNetError as error:
        _end(f"error: {error}", error)
    except ImportError as error:
        _end(f'error: {error}: pip install "ssdnet[{extras}]"', error)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


def say(text: str, *, otherwise: str = "") -> bool:
    """Print a command's result on stdout; returns whether it could be printed.

    otherwise: where else the result is, for the line on stderr if stdout has no room. Whoever reads
    may have left: that is no error.
    """
    text = text.encode(errors="backslashreplace").decode()  # file names need not be valid text
    try:
        sys.stdout.write(text + "\n")
        sys.stdout.flush()
    except OSError as error:
        # What is still buffered must not fail at exit.
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if not isinstance(error, BrokenPipeError):
            with contextlib.suppress(OSError):
                sys.stderr.write(f"cannot print ({error.strerror}){otherwise}\n")
        return False
    return True


def _end(text: str, error: Exception) -> None:
    with contextlib.suppress(OSError):  # nobody reads
        sys.stderr.write(text + "\n")
    raise SystemExit(ERROR) from error
