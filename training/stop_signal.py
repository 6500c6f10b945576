"""Ctrl-C and SIGTERM as a question that a loop asks between two steps."""

import contextlib
import os
import signal
import sys
from types import FrameType

from runtime.command import SIGNALS, end_quietly


class StopSignal:
    """Whether Ctrl-C or SIGTERM came while the block runs; a second one ends the process at once.

    Of torchrun's processes a second one does nothing: they get the first from the terminal and from
    torchrun, which kills those that do not stop in time.
    """

    def __init__(self) -> None:
        self._came = False

    def __call__(self) -> bool:
        """Whether to stop."""
        return self._came

    def __enter__(self) -> "StopSignal":
        self._before = {number: signal.getsignal(number) for number in SIGNALS}
        for number, handler in self._before.items():
            if handler is not signal.SIG_IGN:  # as a shell starts what runs in its background
                signal.signal(number, self._remember)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler or signal.SIG_DFL)

    def _remember(self, number: int, frame: FrameType | None) -> None:
        alone = int(os.environ.get("WORLD_SIZE", "1")) == 1
        if alone:
            end_quietly()
        if not self._came:
            self._came = True
            again = "; Ctrl-C again stops at once" if alone else ""
            # Not through the buffer of sys.stderr, in whose middle this may have come.
            with contextlib.suppress(OSError, ValueError):
                os.write(sys.stderr.fileno(), f"\nstopping after this step{again}\n".encode())


def leave_signals_to_parent() -> None:
    """Let a worker process go on until its parent, who gets the same signals, ends it."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
