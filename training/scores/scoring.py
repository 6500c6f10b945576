"""Scores of a network on whole frames, the same for PyTorch and for an exported file."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from models import Network
from models.answers import answers
from runtime.base.arrays import Size
from runtime.base.errors import InputError, SSDNetError
from runtime.contract.canonical_focal import camera_scale
from runtime.contract.contract import NO_CLASS
from runtime.contract.heads import HEADS
from runtime.engine.inference import at_frame_size
from runtime.engine.prediction import HeadArrays
from runtime.engine.preprocess import preprocess
from training.datasets.sample import SampleSource, labelled
from training.lidar.split import LidarInput, LidarSplit, frame_generator, split_lidar
from training.scores import metrics

# Beginning of the names of figures of heads that have no others.
OTHER = "mean_error_"


class HeadMaps(HeadArrays):
    """The maps of a frame that are scored or drawn: answers, or the truth.

    Args:
        **heads: the maps by head, see `HeadArrays`; None for a head that is missing.
    """

    def __init__(self, **heads: NDArray[Any] | None) -> None:
        self.heads = {head: values for head, values in heads.items() if values is not None}

    def with_semantic(self, semantic: NDArray[np.uint8]) -> "HeadMaps":
        """Return the maps with these class ids, uint8 (H, W)."""
        return HeadMaps(**{**self.heads, "semantic": semantic})


# Arguments: rgb uint8 (H, W, 3), sparse_depth float32 (H, W) [m], and the focal length [px of this
# image] or None if it is unknown. Returns the answer at the same size.
Predict = Callable[[NDArray[np.uint8], NDArray[np.float32], float | None], HeadMaps]


def torch_predict(
    network: Network, *, size_for: Callable[[Size], Size] = lambda size: size
) -> Predict:
    """Return the PyTorch network as a predictor that treats a frame like the engine does.

    Args:
        network: the network, which is put into evaluation mode.
        size_for: size at which the network runs for a frame size, both (height, width).
    """
    network.eval()
    config = network.config

    @torch.inference_mode()
    def predict(
        rgb: NDArray[np.uint8], sparse_depth: NDArray[np.float32], focal_length_px: float | None
    ) -> HeadMaps:
        frame = preprocess(
            rgb,
            sparse_depth,
            size_for=size_for,
            scale_for=lambda size: camera_scale(
                config.max_depth_m,
                config.canonical_focal_px,
                focal_length_px,
                frame_size=size,
                network_size=size_for(size),
            ),
        )
        device = network.rgb_mean.device
        output = network(
            torch.from_numpy(frame.rgb).to(device).permute(2, 0, 1)[None].float(),
            torch.from_numpy(frame.sparse_depth).to(device)[None, None],
        )
        found = answers(output, config.max_depth_m)
        heads = {head: found[head][0].cpu().numpy() for head in network.heads}
        for head, values in heads.items():
            if not np.isfinite(values).all() or (head == "semantic" and NO_CLASS in values):
                raise SSDNetError(
                    f"the network's {head} is not finite: its training diverged: take earlier "
                    "weights, such as best.pt of its run"
                )
        return HeadMaps(**at_frame_size(heads, frame))

    return predict


class Scores(metrics.Accumulator):
    """Counts of a whole set, with a part for each head; a part without any target stays empty.

    Depth is scored where the truth is at most `farthest_m` [m].
    """

    def __init__(self, num_classes: int, farthest_m: float = metrics.FARTHEST_M) -> None:
        self._farthest_m = farthest_m
        self.frames = 0
        self.heads: set[str] = set()  # heads that were answered
        self.semantic = metrics.SemanticScores(num_classes)
        self.depth = metrics.DepthScores(farthest_m)
        self.boundary = metrics.BoundaryScores()
        self.uncertainty = metrics.UncertaintyScores()
        self.road = metrics.RoadScores(num_classes)
        self.others: dict[str, metrics.ErrorSums] = {}  # of heads without other figures

    def update(self, answer: HeadMaps, frame: LidarSplit) -> None:
        """Count a frame; missing heads and targets are left out."""
        sample = frame.sample
        self.frames += 1
        self.heads |= answer.heads.keys()
        has_classes = bool((sample.semantic != NO_CLASS).any())
        if answer.semantic is not None and "semantic" in sample.targets:
            self.semantic.update(answer.semantic, sample.semantic)
        if answer.semantic is not None and "road_mask" in sample.targets:
            self.road.update(answer.semantic, sample.targets["road_mask"])
        if answer.depth is not None and frame.target.any():
            errors = metrics.DepthErrors(answer.depth, frame.target, self._farthest_m)
            self.depth.update(errors, sample.focal_baseline_px_m, frame.fed)
            if answer.depth_uncertainty is not None:
                self.uncertainty.update(answer.depth_uncertainty, errors)
        if answer.boundary is not None and has_classes:
            self.boundary.update(answer.boundary, sample.semantic)
        for head in answer.heads.keys() & sample.targets.keys() - {"semantic", "depth"}:
            labels = sample.targets[head]
            known = labelled(head, labels)
            errors = answer.heads[head][known].astype(np.float64) - labels[known]
            self.others.setdefault(head, metrics.ErrorSums()).add(errors)

    def labelled(self, class_names: Sequence[str]) -> dict[str, tuple[int, int]]:
        """Return labelled pixels, and frames that show it, for each class that is labelled."""
        pixels, frames = self.semantic.confusion.sum(axis=1), self.semantic.frames
        counts = zip(class_names, pixels.tolist(), frames.tolist(), strict=True)
        return {name: (n, shown) for name, n, shown in counts if n}

    def unscored(self) -> dict[str, float]:
        """Return the share of the pixels of labels and depth that no figure counts, above 0."""
        counts = {"labels": self.semantic.unscored, "depth": self.depth.unscored}
        return {truth: float(left / every) for truth, (left, every) in counts.items() if left}

    def figures(
        self, class_names: Sequence[str] = (), *, boundary_threshold: float | None = None
    ) -> dict[str, float]:
        """Return the scores as named numbers: shares in 0..1, metres, 1/km, pixels.

        Args:
            class_names: names of the classes; without them there is no IoU of single classes.
            boundary_threshold: one of `BOUNDARY_THRESHOLDS`; None: that of the best F-score.
        """
        return {
            **self.semantic.figures(class_names),
            **self.road.figures(class_names),
            **self.depth.figures(),
            **self.uncertainty.figures(),
            **self.boundary.figures(boundary_threshold),
            **{f"{OTHER}{head}": part.mean for head, part in sorted(self.others.items())},
        }


def scored_classes(figures: Mapping[str, float]) -> str:
    """Return, in words, the classes over which `Scores.figures` has the mIoU; "" for all."""
    ious = [value for key, value in figures.items() if key.startswith("iou_")]
    known = sum(not math.isnan(value) for value in ious)
    return f" over {known} of {len(ious)} classes" if known < len(ious) else ""


def figures_over_places(places: Iterable[Mapping[str, float]]) -> dict[str, float]:
    """Return the mean of each figure over the places that have it.

    All places have the same weight, however many frames show them.
    """
    values: dict[str, list[float]] = {}
    for place in places:
        for key, value in place.items():
            if not math.isnan(value):
                values.setdefault(key, []).append(value)
    return {key: sum(items) / len(items) for key, items in values.items()}


def split_frames(
    source: SampleSource, indices: Iterable[int], lidar: LidarInput
) -> Iterator[LidarSplit]:
    """Split frames of a set, each with its own random numbers, see `split_lidar`.

    Raises:
        InputError: if the set cannot give the LiDAR.
    """
    for index in indices:
        sample = source[index]
        frame = split_lidar(sample, lidar, frame_generator(index))
        if frame is None:
            raise InputError(
                f"{sample.name} cannot be validated with the LiDAR {str(lidar)!r}: 64 lines of a "
                "recorded scan leave nothing to score, an input recorded without its scan lines "
                "has none to choose from, and simulated lines need intrinsics: set the recipe's "
                "validation.lidar to another, for example 'random:0.05'"
            )
        yield frame


def figure_names(
    network: Network, source: SampleSource, indices: Iterable[int], lidar: LidarInput
) -> list[str]:
    """Return the names of the figures that a network gets on frames of a set, without running it.

    Raises:
        InputError: if a frame cannot give the LiDAR.
    """
    scores = Scores(network.config.num_classes)
    for frame in split_frames(source, indices, lidar):
        size = frame.sample.size
        ones = {head: np.ones(size, HEADS[head].dtype) for head in network.heads}
        scores.update(HeadMaps(**ones), frame)
    return list(scores.figures([info.name for info in network.config.classes]))
