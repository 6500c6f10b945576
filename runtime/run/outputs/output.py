"""What every output of a run is: it takes the answers, one frame after another."""

import importlib.util
import tempfile
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Protocol

from runtime.errors import OutputError
from runtime.prediction import Prediction
from runtime.run.pipeline import TakeFrame
from runtime.sources.frames import Frame

DEFAULT_RATE_HZ = 10.0  # of frames that nobody knows the time of: a LiDAR's


class Output(Protocol):
    """Where the answers of a run go.

    An output is a context manager that yields this: what it makes has its name, whole, when the
    block ends, and is gone after an error there.
    """

    def write(self, name: str, frame: Frame, prediction: Prediction) -> None:
        """Take a frame whose answer is valid; always from one thread. Raises OutputError.

        name: of the frame, as frames.csv has it
        """


def require_free(path: Path, *, overwrite: bool, inputs: Collection[Path] = ()) -> None:
    """Raise OutputError unless a file can be made at `path`: before a run, not after it.

    inputs: what is read: a file, or a folder, of which no file is replaced
    """
    if path.is_dir():
        raise OutputError(f"{path} is a folder: name a file to write")
    if path.exists() and not overwrite:
        raise OutputError(f"{path} exists: choose another name, or replace it with --overwrite")
    target = path.resolve()
    if path.exists() and any(read.resolve() in (target, target.parent) for read in inputs):
        raise OutputError(f"{path} is what the run reads: choose another name")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise OutputError(
            f"cannot write {path} ({error.strerror}): choose another place"
        ) from error


def require_package(option: str, package: str, *, extra: str) -> None:
    """Raise OutputError unless a package that an option needs is installed."""
    if importlib.util.find_spec(package) is None:
        raise OutputError(
            f"{option} needs the package {package}, which is not installed: "
            f'pip install "ssdnet[{extra}]"'
        )


def write_to(outputs: Sequence[Output]) -> TakeFrame | None:
    """What hands a frame to all outputs, in their order; None where there is none."""
    if not outputs:
        return None

    def write(name: str, frame: Frame, prediction: Prediction) -> None:
        for output in outputs:
            output.write(name, frame, prediction)

    return write
