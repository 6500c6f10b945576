"""The accuracy of an exported file, as `ssdnet-eval` measures it."""

import math
import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from runtime.base.errors import InputError
from training.datasets.registry import parse_data
from training.lidar.split import LidarInput
from training.scores.differences import compare
from training.scores.evaluated_set import Feed, open_sets
from training.scores.score_set import Result, Row, score_sets
from training.scores.scored_model import open_exported

# LiDAR inputs with which a file is measured: all returns of a frame, 16 scan lines, no returns. If
# no set has returns besides its ground truth, random samples of the ground truth are added for
# int8.
LIDARS, OTHER_LIDAR = ("own", "16", "none"), "random:0.05"
# Least numbers of labelled pixels and of frames for comparing the IoU of a class.
LEAST_CLASS_PIXELS, LEAST_CLASS_FRAMES = 20_000, 10


@dataclass(frozen=True)
class Accuracy:
    """Accuracy on one set with one LiDAR; None if a figure does not exist for the set or the model.

    Attributes:
        data: the set, as `ssdnet-eval` names it.
        lidar: the LiDAR input, as `ssdnet-eval` names it.
        frames: number of frames.
        miou: mean IoU of the classes, 0 to 1.
        mae_m: mean absolute error of the depth [m].
        boundary_f: F-score of the boundaries, 0 to 1.
        coverage_1: share of the depth's errors within `depth_uncertainty`.
        class_iou: IoU of each class that is labelled often enough to compare it.
    """

    data: str
    lidar: str
    frames: int
    miou: float | None = None
    mae_m: float | None = None
    boundary_f: float | None = None
    coverage_1: float | None = None
    class_iou: Mapping[str, float] = field(default_factory=dict)


def measure_accuracy(
    path: Path, data: Sequence[str], lidars: Sequence[str] = LIDARS
) -> list[Accuracy]:
    """Measure a file, named `*.onnx`, on data sets and LiDARs as `ssdnet-eval` takes them.

    Raises:
        DatasetError, InputError: if data cannot be read, or hold neither labels nor depth.
    """
    found = [accuracy_of(result.row) for result in _score([path], data, lidars)]
    if all(item.miou is None and item.mae_m is None for item in found):
        raise InputError(
            "--validate: these sets hold neither labels of the model's classes nor depth, so the "
            "accuracy cannot be measured: add a set that has one of them"
        )
    return found


# (set, LiDAR) -> figure -> half of its 95 % interval.
Widths = Mapping[tuple[str, str], Mapping[str, float]]


def measure_widths(
    single: Path, quantized: Path, data: Sequence[str], lidars: Sequence[str]
) -> Widths:
    """Measure how uncertain the difference of two files is on these frames.

    `training.scores.differences` describes the intervals, of which half is returned.
    """
    found = compare(_score([single, quantized], data, lidars))
    return {
        (item.row.data, item.row.lidar): {
            figure: (each.high - each.low) / 2 for figure, each in item.figures.items()
        }
        for item in found
    }


def _score(files: Sequence[Path], data: Sequence[str], lidars: Sequence[str]) -> list[Result]:
    feeds: list[Feed] = [(LidarInput.parse(lidar), "none") for lidar in lidars]
    with ExitStack() as stack:
        models = {str(file): stack.enter_context(open_exported(file)) for file in files}
        tables = {name: model.table for name, model in models.items() if model.table}
        sets = open_sets([parse_data(text) for text in data], tables, leave_out_fed=True)
        return score_sets(models, sets, feeds)


def accuracy_of(row: Row) -> Accuracy:
    """Return the figures of a row of `ssdnet-eval` that the gate compares."""
    known = {key: value for key, value in row.figures.items() if not math.isnan(value)}
    often = [
        name
        for name, (pixels, frames) in row.labelled.items()
        if pixels >= LEAST_CLASS_PIXELS and frames >= LEAST_CLASS_FRAMES
    ]
    return Accuracy(
        *(row.data, row.lidar, row.frames),
        miou=known.get("miou"),
        mae_m=known.get("mae_m"),
        boundary_f=known.get("boundary_f"),
        coverage_1=known.get("coverage_1"),
        class_iou={name: known[f"iou_{name}"] for name in often if f"iou_{name}" in known},
    )


def repeat_command(data: Iterable[str], rows: Iterable[Accuracy]) -> str:
    """Return the command that measures a file on these sets again."""
    sets = [word for text in data for word in ("--data", without_folders(text))]
    lidars = dict.fromkeys(row.lidar for row in rows)
    return shlex.join(["ssdnet-eval", "MODEL", *sets, "--lidar", ",".join(lidars)])


def without_folders(text: str) -> str:
    """Return a data set as on the command line, absolute folders shortened to their last part."""
    kind, _, rest = text.partition(":")
    folder, *options = re.split(r"(?=,\w+=)", rest, maxsplit=1)
    path = Path(folder)
    return f"{kind}:{path.name if path.is_absolute() else path.as_posix()}{''.join(options)}"
