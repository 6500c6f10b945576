"""Ctrl-C, SIGTERM and SIGHUP as a flag that a loop polls between two steps."""

import contextlib
import os
from collections.abc import Callable, Iterator

from runtime.command.process import stop_requested

# Called between two steps or two frames; True asks to stop.
Stop = Callable[[], bool]


def never() -> bool:
    """Return False: the `Stop` of a run that nothing stops."""
    return False


class StopRequested(Exception):
    """A signal arrived where nothing is lost by leaving at once."""


@contextlib.contextmanager
def stop_signal() -> Iterator[Stop]:
    """Yield what is True once Ctrl-C, SIGTERM or SIGHUP arrived; a second one ends the process.

    In processes of torchrun a second signal is ignored: they get the first one twice, from the
    terminal and from torchrun, which kills those that do not stop in time.
    """
    alone = int(os.environ.get("WORLD_SIZE", "1")) == 1
    again = "; Ctrl-C again stops at once" if alone else ""
    notice = f"\nstopping after this step{again}\n"
    with stop_requested(notice=notice, second_ends=alone) as stop:
        yield stop
