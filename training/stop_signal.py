"""Ctrl-C and SIGTERM as a flag that a loop polls between two steps."""

import contextlib
import os
import signal
import sys
from types import FrameType

from runtime.command import SIGNALS, begin_command


class StopSignal:
    """True once Ctrl-C or SIGTERM arrived in the block; a second signal ends the process at once.

    In processes of torchrun a second signal is ignored: they get the first one twice, from the
    terminal and from torchrun, which kills those that do not stop in time.
    """

    def __init__(self) -> None:
        self._arrived = False

    def __call__(self) -> bool:
        """Whether to stop."""
        return self._arrived

    def __enter__(self) -> "StopSignal":
        self._before = {number: signal.getsignal(number) for number in SIGNALS}
        for number, handler in self._before.items():
            if handler is not signal.SIG_IGN:  # a shell's background jobs ignore it
                signal.signal(number, self._remember)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler or signal.SIG_DFL)

    def _remember(self, number: int, frame: FrameType | None) -> None:
        alone = int(os.environ.get("WORLD_SIZE", "1")) == 1
        if alone:
            begin_command()
        if not self._arrived:
            self._arrived = True
            again = "; Ctrl-C again stops at once" if alone else ""
            # Not through the buffer of sys.stderr: the signal may have interrupted a write to it.
            with contextlib.suppress(OSError, ValueError):
                os.write(sys.stderr.fileno(), f"\nstopping after this step{again}\n".encode())


def leave_signals_to_parent() -> None:
    """Ignore the signals in a worker process: the parent gets the same signals and ends it."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
