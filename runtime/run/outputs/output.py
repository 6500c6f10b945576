"""The interface of the outputs of a run, and checks before it starts."""

import os
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from runtime.drawing.overlay import Overlay
from runtime.errors import OutputError
from runtime.io.atomic_write import atomic_path
from runtime.prediction import Prediction
from runtime.predictor import Predictor
from runtime.run.options import RunOptions
from runtime.run.run_report import RunReport
from runtime.sources.frames import Frame


@dataclass
class OpenRun:
    """A run while it is open: what an output may need.

    Attributes:
        options: of the run.
        predictor: of the run.
        overlay: draws the frames, for all outputs.
        kinds: of SUFFIXES, the files of a frame to write.
        names: of the frames.
        report: set after the last frame, before the outputs are closed.
    """

    options: RunOptions
    predictor: Predictor
    overlay: Overlay
    kinds: Sequence[str] = ()
    names: Collection[str] = ()
    report: RunReport | None = None


class Output(Protocol):
    """Where the answers of a run are written.

    An output is made by a context manager: what it writes gets its name, whole, when the block
    ends, and is removed after an error there.
    """

    def write(self, frame: Frame, prediction: Prediction) -> None:
        """Write the answer to a frame; always called from one thread. Raises OutputError."""


def require_free(path: Path, *, overwrite: bool, inputs: Collection[Path] = ()) -> None:
    """Raise OutputError unless a file can be made at `path`.

    Args:
        path: of the file.
        overwrite: whether an existing file may be replaced.
        inputs: files that the run reads, and folders in which no file may be replaced.
    """
    if os.path.isdir(path) and not os.path.islink(path):
        raise OutputError(f"{path} is a folder: name a file to write")
    if os.path.lexists(path):
        if not overwrite:
            raise OutputError(f"{path} exists: choose another name, or replace it with --overwrite")
        target = os.path.realpath(path)
        if {target, os.path.dirname(target)} & {os.path.realpath(read) for read in inputs}:
            raise OutputError(f"{path} is what the run reads: choose another name")
    with atomic_path(path, overwrite=False):  # whether it could be made
        pass
