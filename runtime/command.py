"""What all commands share: reporting of errors, and Ctrl-C. Light, since it is loaded first."""

import contextlib
import os
import signal
import sys
from collections.abc import Callable, Iterator
from enum import StrEnum
from types import FrameType
from typing import Any

from runtime.errors import SSDNetError, import_remedy

ERROR, INTERRUPTED = 1, 130  # exit codes
SIGNALS = (signal.SIGINT, signal.SIGTERM)

#: Control characters, which a terminal obeys, and how they are printed.
_CONTROLS = {
    code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160)) if chr(code) not in "\n\t"
}


class Provider(StrEnum):
    """Choices of --provider."""

    cpu = "cpu"
    cuda = "cuda"


def begin_command() -> None:
    """The first call of every command: prepare the process for closed streams and for signals."""
    _open_closed_streams()
    end_quietly()


def _open_closed_streams() -> None:
    """Open closed standard streams as /dev/null; otherwise opened files get their descriptors."""
    while (handle := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(handle, True)
    os.close(handle)
    # Kept open for the life of the process.
    sys.stdin = sys.stdin or open(0, closefd=False)  # noqa: SIM115
    sys.stdout = sys.stdout or open(1, "w", closefd=False)  # noqa: SIM115
    sys.stderr = sys.stderr or open(2, "w", closefd=False)  # noqa: SIM115


def end_quietly() -> None:
    """Let Ctrl-C and SIGTERM end the process at once.

    During imports a KeyboardInterrupt would end as a traceback, or as another error.
    """
    _handle(end_now)


def end_now(number: int, frame: FrameType | None) -> None:
    """Signal handler that ends the process."""
    os._exit(INTERRUPTED)


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM raise KeyboardInterrupt in the block; the second ends the process."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        end_quietly()
        raise KeyboardInterrupt

    before = _handle(interrupt)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler or signal.SIG_DFL)


@contextlib.contextmanager
def stop_requested() -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether Ctrl-C or SIGTERM was received in the block.

    The signals have no other effect there: an exception could be raised between the writing of a
    frame and its row in the table.
    """
    received: list[int] = []
    before = _handle(lambda number, frame: received.append(number))
    try:
        yield lambda: bool(received)
    finally:
        for number, handler in before.items():
            if handler is end_now:  # the command has ended already
                handler = signal.SIG_IGN
            signal.signal(number, handler or signal.SIG_DFL)


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

    SSDNetError and, with `import_remedy` of `extras`, ImportError are exit code 1.
    KeyboardInterrupt is exit code 130 without a line.
    """
    try:
        yield
    except SSDNetError as error:
        _end(f"error: {error}", error)
    except ImportError as error:
        _end(f"error: {error}: {import_remedy(error, extras)}", error)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


def print_result(text: str, *, elsewhere: str = "") -> bool:
    """Print the result of a command on stdout.

    A closed pipe is no error; other failures are reported on stderr.

    Args:
        text: to print; it need not be valid Unicode.
        elsewhere: end of the line on stderr: where the result can be found.

    Returns:
        Whether the text was printed.
    """
    try:
        sys.stdout.write(_plain(text) + "\n")
        sys.stdout.flush()
    except OSError as error:
        # Otherwise Python flushes stdout at exit and fails.
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if not isinstance(error, BrokenPipeError):
            with contextlib.suppress(OSError):
                sys.stderr.write(f"cannot print ({error.strerror}){elsewhere}\n")
        return False
    return True


def _plain(text: str) -> str:
    """Text from files and names as valid Unicode without control characters."""
    return text.encode(errors="backslashreplace").decode().translate(_CONTROLS)


def _end(text: str, error: Exception) -> None:
    with contextlib.suppress(OSError):  # stderr may be closed
        sys.stderr.write(_plain(text) + "\n")
    raise SystemExit(ERROR) from error
