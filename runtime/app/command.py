"""What all commands share: reporting of errors, and Ctrl-C. Light, since it is loaded first."""

import contextlib
import errno
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from enum import StrEnum
from types import FrameType
from typing import Any

from runtime.base.errors import OutputError, SSDNetError, import_remedy

ERROR, INTERRUPTED = 1, 130  # exit codes
#: Ctrl-C, a request to end, and a terminal or SSH session that closed.
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_CLOSED = (errno.EPIPE, errno.EIO)  # what a pipe without a reader, and a closed terminal report
_SAME_S = 0.2  # parents such as timeout(1) send a signal twice


class Provider(StrEnum):
    """Choices of --provider."""

    cpu = "cpu"
    cuda = "cuda"


def begin_command() -> None:
    """The first call of every command: until `stop_requested`, a signal ends the process at once.

    During imports a KeyboardInterrupt would end as a traceback, or as another error.
    """
    _handle(lambda number, frame: os._exit(INTERRUPTED))


def leave_signals_to_parent() -> None:
    """Ignore the signals in a worker process: the parent gets the same signals and ends it."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)


@contextlib.contextmanager
def stop_requested(
    *, notice: str = "", second_ends: bool = True, interrupts: bool = False
) -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether Ctrl-C, SIGTERM or SIGHUP was received in the block.

    The first has no other effect there: an exception could be raised between the writing of a frame
    and its row in the table. A second one ends the process. A thread waits for it, since Python
    handles no signal while the block hangs in a library.

    Args:
        notice: printed on stderr at the first one.
        second_ends: whether a second one ends the process.
        interrupts: whether the first one raises KeyboardInterrupt, for a block that saves nothing.
    """
    received: list[int] = []
    arrived, wakeup = os.pipe()
    os.set_blocking(wakeup, False)

    def record(number: int, frame: FrameType | None) -> None:
        received.append(number)
        if len(received) > 1:
            return
        with contextlib.suppress(OSError):
            # Not through the buffer of sys.stderr: a write to it may have been interrupted.
            os.write(2, notice.encode())
        if interrupts:
            raise KeyboardInterrupt

    def watch() -> None:
        first_s = float("inf")
        with open(arrived, "rb", buffering=0) as numbers:
            while some := numbers.read(64):  # none once the block has ended
                if not set(some).isdisjoint(SIGNALS):
                    first_s = min(first_s, now_s := time.monotonic())
                    if second_ends and now_s - first_s > _SAME_S:
                        os._exit(INTERRUPTED)

    threading.Thread(target=watch, name="signals", daemon=True).start()
    before, wakeup_before = _handle(record), signal.set_wakeup_fd(wakeup)
    try:
        yield lambda: bool(received)
    finally:
        signal.set_wakeup_fd(wakeup_before)
        os.close(wakeup)
        for number, old in before.items():
            signal.signal(number, old or signal.SIG_DFL)


def _handle(handler: Callable[[int, FrameType | None], None]) -> dict[signal.Signals, Any]:
    """Install a handler for the signals that are not ignored; return the former handlers."""
    before = {number: signal.getsignal(number) for number in SIGNALS}
    for number, old in before.items():
        if old is not signal.SIG_IGN:
            signal.signal(number, handler)
    return before


@contextlib.contextmanager
def reported_errors(extras: str) -> Iterator[None]:
    """Turn an exception of the block into a line on stderr and an exit code.

    SSDNetError, ImportError, with `import_remedy` of `extras`, and any OSError in a working folder
    that was deleted are exit code 1. KeyboardInterrupt is exit code 130 without a line.
    """
    try:
        yield
    except (SSDNetError, ImportError, OSError) as error:
        text = str(error)
        if isinstance(error, ImportError):
            text += f": {import_remedy(error, extras)}"
        elif isinstance(error, OSError):
            if _has_folder():
                raise
            text = "the working folder was deleted or remounted: change to another one, or again "
            text += "to this one, by cd"
        with contextlib.suppress(OSError):  # stderr may be closed
            sys.stderr.write(_plain(f"error: {text}\n"))
        raise SystemExit(ERROR) from error
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


def _has_folder() -> bool:
    """Whether the working folder exists; without one no relative path can be used."""
    try:
        return bool(os.getcwd())
    except OSError:
        return False


@contextlib.contextmanager
def progress_bar(length: int, label: str) -> Iterator[Callable[[], None]]:
    """Yield a function that advances a bar on stderr by one; without a terminal there is no bar.

    A terminal that was closed meanwhile ends the bar, not the command.
    """
    if not sys.stderr.isatty():
        yield lambda: None
        return
    import typer

    bar = typer.progressbar(length=length, file=sys.stderr, label=label)

    def advance() -> None:
        with contextlib.suppress(OSError):
            bar.update(1)

    with contextlib.suppress(OSError):
        bar.__enter__()
    try:
        yield advance
    finally:
        with contextlib.suppress(OSError):
            bar.__exit__(None, None, None)


def print_result(text: str) -> None:
    """Print the result of a command on stdout; it need not be valid Unicode.

    A closed pipe or terminal is no error. Raises OutputError for other failures.
    """
    try:
        print(_plain(text), flush=True)  # noqa: T201 - sys.stdout may be None
    except OSError as error:
        # Otherwise Python flushes stdout at exit and fails.
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if error.errno not in _CLOSED:
            raise OutputError(f"cannot print ({error.strerror}): redirect the output") from error


def _plain(text: str) -> str:
    """Text from files and names as valid Unicode without control characters."""
    valid = text.encode(errors="backslashreplace").decode()
    return "".join(c if c.isprintable() or c in "\n\t" else f"\\x{ord(c):02x}" for c in valid)
