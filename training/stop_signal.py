"""Ctrl-C, SIGTERM and SIGHUP as a flag that a loop polls between two steps."""

import contextlib
import os
from collections.abc import Callable, Iterator

from runtime.app.command import stop_requested


@contextlib.contextmanager
def stop_signal() -> Iterator[Callable[[], bool]]:
    """Yield what is True once Ctrl-C, SIGTERM or SIGHUP arrived; a second one ends the process.

    In processes of torchrun a second signal is ignored: they get the first one twice, from the
    terminal and from torchrun, which kills those that do not stop in time.
    """
    alone = int(os.environ.get("WORLD_SIZE", "1")) == 1
    again = "; Ctrl-C again stops at once" if alone else ""
    notice = f"\nstopping after this step{again}\n"
    with stop_requested(notice=notice, second_ends=alone) as stop:
        yield stop
