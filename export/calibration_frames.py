"""The frames on which an 8-bit file is calibrated, and what they must have."""

import math
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from export.options import ExportOptions
from export.precision import ENOUGH_FRAMES, LEAST_FRAMES
from export.quantize import Feed
from models import Checkpoint
from models.training_facts import TrainingFacts
from runtime import InputError, Predictor
from runtime.engine.preprocess import preprocess
from training.datasets.class_mapping import ClassTable, trained_classes
from training.datasets.registry import parse_data
from training.datasets.sample import SampleSource
from training.lidar.split import LidarInput, frame_generator, split_lidar
from training.loading.open_dataset import count_frames, count_shared
from training.run.finished_run import open_training_sets
from training.scores.evaluated_set import open_sets

# LiDAR inputs of the calibration frames, used in turn. Activations beyond the calibrated ranges are
# clipped.
CALIBRATION_LIDARS = ("own", "none", "16", "4")
# Number of frames, evenly spread over the sets, on which ranges are calibrated.
CALIBRATION_FRAMES = 128


def require_frames(options: ExportOptions, checkpoint: Checkpoint) -> list[str]:
    """Check that there are `LEAST_FRAMES` to calibrate, and as many others to validate.

    Args:
        options: the data sets, and where the checkpoint is: if it is that of a run, frames that the
            run was trained on are counted.
        checkpoint: checkpoint of the model.

    Returns:
        Warnings: for fewer than `ENOUGH_FRAMES`, and for frames that the model was trained on.

    Raises:
        DatasetError, InputError: if data cannot be read, have fewer frames, or share some frames.
    """
    table = trained_classes(checkpoint.model.config.classes, checkpoint.facts)
    found, warnings = {}, []
    for option, texts in (("--calibrate", options.calibrate), ("--validate", options.validate)):
        found[option] = _open(texts, table)
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
            f"int8 is calibrated and validated on {both} frames, but its loss of accuracy must be "
            "measured on others: give another set, or other frames of it"
        )
    if known := count_shared(
        found["--validate"], open_training_sets(options.source.resolve().parent)
    ):
        count = count_frames(found["--validate"])
        warnings.append(
            f"--validate: the model was trained on {known} of these {count} frames, where it may "
            "lose less accuracy than on new ones"
        )
    return warnings


def calibration_feeds(path: Path, data: Sequence[str]) -> Iterator[Feed]:
    """Yield frames of these sets as the engine feeds them to the file, with each LiDAR in turn."""
    with Predictor(path, warmup=0) as predictor:
        contract = predictor.contract
        table = trained_classes(contract.classes, TrainingFacts.from_dict(contract.training))
        sources = _open(data, table)
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


def _open(data: Sequence[str], table: ClassTable) -> list[SampleSource]:
    sets = open_sets([parse_data(text) for text in data], {"model": table})
    return [item.source for item in sets]


def share_frames(sizes: Sequence[int], total: int) -> list[int]:
    """Distribute a total number of frames over sets of these sizes as evenly as possible."""
    counts = [0] * len(sizes)
    for place, index in enumerate(sorted(range(len(sizes)), key=lambda index: sizes[index])):
        share = math.ceil((total - sum(counts)) / (len(sizes) - place))
        counts[index] = min(sizes[index], share)
    return counts
