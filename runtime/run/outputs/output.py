"""The interface of the outputs of a run, and checks before it starts."""

import importlib.util
import os
from collections.abc import Collection
from pathlib import Path
from typing import Protocol

from runtime.errors import OutputError, install_command
from runtime.io.atomic_write import atomic_path
from runtime.prediction import Prediction
from runtime.sources.frames import Frame

DEFAULT_RATE_HZ = 10.0  # of frames without stamps: a LiDAR's
#: Option that names a file -> its suffix.
FILE_SUFFIXES = {"video": ".mp4", "report": ".html", "mcap": ".mcap", "rerun": ".rrd"}
RERUN_LIVE = "live"  # --rerun: the viewer on this machine


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


def is_rerun_file(target: str) -> bool:
    """Whether --rerun names a file, not a viewer."""
    return target.lower().endswith(FILE_SUFFIXES["rerun"])


def require_package(option: str, package: str, *, extra: str) -> None:
    """Raise OutputError unless a package that an option needs is installed."""
    if importlib.util.find_spec(package) is None:
        raise OutputError(
            f"{option} needs the package {package}, which is not installed: "
            f"{install_command(extra)}"
        )
