"""The metrics of Table 1, KITTI's inverse-depth errors, boundary precision and recall, road IoU.

Each `...Scores` accumulates over frames with `update`, adds another's sums with `merge`, and
`compute` returns the metrics of all frames together. Everything is counted over pixels, not
averaged over frames. A number that nothing was measured for is NaN.
"""

import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Any, Self

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torchmetrics.functional.classification import multiclass_confusion_matrix

from training.losses.boundary import boundary_target
from training.losses.semantic import IGNORE

#: The widest range of Table 1 [m]: pixels whose true depth is beyond it are not scored.
FARTHEST_M = 100.0
#: Ranges of true depth [m]: the two others of Table 1, and four that do not overlap.
RANGES_M = ((0.0, 20.0), (0.0, 50.0), (0.0, 10.0), (10.0, 20.0), (20.0, 40.0), (40.0, 100.0))
#: Bins of the errors' histogram, equal in the logarithm [m]: neighbours differ by 0.3 %. The first
#: is of smaller errors, of which the median is 0.
_ERROR_BINS_M = np.concatenate([[0], np.geomspace(1e-3, 1e3, 4097)])
#: The boundary's F-score is reported at the best of these thresholds over the whole set.
BOUNDARY_THRESHOLDS = tuple(threshold / 20 for threshold in range(6, 20))
#: Largest distance between predicted and true boundary pixels that match, and the pixels within it.
TOLERANCE_PX = 2
_REACH = np.arange(-TOLERANCE_PX, TOLERANCE_PX + 1)
_DISK = (_REACH[:, None] ** 2 + _REACH[None, :] ** 2 <= TOLERANCE_PX**2).astype(np.uint8)
#: Smaller predictions are clipped to this value before depth is inverted [m].
_NEAREST_M = 0.1


class Accumulator:
    """Sums over frames: arrays, and accumulators by name or in a dictionary."""

    def merge(self, other: Self) -> None:
        """Add another's sums."""
        for name, ours in vars(self).items():
            theirs = vars(other)[name]
            match ours:
                case np.ndarray():
                    ours += theirs
                case Accumulator():
                    ours.merge(theirs)
                case dict():
                    for key, part in ours.items():
                        part.merge(theirs[key])


@dataclass(frozen=True)
class SemanticMetrics:
    """Table 1, shares 0..1.

    Attributes:
        class_iou: by class id; NaN for a class neither labelled nor predicted.
    """

    accuracy: float
    mean_accuracy: float
    mean_iou: float
    frequency_weighted_iou: float
    class_iou: tuple[float, ...]


class SemanticScores(Accumulator):
    """Acc, mAcc, mIoU and fwIoU from one confusion matrix.

    A class that is neither in the ground truth nor predicted is left out of mIoU; one that is only
    predicted counts with IoU 0. mAcc is over the classes in the ground truth.

    Attributes:
        confusion: int64 (C, C), pixels by label (row) and prediction (column).
        frames: int64 (C,), frames in which a class is labelled.
        unscored: int64 (2,), pixels without a class, and all pixels.
    """

    def __init__(self, num_classes: int) -> None:
        self.num_classes = num_classes
        self.confusion: NDArray[np.int64] = np.zeros((num_classes, num_classes), dtype=np.int64)
        self.frames: NDArray[np.int64] = np.zeros(num_classes, dtype=np.int64)
        self.unscored: NDArray[np.int64] = np.zeros(2, dtype=np.int64)

    def update(self, prediction: NDArray[np.integer], semantic: NDArray[np.integer]) -> None:
        """Count a frame.

        Args:
            prediction: class ids of any integer type (H, W).
            semantic: the labels, class ids (H, W); 255 = ignore.
        """
        known = semantic != IGNORE
        counts = multiclass_confusion_matrix(
            torch.from_numpy(prediction[known].astype(np.int64)),
            torch.from_numpy(semantic[known].astype(np.int64)),
            num_classes=self.num_classes,
            validate_args=False,
        )
        self.unscored += (known.size - known.sum(), known.size)
        self.confusion += counts.numpy()
        self.frames += counts.numpy().any(axis=1)

    def compute_categories(
        self, class_names: Sequence[str], groups: Mapping[str, Set[str]]
    ) -> dict[str, float]:
        """Return the IoU of every category (Cityscapes' IoU_cat is their mean).

        A pixel labelled as a class of no category does not count; one that is only predicted so is
        wrong for the category it is labelled as.

        Args:
            class_names: of the ids 0..C-1.
            groups: category -> names of its classes; a category without any of these classes is
                left out.
        """
        groups = {name: group for name, group in groups.items() if group & set(class_names)}
        if not groups:
            return {}
        member = np.array([[name in group for name in class_names] for group in groups.values()])
        labelled = self.confusion[member.any(axis=0)].astype(np.int64)
        rows = member[:, member.any(axis=0)]
        hit = np.einsum("gi,ij,gj->g", rows, labelled, member, dtype=np.int64)
        union = rows @ labelled.sum(axis=1) + member @ labelled.sum(axis=0) - hit
        iou = _ratio(hit.astype(np.float64), union)
        return dict(zip(groups, iou.tolist(), strict=True))

    def compute(self) -> SemanticMetrics:
        """Return the metrics of all frames so far."""
        hit = np.diag(self.confusion).astype(np.float64)
        labelled = self.confusion.sum(axis=1)
        union = labelled + self.confusion.sum(axis=0) - hit
        iou = _ratio(hit, union)
        in_truth = labelled > 0
        return SemanticMetrics(
            accuracy=float(_ratio(hit.sum(), labelled.sum())),
            mean_accuracy=_mean(_ratio(hit, labelled)[in_truth]),
            mean_iou=_mean(iou[union > 0]),
            frequency_weighted_iou=float(_ratio((labelled * iou)[in_truth].sum(), labelled.sum())),
            class_iou=tuple(iou.tolist()),
        )


class RoadScores(Accumulator):
    """IoU of the road against hand-drawn masks.

    Predicted road is the class of that name, whatever other classes there are.

    Attributes:
        counts: int64 (2, C), pixels by mask (no road, road) and predicted class.
    """

    #: Values of a mask.
    NO_ROAD, ROAD = 0, 1

    def __init__(self, num_classes: int) -> None:
        self.num_classes = num_classes
        self.counts: NDArray[np.int64] = np.zeros((2, num_classes), dtype=np.int64)

    def update(self, prediction: NDArray[np.integer], road_mask: NDArray[np.integer]) -> None:
        """Count a frame.

        Args:
            prediction: class ids (H, W).
            road_mask: (H, W), 0 = not road, 1 = road, anything else = unknown.
        """
        for row, value in enumerate((self.NO_ROAD, self.ROAD)):
            ids = prediction[road_mask == value].astype(np.int64)
            self.counts[row] += np.bincount(ids, minlength=self.num_classes)

    def compute(self, road: int) -> float:
        """Return the IoU of the class `road`, 0..1; NaN without any pixel of either."""
        hit = self.counts[1, road]
        return float(_ratio(hit, self.counts[1].sum() + self.counts[0, road]))


@dataclass(frozen=True)
class Errors:
    """Mean absolute and root mean square error, in the unit of the errors; NaN of no pixels."""

    pixels: int
    mae: float
    rmse: float


class ErrorSums(Accumulator):
    """`Errors` from sums over frames."""

    def __init__(self) -> None:
        self._sums = np.zeros(3)  # pixels, sum |e|, sum e^2

    def add(self, error: NDArray[np.float64]) -> None:
        """Count errors of any shape."""
        self._sums += error.size, np.abs(error).sum(), np.square(error).sum()

    def compute(self) -> Errors:
        """Return the errors of all frames so far."""
        pixels, absolute, square = self._sums
        return Errors(
            int(pixels), float(_ratio(absolute, pixels)), float(np.sqrt(_ratio(square, pixels)))
        )


class ErrorMedian(Accumulator):
    """The median of |e| in metres, of all frames together, by a histogram: to 0.3 %."""

    def __init__(self) -> None:
        self._counts = np.zeros(len(_ERROR_BINS_M) - 1)

    def add(self, error: NDArray[np.float64]) -> None:
        """Count errors [m] of any shape; values beyond the bins count in the last bin."""
        inside = np.minimum(np.abs(error), _ERROR_BINS_M[-1])
        self._counts += np.histogram(inside, _ERROR_BINS_M)[0]

    def compute(self) -> float:
        """Return the median of all frames so far [m]; NaN of no pixels."""
        until = self._counts.cumsum()
        if not until[-1]:
            return float("nan")
        middle = int(np.searchsorted(until, until[-1] / 2))
        return float(np.sqrt(_ERROR_BINS_M[middle] * _ERROR_BINS_M[middle + 1]))


@dataclass(frozen=True)
class DepthMetrics:
    """Errors of depth.

    Attributes:
        metres: over all scored pixels.
        median_m: median of the absolute errors over the same pixels [m].
        per_km: of inverse depth over the same pixels, as KITTI scores depth completion [1/km].
        ranges: range [m] -> errors in metres where the true depth lies in it.
    """

    metres: Errors
    median_m: float
    per_km: Errors
    ranges: Mapping[tuple[float, float], Errors]


class DepthScores(Accumulator):
    """MAE, RMSE, median, iMAE and iRMSE over the same pixels, and MAE and RMSE within ranges.

    A range is the true depths above its first and up to its last [m]. Pixels whose true depth
    is beyond `FARTHEST_M` are not scored.

    Attributes:
        unscored: int64 (2,), pixels of these depths, and all with a true depth.
    """

    def __init__(self) -> None:
        self.unscored: NDArray[np.int64] = np.zeros(2, dtype=np.int64)
        self._metres, self._per_km, self._median = ErrorSums(), ErrorSums(), ErrorMedian()
        self._ranges = {item: ErrorSums() for item in RANGES_M}

    def update(self, prediction: NDArray[np.floating], depth: NDArray[np.floating]) -> None:
        """Count a frame.

        Args:
            prediction: float (H, W) [m]; 0, "no answer", is scored as a depth. Where depth is
                inverted, below 0.1 m counts as 0.1 m.
            depth: the true depth, float (H, W) [m]; 0, negative or not finite = unknown.
        """
        known = scored(depth)
        self.unscored += np.count_nonzero(depth > FARTHEST_M), np.count_nonzero(depth > 0)
        truth = depth[known].astype(np.float64)
        answer = prediction[known].astype(np.float64)
        error = answer - truth
        self._metres.add(error)
        self._median.add(error)
        for (above, limit), sums in self._ranges.items():
            sums.add(error[(truth > above) & (truth <= limit)])
        self._per_km.add(1000 * (1 / np.maximum(answer, _NEAREST_M) - 1 / truth))

    def compute(self) -> DepthMetrics:
        """Return the metrics of all frames so far."""
        ranges = {item: sums.compute() for item, sums in self._ranges.items()}
        return DepthMetrics(
            self._metres.compute(), self._median.compute(), self._per_km.compute(), ranges
        )


@dataclass(frozen=True)
class BoundaryMetrics:
    """Precision, recall and their harmonic mean at one threshold, shares 0..1."""

    threshold: float
    precision: float
    recall: float
    f_score: float


class DisparityScores(ErrorSums):
    """MAE and RMSE of disparity, as the paper scores depth on Cityscapes: d = f * b / depth.

    Over the same pixels as `DepthScores`, in pixels of the data set's images.
    """

    def update(
        self,
        prediction: NDArray[np.floating],
        depth: NDArray[np.floating],
        focal_baseline_px_m: float,
    ) -> None:
        """Count a frame.

        Args:
            prediction: float (H, W) [m]; below 0.1 m counts as 0.1 m.
            depth: the true depth, float (H, W) [m]; 0 = unknown.
            focal_baseline_px_m: focal length times baseline [px m].
        """
        known = scored(depth)
        answer = np.maximum(prediction[known].astype(np.float64), _NEAREST_M)
        self.add(focal_baseline_px_m * (1 / answer - 1 / depth[known].astype(np.float64)))


class BoundaryScores(Accumulator):
    """Boundary precision, recall and F-score at a pixel tolerance.

    Predicted boundary is where the probability exceeds a threshold; true boundary where the label
    changes, see `training.losses.boundary.boundary_target`. A predicted pixel is right if a true
    pixel lies within `TOLERANCE_PX` of it (Euclidean), and the reverse is a found pixel; that is
    dilation, not one-to-one matching. Predictions are not thinned: a line that is thick, but within
    the tolerance of the truth, is right. Pixels whose truth is unknown are left out. Of several
    thresholds `compute` takes that of the best F-score over the whole set (ODS).
    """

    def __init__(self) -> None:
        # A row a threshold: predicted, right, true, found pixels.
        self._counts = np.zeros((len(BOUNDARY_THRESHOLDS), 4), dtype=np.int64)

    def update(self, probability: NDArray[np.floating], semantic: NDArray[np.integer]) -> None:
        """Count a frame.

        Args:
            probability: of a boundary, float (H, W), 0..1.
            semantic: the labels, class ids (H, W); 255 = ignore.
        """
        target, valid = boundary_target(torch.from_numpy(semantic.astype(np.int64))[None])
        known = valid[0, 0].numpy()
        true = target[0, 0].numpy() & known
        near_true = cv2.dilate(true.astype(np.uint8), _DISK) > 0
        for row, threshold in enumerate(BOUNDARY_THRESHOLDS):
            predicted = (probability > threshold) & known
            near = cv2.dilate(predicted.astype(np.uint8), _DISK) > 0
            self._counts[row] += (
                np.count_nonzero(predicted),
                np.count_nonzero(predicted & near_true),
                np.count_nonzero(true),
                np.count_nonzero(true & near),
            )

    def compute(self, threshold: float | None = None) -> BoundaryMetrics:
        """Return the metrics of all frames so far at a threshold; None = the best.

        Precision is NaN where nothing was predicted, recall where nothing was to be found; the
        F-score is then 0, or NaN if both are missing.
        """
        if threshold is not None:
            return self._metrics()[BOUNDARY_THRESHOLDS.index(threshold)]
        return max(self._metrics(), key=lambda item: item.f_score)

    def _metrics(self) -> list[BoundaryMetrics]:
        """Return the metrics at each threshold."""
        metrics = []
        for threshold, (predicted, right, true, found) in zip(
            BOUNDARY_THRESHOLDS, self._counts.tolist(), strict=True
        ):
            precision = right / predicted if predicted else float("nan")
            recall = found / true if true else float("nan")
            f_score = 2 * precision * recall / (precision + recall) if right and found else 0.0
            if not (predicted or true):
                f_score = float("nan")
            metrics.append(BoundaryMetrics(threshold, precision, recall, f_score))
        return metrics


def scored(depth: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Return where a true depth [m] is known and counts."""
    return np.asarray((depth > 0) & (depth <= FARTHEST_M))


def _ratio(numerator: Any, denominator: Any) -> NDArray[np.float64]:
    """Divide; 0 / 0 is NaN without a warning."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.true_divide(numerator, denominator), dtype=np.float64)


def _mean(values: NDArray[np.float64]) -> float:
    return float(values.mean()) if values.size else float("nan")


def frame_errors(
    depth: NDArray[np.float32], truth: NDArray[np.float32]
) -> tuple[float, float, float]:
    """Return MAE, RMSE and median of the absolute errors [m] of a frame with truth.

    A depth beyond `FARTHEST_M` counts as that: otherwise a method that does not know the limit
    would be behind.

    Args:
        depth: (H, W), metres.
        truth: (H, W), metres, 0 = none; not scored beyond `FARTHEST_M`.
    """
    known = (truth > 0) & (truth <= FARTHEST_M)
    error = np.abs(np.minimum(depth[known], FARTHEST_M) - truth[known])
    return float(error.mean()), math.sqrt(np.square(error).mean()), float(np.median(error))
