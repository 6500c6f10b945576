"""The process of a command: its start, signals, errors, and what it prints.

It is loaded first, and therefore imports little.
"""

import contextlib
import errno
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from importlib import import_module
from types import FrameType
from typing import Any

from runtime.base.errors import OutputError, SSDNetError, import_remedy
from runtime.command.wording import with_flags

ERROR, INTERRUPTED = 1, 130  # exit codes
# Ctrl-C, a request to end, and the closing of a terminal or SSH session.
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_CLOSED = (errno.EPIPE, errno.EIO)  # reported by a pipe without a reader, and by a closed terminal
_SAME_S = 0.2  # parents such as timeout(1) send a signal twice


def begin_command() -> None:
    """Let a signal end the process at once; called first by every command, until `stop_requested`.

    During imports a KeyboardInterrupt would end as a traceback, or as another error. Without a
    working folder the command ends here with exit code 1, because PyTorch cannot be imported and
    relative paths seem not to exist.
    """
    _handle(lambda number, frame: os._exit(INTERRUPTED))
    with reported_errors(""):
        os.getcwd()


def command_in(module: str) -> Callable[[], None]:
    """Return the entry point of the command whose `app` is in a module, which it imports late."""

    def start() -> None:
        begin_command()
        import_module(module).app()

    return start


def leave_signals_to_parent() -> None:
    """Ignore the signals in a worker process: its parent gets the same signals and ends it."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)


@contextlib.contextmanager
def stop_requested(
    *, notice: str = "", second_ends: bool = True, interrupts: bool = False
) -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether Ctrl-C, SIGTERM or SIGHUP was received in the block.

    The first signal has no other effect, because an exception could be raised between writing a
    frame and adding its row to the table. A second signal ends the process. A thread waits for it,
    since Python does not handle signals while the block hangs in a library.

    Args:
        notice: text that is printed on stderr at the first signal.
        second_ends: whether a second signal ends the process.
        interrupts: whether the first signal raises KeyboardInterrupt, for a block that saves
            nothing.
    """
    received: list[int] = []
    arrived, wakeup = os.pipe()
    os.set_blocking(wakeup, False)

    def record(number: int, frame: FrameType | None) -> None:
        received.append(number)
        if len(received) > 1:
            return
        with contextlib.suppress(OSError):
            # This bypasses the buffer of sys.stderr, because a write to it may have been
            # interrupted.
            os.write(2, notice.encode())
        if interrupts:
            raise KeyboardInterrupt

    def watch() -> None:
        first_s = float("inf")
        with open(arrived, "rb", buffering=0) as numbers:
            while some := numbers.read(64):  # empty once the block has ended
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

    SSDNetError, ImportError (with `import_remedy` for `extras`) and any OSError in a working folder
    that was deleted give exit code 1. KeyboardInterrupt gives exit code 130 without a line.
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
    """Whether the working folder exists; without it no relative path can be used."""
    try:
        return bool(os.getcwd())
    except OSError:
        return False


@contextlib.contextmanager
def progress_bar(length: int, label: str) -> Iterator[Callable[[], None]]:
    """Yield a function that advances a bar on stderr by one; without a terminal there is no bar.

    If the terminal is closed, the bar ends, but not the command.
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
    """Print the result of a command on stdout, and its lines "warning: ..." on stderr.

    The text need not be valid Unicode. A closed pipe or terminal is not an error. Raises
    OutputError for other failures.
    """
    lines = _plain(text).split("\n")
    warnings = [line for line in lines if line.lstrip().startswith("warning: ")]
    if warnings:
        with contextlib.suppress(OSError):
            print("\n".join(warnings), file=sys.stderr, flush=True)  # noqa: T201
    result = "\n".join(line for line in lines if line not in warnings)
    try:
        print(result, flush=True)  # noqa: T201 - sys.stdout may be None
    except OSError as error:
        # Otherwise Python would flush stdout at exit and fail.
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if error.errno not in _CLOSED:
            raise OutputError(f"cannot print ({error.strerror}): redirect the output") from error


def _plain(text: str) -> str:
    """Text from files and names as valid Unicode without control characters, options as flags."""
    valid = with_flags(text).encode(errors="backslashreplace").decode()
    return "".join(c if c.isprintable() or c in "\n\t" else f"\\x{ord(c):02x}" for c in valid)
