"""Quantisation of an exported graph with a gate on its accuracy."""

import tempfile
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import onnx

from export.accuracy import (
    LIDARS,
    OTHER_LIDAR,
    Accuracy,
    measure_accuracy,
    measure_widths,
    without_folders,
)
from export.calibration_frames import calibration_feeds
from export.errors import ExportError
from export.gate import find_missed, list_not_gated, require_truth
from export.options import ExportOptions
from export.precision import ENOUGH_FRAMES
from export.quantize import Feed, measure_ranges, quantize, strides
from export.trunk import trunk
from runtime.contract.heads import HEADS, Unit
from runtime.engine.session import open_session

# Number of frames on which the effect of each convolution is measured.
_SENSITIVITY_FRAMES = 4
# Convolutions on finer grids stay in float, on this grid all but the dense ones of 3 x 3: there,
# converting to 8 bits takes longer than 8 bits save. docs/performance.md has the times.
_FINEST_STRIDE = 4


@dataclass(frozen=True)
class Quantized:
    """A quantised graph that passed the gate.

    Attributes:
        model: the graph.
        accuracy: accuracy of the graph.
        facts: the value of `Contract.quantization`.
    """

    model: onnx.ModelProto
    accuracy: list[Accuracy]
    facts: dict[str, Any]


def quantize_within(
    model: onnx.ModelProto,
    options: ExportOptions,
    *,
    classes: Sequence[str],
    write: Callable[[onnx.ModelProto, Path], object],
    warnings: Sequence[str] = (),
    report: Callable[[str], object] = str,
) -> Quantized:
    """Quantise a graph; convolutions that cost too much accuracy stay in single precision.

    Convolutions for which 8 bits save no time stay in float, see `_gains`, and those that read or
    write what is many times larger on a few frames than on most, see `Ranges`. While the gate is
    missed, further convolutions stay in float, see `_Search`.

    Args:
        model: a traced graph.
        options: data and gate.
        classes: names of the model's classes.
        write: writes a graph as a file that the engine runs.
        warnings: of `require_frames`, for the file's facts.
        report: called with what is done next, in words.

    Raises:
        DatasetError, InputError: if data cannot be read, or lack labels although the model has
            classes, or depth although it has a depth head.
        ExportError: if the gate is missed even with half of the other convolutions in float.
    """
    heads = [output.name for output in model.graph.output]
    with tempfile.TemporaryDirectory() as folder:
        single, path = Path(folder) / "single.onnx", Path(folder) / "int8.onnx"
        write(model, single)
        report("measuring the accuracy in single precision")
        gate = _Gate.measure(single, heads, options)
        report("calibrating the value ranges")
        feeds = list(calibration_feeds(single, options.calibrate))
        search = _Search(model, feeds)
        while True:
            quantized = quantize(model, search.ranges, keep_float=search.in_float)
            write(quantized, path)
            report(f"measuring the accuracy with {search} in float")
            accuracy, missed = gate.judge(path)
            if not missed:
                break
            search.keep_more(missed)
    facts = {
        "calibration": [without_folders(text) for text in options.calibrate],
        "calibration_frames": len(feeds),
        "float_convolutions": search.in_float,
        "accuracy_fp32": [asdict(item) for item in gate.before],
        "not_gated": list_not_gated(heads, classes, gate.before),
        "warnings": list(warnings),
    }
    return Quantized(quantized, accuracy, facts)


class _Gate(NamedTuple):
    """The accuracy of a file in single precision, and how much of it may be lost."""

    single: Path
    options: ExportOptions
    lidars: Sequence[str]
    before: list[Accuracy]

    @classmethod
    def measure(cls, single: Path, heads: Collection[str], options: ExportOptions) -> Self:
        """Measure a file in single precision with each LiDAR; InputError without ground truth."""
        lidars: Sequence[str] = LIDARS
        before = measure_accuracy(single, options.validate, lidars)
        require_truth(heads, before)
        if {row.lidar for row in before if row.mae_m is not None} == {"none"}:
            lidars = (*LIDARS, OTHER_LIDAR)
            before = measure_accuracy(single, options.validate, lidars)
        return cls(single, options, lidars, before)

    def judge(self, path: Path) -> tuple[list[Accuracy], Mapping[str, str]]:
        """Return the accuracy of a quantised file, and what it loses too much, worst head first.

        On few frames the limits are widened by the uncertainty of the difference.
        """
        data = self.options.validate
        accuracy = measure_accuracy(path, data, self.lidars)
        missed = find_missed(self.before, accuracy, self.options)
        if missed and sum({row.data: row.frames for row in self.before}.values()) < ENOUGH_FRAMES:
            widths = measure_widths(self.single, path, data, self.lidars)
            missed = find_missed(self.before, accuracy, self.options, widths)
        return accuracy, missed


class _Search:
    """Searches the convolutions that stay in float.

    The first that is added is the one that, quantised alone, most changes the head that exceeds its
    limit most; after that their number grows by half each time, up to half of all that may be
    quantised.
    """

    def __init__(self, model: onnx.ModelProto, feeds: Sequence[Feed]) -> None:
        names = trunk(model)
        nodes = [n for n in model.graph.node if n.op_type == "Conv" and n.name in names]
        self.ranges = measure_ranges(model, feeds)
        self._model, self._feeds = model, feeds
        self._convolutions = [n.name for n in nodes]
        shapes = {weight.name: weight.dims for weight in model.graph.initializer}
        grids = strides(model, feeds[0])
        self._always = [
            node.name
            for node in nodes
            for tensors in [{node.input[0], node.output[0]}]
            if self.ranges.uneven & tensors
            or not _gains(min(grids[name] for name in tensors), shapes[node.input[1]])
        ]
        self._ranked: dict[str, list[str]] = {}
        self.in_float = self._always

    def __str__(self) -> str:
        """How many stay in float, in words."""
        return f"{len(self.in_float)} of {len(self._convolutions)} convolutions"

    def keep_more(self, missed: Mapping[str, str]) -> None:
        """Keep more in float, for the first head that misses the gate; ExportError at the end."""
        added = len(self.in_float) - len(self._always)
        if 2 * added >= len(self._convolutions) - len(self._always):
            raise ExportError(
                f"int8 loses too much even with {self} in float, so nothing was written "
                f"({'; '.join(missed.values())}): calibrate on data like those of --validate, or "
                "raise --max-drop-miou for mIoU or --max-rise-mae for MAE (the other limits have "
                "no option)"
            )
        head = next(iter(missed))
        if head not in self._ranked:
            alone = partial(quantize, self._model, self.ranges)
            self._ranked[head] = rank_convolutions(
                self._model, alone, self._convolutions, self._feeds, head
            )
        others = [name for name in self._ranked[head] if name not in self.in_float]
        self.in_float = [*self.in_float, *others[: max(1, added // 2)]]


def _gains(stride: int, shape: Sequence[int]) -> bool:
    """Whether 8 bits save time, by a convolution's finer grid and the shape of its weights.

    On the grid of _FINEST_STRIDE they do for dense convolutions of 3 x 3 alone.
    """
    return stride > _FINEST_STRIDE or (stride == _FINEST_STRIDE and shape[1] > 1 and shape[2] == 3)


def rank_convolutions(
    model: onnx.ModelProto,
    quantized: Callable[..., onnx.ModelProto],
    convolutions: Collection[str],
    feeds: Sequence[Feed],
    head: str,
) -> list[str]:
    """Sort convolutions by the change of a head when only this convolution is quantised."""
    frames = feeds[:: max(1, len(feeds) // _SENSITIVITY_FRAMES)][:_SENSITIVITY_FRAMES]

    def answers(graph: onnx.ModelProto) -> list[Any]:
        session = open_session(graph.SerializeToString(), threads=2)
        return [session.run([head], feed)[0] for feed in frames]

    expected = answers(model)
    others = trunk(model)

    def change(name: str) -> float:
        found = answers(quantized(keep_float=[other for other in others if other != name]))
        pairs = zip(found, expected, strict=True)
        if HEADS[head].unit is Unit.CLASS_ID:
            return float(np.mean([(a != b).mean() for a, b in pairs]))
        return float(np.mean([np.abs(a - b).mean() for a, b in pairs]))

    return sorted(convolutions, key=change, reverse=True)
