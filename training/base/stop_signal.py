"""Ctrl-C, SIGTERM and SIGHUP as a flag that a loop polls between two steps."""

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from runtime.command.process import stop_requested
from training.datasets.sample import Sample, SampleSource

# Called between two steps or two frames; True asks to stop.
Stop = Callable[[], bool]


def never() -> bool:
    """Return False: the `Stop` of a run that nothing stops."""
    return False


class StopRequested(Exception):
    """A signal arrived where nothing is lost by leaving at once."""


class Watched:
    """A data set that raises StopRequested instead of a frame once `stop` is True."""

    def __init__(self, source: SampleSource, stop: Stop) -> None:
        self._source, self._stop = source, stop
        self.images: Sequence[Path] = getattr(source, "images", ())  # frames are grouped by them

    def __len__(self) -> int:
        return len(self._source)

    def __getitem__(self, index: int) -> Sample:
        if self._stop():
            raise StopRequested
        return self._source[index]


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
