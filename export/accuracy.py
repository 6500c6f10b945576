"""The accuracy of an exported file, as `ssdnet-eval` measures it."""

import math
import re
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from runtime.errors import InputError
from training.evaluation.cli import parse_source
from training.evaluation.evaluate import evaluate
from training.lidar.split import LidarInput

#: What a file is measured with: all returns of a frame, 16 lines, none.
LIDARS = ("own", "16", "none")


@dataclass(frozen=True)
class Accuracy:
    """Accuracy on one set with one LiDAR; None = the set cannot tell.

    Attributes:
        data: the set, as `ssdnet-eval` names it.
        lidar: that was fed.
        frames: number of them.
        miou: 0..1.
        mae_m: of the depth [m].
    """

    data: str
    lidar: str
    frames: int
    miou: float | None
    mae_m: float | None


def measure_accuracy(path: Path, data: Sequence[str]) -> list[Accuracy]:
    """Measure a file, named ``*.onnx``, on data sets as `ssdnet-eval` takes them.

    Raises:
        DatasetError, InputError: for data that cannot be read, or that hold neither labels nor
            depth.
    """
    rows = evaluate(
        [str(path)],
        [parse_source(text) for text in data],
        lidars=[LidarInput.parse(text) for text in LIDARS],
        faults=["none"],
    )
    found = []
    for row in rows:
        figures = (row.figures.get(key, math.nan) for key in ("miou", "mae_m"))
        known = (None if math.isnan(value) else value for value in figures)
        found.append(Accuracy(row.data, row.lidar, row.frames, *known))
    if all(item.miou is None and item.mae_m is None for item in found):
        raise InputError(
            "--validate: these sets hold neither labels of the model's classes nor depth, so the "
            "accuracy cannot be measured; give a set that does"
        )
    return found


def repeat_command(data: Iterable[str]) -> str:
    """Return the command that measures a file on these sets again."""
    sets = [word for text in data for word in ("--data", without_folders(text))]
    return shlex.join(["ssdnet-eval", "MODEL", *sets, "--lidar", ",".join(LIDARS)])


def without_folders(text: str) -> str:
    """A data set as on the command line, its folder by its last part: a file names no machine."""
    kind, _, rest = text.partition(":")
    folder, *options = re.split(r"(?=,\w+=)", rest, maxsplit=1)
    return f"{kind}:{Path(folder).name}{''.join(options)}"
