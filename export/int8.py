"""Quantisation of an exported graph with a gate on its accuracy."""

import math
import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import onnx

from export.accuracy import (
    LEAST_CLASS_FRAMES,
    LEAST_CLASS_PIXELS,
    LIDARS,
    OTHER_LIDAR,
    Accuracy,
    Widths,
    measure_accuracy,
    measure_widths,
    without_folders,
)
from export.errors import ExportError
from export.precision import ENOUGH_FRAMES, LEAST_FRAMES, Int8Options
from export.quantize import Feed, measure_ranges, quantize, strides
from export.trunk import trunk
from models import Checkpoint
from runtime import InputError, Predictor
from runtime.contract.heads import HEADS, Unit
from runtime.engine.preprocess import preprocess
from runtime.engine.session import open_session
from training.datasets.any_source import parse_data
from training.datasets.class_mapping import ClassTable
from training.datasets.sample import SampleSource
from training.evaluation.evaluated_run import open_training_sets
from training.evaluation.scored_model import trained_classes
from training.evaluation.shared_classes import share_classes
from training.lidar.split import LidarInput, frame_generator, split_lidar
from training.loading.open_dataset import count_frames, count_shared, open_dataset

# LiDAR inputs of the calibration frames, used in turn. Activations beyond the calibrated ranges are
# clipped.
CALIBRATION_LIDARS = ("own", "none", "16", "4")
# Number of frames, evenly spread over the sets, on which ranges are calibrated; and number of
# frames on which the effect of each convolution is measured.
CALIBRATION_FRAMES, _SENSITIVITY_FRAMES = 128, 4
# Convolutions that read or write a grid of this stride or less stay in float. They have few
# channels on many pixels, where converting to 8 bits takes longer than 8 bits save, and they see
# the finest detail.
_FINE_STRIDE = 2
# Limits without an option: loss of a class's IoU [points], loss of boundary F (0..1), and change of
# the share of errors within one scale of the uncertainty [points].
MAX_DROP_CLASS_IOU, MAX_DROP_BOUNDARY_F, MAX_CHANGE_COVERAGE = 3.0, 0.01, 3.0
# The figure of each head in `Accuracy`.
_FIGURES = {
    "semantic": "miou",
    "semantic_logits": "miou",
    "depth": "mae_m",
    "boundary": "boundary_f",
    "depth_uncertainty": "coverage_1",
}
# The ground truth that a set needs to measure each head, and example sets.
_NEEDED = {
    "semantic": (
        "labels of the model's classes",
        "folders:DIR,labels=FOLDER, camvid:DIR, cityscapes:DIR, kitti-streets:DIR",
    ),
    "depth": ("depth", "folders:DIR,depth=FOLDER, kitti-depth:DIR, kitti-streets:DIR"),
}


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


def require_frames(
    options: Int8Options, validate: Sequence[str], checkpoint: Checkpoint, folder: Path
) -> list[str]:
    """Check that there are `LEAST_FRAMES` to calibrate, and as many others to validate.

    Args:
        options: options that hold the data sets of the calibration.
        validate: data sets of the validation.
        checkpoint: checkpoint of the model.
        folder: where the checkpoint is: if it is that of a run, frames that the run was trained on
            are counted.

    Returns:
        Warnings: for fewer than `ENOUGH_FRAMES`, and for frames that the model was trained on.

    Raises:
        DatasetError, InputError: if data cannot be read, have fewer frames, or share some frames.
    """
    table = trained_classes(checkpoint.model.config.classes, checkpoint.training)
    found, warnings = {}, []
    for option, texts in (("--calibrate", options.calibrate), ("--validate", validate)):
        found[option] = [_open_set(text, table) for text in texts]
        if (count := count_frames(found[option])) < LEAST_FRAMES:
            raise InputError(
                f"{option}: {count} frames in all, expected {LEAST_FRAMES} or more, so nothing was "
                "written: add frames or another set"
            )
        if count < ENOUGH_FRAMES:
            text = f"{option}: {count} frames, fewer than {ENOUGH_FRAMES}"
            if option == "--validate":
                text += ", so the limits on mIoU and MAE were widened by the uncertainty of these"
            warnings.append(text)
    if both := count_shared(*found.values()):
        raise InputError(
            f"int8 is calibrated and validated on {both} frames: its loss of accuracy must be "
            "measured on other frames; give another set, or other frames of it"
        )
    if known := count_shared(found["--validate"], open_training_sets(folder)):
        count = count_frames(found["--validate"])
        warnings.append(
            f"--validate: the model was trained on {known} of these {count} frames, where it may "
            "lose less accuracy than on new ones"
        )
    return warnings


def quantize_within(
    model: onnx.ModelProto,
    options: Int8Options,
    *,
    validate: Sequence[str],
    classes: Sequence[str],
    write: Callable[[onnx.ModelProto, Path], object],
    warnings: Sequence[str] = (),
    report: Callable[[str], object] = str,
) -> Quantized:
    """Quantise a graph; convolutions that cost too much accuracy stay in single precision.

    Convolutions on the finest grids stay in float, see _FINE_STRIDE, and those that read or write
    what is many times larger on a few frames than on most, see `Ranges`. While the gate is missed,
    further convolutions stay in float. The first is the one that, quantised alone, most changes the
    head that exceeds its limit most; after that their number grows by half each time.

    Args:
        model: a traced graph.
        options: data and gate.
        validate: data sets on which the accuracy is measured before and after.
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
    names = trunk(model)
    nodes = [n for n in model.graph.node if n.op_type == "Conv" and n.name in names]
    convolutions = [n.name for n in nodes]
    ranked: dict[str, list[str]] = {}
    with tempfile.TemporaryDirectory() as folder:
        single, path = Path(folder) / "single.onnx", Path(folder) / "int8.onnx"
        write(model, single)
        report("calibrating the value ranges")
        feeds = list(_feeds(single, options))
        stride = strides(model, feeds[0])
        ranges = measure_ranges(model, feeds)
        always = [
            n.name
            for n in nodes
            if min(stride[n.input[0]], stride[n.output[0]]) <= _FINE_STRIDE
            or ranges.uneven & {n.input[0], n.output[0]}
        ]
        in_float = [*always]
        report("measuring the accuracy in single precision")
        lidars: Sequence[str] = LIDARS
        before = measure_accuracy(single, validate, lidars)
        _require_rows(heads, before)
        if {row.lidar for row in before if row.mae_m is not None} == {"none"}:
            lidars = (*LIDARS, OTHER_LIDAR)
            before = measure_accuracy(single, validate, lidars)
        frames = {row.data: row.frames for row in before}
        while True:
            quantized = quantize(model, ranges, keep_float=in_float)
            write(quantized, path)
            report(
                f"measuring the accuracy with {len(in_float)} of {len(convolutions)} convolutions "
                "in float"
            )
            accuracy = measure_accuracy(path, validate, lidars)
            missed = _missed(before, accuracy, options)
            if missed and sum(frames.values()) < ENOUGH_FRAMES:
                widths = measure_widths(single, path, validate, lidars)
                missed = _missed(before, accuracy, options, widths)
            if not missed:
                break
            if 2 * (len(in_float) - len(always)) >= len(convolutions) - len(always):
                raise ExportError(
                    f"int8 loses too much, so nothing was written: {'; '.join(missed.values())}; "
                    f"{len(in_float)} of {len(convolutions)} convolutions were left in float: "
                    "calibrate on data like those of --validate, or raise --max-drop-miou for mIoU "
                    "or --max-rise-mae for MAE; the other limits have no option"
                )
            head = next(iter(missed))
            if head not in ranked:
                alone = partial(quantize, model, ranges)
                ranked[head] = _rank(model, alone, convolutions, feeds, head)
            others = [name for name in ranked[head] if name not in in_float]
            in_float += others[: max(1, (len(in_float) - len(always)) // 2)]
    facts = {
        "calibration": [without_folders(text) for text in options.calibrate],
        "calibration_frames": len(feeds),
        "float_convolutions": in_float,
        "accuracy_fp32": [asdict(item) for item in before],
        "not_gated": _not_gated(heads, classes, before),
        "warnings": list(warnings),
    }
    return Quantized(quantized, accuracy, facts)


def _feeds(path: Path, options: Int8Options) -> Iterator[Feed]:
    """Yield calibration frames as the engine feeds them to the file, with each LiDAR in turn."""
    with Predictor(path, warmup=0) as predictor:
        contract = predictor.contract
        table = trained_classes(contract.classes, contract.training)
        sources = [_open_set(text, table) for text in options.calibrate]
        counts = share_frames([len(source) for source in sources], CALIBRATION_FRAMES)
        for source, count in zip(sources, counts, strict=True):
            for turn, index in enumerate(np.linspace(0, len(source) - 1, count).round()):
                sample = source[int(index)]
                lidar = LidarInput.parse(CALIBRATION_LIDARS[turn % len(CALIBRATION_LIDARS)])
                split = split_lidar(sample, lidar, frame_generator(int(index)))
                frame = preprocess(
                    sample.rgb,
                    None if split is None else split.fed,
                    size_for=predictor.network_size,
                    scale_for=partial(
                        predictor.camera_scale, focal_length_px=sample.focal_length_px
                    ),
                )
                yield {"rgb": frame.rgb[None], "sparse_depth": frame.sparse_depth[None]}


def _open_set(text: str, table: ClassTable) -> SampleSource:
    recipe = parse_data(text)
    classes = share_classes(recipe, recipe.title, {"model": table})
    return open_dataset(recipe, [Path()], classes=classes.table)


def share_frames(sizes: Sequence[int], total: int) -> list[int]:
    """Distribute a total number of frames over sets of these sizes as evenly as possible."""
    counts = [0] * len(sizes)
    for place, index in enumerate(sorted(range(len(sizes)), key=lambda index: sizes[index])):
        share = math.ceil((total - sum(counts)) / (len(sizes) - place))
        counts[index] = min(sizes[index], share)
    return counts


def _missed(
    before: Sequence[Accuracy],
    after: Sequence[Accuracy],
    options: Int8Options,
    widths: Widths | None = None,
) -> dict[str, str]:
    """Return the largest loss, in words, of each head that misses the gate; worst head first."""
    excess: dict[str, tuple[float, str]] = {}
    for first, second in zip(before, after, strict=True):
        where = f"on {first.data}, LiDAR {first.lidar}"
        wider = (widths or {}).get((first.data, first.lidar), {})
        for head, loss, most, words in _losses(first, second, options, wider):
            found = loss / max(most, 1e-9), f"{words} {where} (at most {most:.3g})"
            excess[head] = max(excess.get(head, found), found)
    worst_first = sorted(excess.items(), key=lambda entry: -entry[1][0])
    return {head: text for head, (ratio, text) in worst_first if ratio > 1}


def _losses(
    before: Accuracy, after: Accuracy, options: Int8Options, wider: Mapping[str, float]
) -> Iterator[tuple[str, float, float, str]]:
    """Yield head, loss, its limit, and the loss in words, for the figures measured in both.

    `wider` is added to the limits of its figures.
    """
    if before.miou is not None and after.miou is not None:
        drop = 100 * (before.miou - after.miou)
        most = options.max_drop_miou + 100 * wider.get("miou", 0.0)
        yield "semantic", drop, most, f"semantic loses {drop:.2f} points of mIoU"
    for name, iou in before.class_iou.items():
        drop = 100 * (iou - after.class_iou[name])
        words = f"semantic loses {drop:.2f} points of the IoU of {name}"
        yield "semantic", drop, MAX_DROP_CLASS_IOU, words
    if before.boundary_f is not None and after.boundary_f is not None:
        drop = before.boundary_f - after.boundary_f
        yield "boundary", drop, MAX_DROP_BOUNDARY_F, f"boundary loses {drop:.4f} of F"
    if before.mae_m is not None and after.mae_m is not None:
        rise = 100 * (after.mae_m / max(before.mae_m, 1e-9) - 1)
        most = options.max_rise_mae + 100 * wider.get("mae_m", 0.0) / max(before.mae_m, 1e-9)
        yield "depth", rise, most, f"depth's MAE rises by {rise:.2f} %"
    if before.coverage_1 is not None and after.coverage_1 is not None:
        change = 100 * abs(before.coverage_1 - after.coverage_1)
        words = f"the share of errors within depth_uncertainty changes by {change:.2f} points"
        yield "depth_uncertainty", change, MAX_CHANGE_COVERAGE, words


def _require_rows(heads: Collection[str], rows: Sequence[Accuracy]) -> None:
    """Raise InputError for a head whose accuracy no set can measure."""
    for head, (truth, sets) in _NEEDED.items():
        if head in heads and not _measured(head, rows):
            raise InputError(
                f"--validate: no set has {truth}, so the loss of the {head} head by int8 cannot be "
                f"measured, and nothing was written; add one of {sets}"
            )


def _measured(head: str, rows: Sequence[Accuracy]) -> bool:
    return any(getattr(row, _FIGURES.get(head, ""), None) is not None for row in rows)


def _not_gated(heads: Sequence[str], classes: Sequence[str], rows: Sequence[Accuracy]) -> list[str]:
    """Describe what cannot be measured on these sets."""
    found = [
        f"{head}: no set has ground truth for it" for head in heads if not _measured(head, rows)
    ]
    compared = {name for row in rows for name in row.class_iou}
    if rare := [name for name in classes if "semantic" in heads and name not in compared]:
        found.append(
            f"IoU of {', '.join(rare)}: fewer than {LEAST_CLASS_PIXELS} labelled pixels or "
            f"{LEAST_CLASS_FRAMES} frames"
        )
    return found


def _rank(
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
