"""The metrics of Table 1, KITTI's, and those of boundaries, of the road and of uncertainty.

Each `...Scores` accumulates over frames with `update` and adds the sums of another one with
`merge`. `figures` returns the metrics of all frames together by name: shares in 0..1, metres, 1/km,
pixels. Everything is counted over pixels, not averaged over frames. Figures for which nothing was
measured are left out.
"""

import copy
import math
from collections.abc import Mapping, Sequence
from typing import Any, Self

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from models.classes import CATEGORIES
from runtime.contract.contract import NO_CLASS
from training.losses.boundary import boundary_target

# End of the widest range of Table 1 [m]; unless another limit is given, pixels with a farther true
# depth are not scored.
FARTHEST_M = 100.0
# Ranges of true depth [m]: the two others of Table 1, and four that do not overlap.
RANGES_M = ((0.0, 20.0), (0.0, 50.0), (0.0, 10.0), (10.0, 20.0), (20.0, 40.0), (40.0, 100.0))
# Largest distance [px] to the nearest return that was fed, of each region: Euclidean, between the
# centres of pixels, at the size of the frame.
RETURN_DISTANCES: Mapping[str, float] = {
    "return_0_px": 0,
    "return_1_2_px": 2,
    "return_3_6_px": 6,
    "return_over_6_px": math.inf,
}
# Bins of the errors' histogram, equal in the logarithm [m]; neighbours differ by 0.3 %. The first
# bin holds smaller errors, whose median is reported as 0.
_ERROR_BINS_M = np.concatenate([[0], np.geomspace(1e-3, 1e3, 4097)])
# Shares of a Laplace distribution within one and two of its scales b: 1 - exp(-1), 1 - exp(-2).
LAPLACE_COVERAGE = (0.632, 0.865)
# Of an uncertainty: shares of the pixels, the most confident ones, whose error is reported.
_CONFIDENT = (0.5, 0.8, 1.0)
# Bins of the uncertainty, equal in its logarithm; neighbours differ by 0.3 %.
_LOWEST_M, _HIGHEST_M, _SCALE_BINS = 1e-3, 1e3, 4096
# The boundary's F-score is reported at the best of these thresholds over the whole set.
BOUNDARY_THRESHOLDS = tuple(threshold / 20 for threshold in range(6, 20))
# Largest distance between predicted and true boundary pixels that match, and the pixels within it.
TOLERANCE_PX = 2
_REACH = np.arange(-TOLERANCE_PX, TOLERANCE_PX + 1)
_DISK = (_REACH[:, None] ** 2 + _REACH[None, :] ** 2 <= TOLERANCE_PX**2).astype(np.uint8)
# Name, in lower case, of the class that is scored against masks of the road.
ROAD = "road"
# Smaller predictions are clipped to this value before depth is inverted [m].
_NEAREST_M = 0.1


class Accumulator:
    """Sums over frames: arrays, counts, lists, sets, and accumulators, also in a dictionary."""

    def merge(self, other: Self) -> None:
        """Add the sums of another accumulator."""
        for name, ours in vars(self).items():
            theirs = vars(other)[name]
            match ours:
                case np.ndarray() | int():
                    setattr(self, name, ours + theirs)
                case list():
                    ours.extend(theirs)
                case set():
                    ours |= theirs
                case Accumulator():
                    ours.merge(theirs)
                case dict():
                    for key, part in theirs.items():
                        if key in ours:
                            ours[key].merge(part)
                        else:
                            ours[key] = copy.deepcopy(part)


class SemanticScores(Accumulator):
    """Acc, mAcc, mIoU and fwIoU from one confusion matrix.

    A class that occurs neither in the ground truth nor in the predictions is left out of mIoU, and
    its own IoU is NaN. A class that is only predicted counts with IoU 0. mAcc is over the classes
    in the ground truth. The prediction `num_classes` stands for a class that is none of these,
    which is wrong for every label.

    Attributes:
        confusion: int64 (C, C + 1), pixels by label (row) and prediction (column).
        frames: int64 (C,), number of frames in which a class is labelled.
        unscored: int64 (2,), pixels without a class, and all pixels.
    """

    def __init__(self, num_classes: int) -> None:
        shape = (num_classes, num_classes + 1)
        self.confusion: NDArray[np.int64] = np.zeros(shape, dtype=np.int64)
        self.frames: NDArray[np.int64] = np.zeros(num_classes, dtype=np.int64)
        self.unscored: NDArray[np.int64] = np.zeros(2, dtype=np.int64)

    def update(self, prediction: NDArray[np.integer], semantic: NDArray[np.integer]) -> None:
        """Count a frame.

        Args:
            prediction: class ids of any integer type (H, W).
            semantic: the labels, class ids (H, W); 255 = ignore.
        """
        known = semantic != NO_CLASS
        pairs = semantic[known].astype(np.intp) * self.confusion.shape[1] + prediction[known]
        counts = np.bincount(pairs, minlength=self.confusion.size).reshape(self.confusion.shape)
        self.unscored += (known.size - known.sum(), known.size)
        self.confusion += counts
        self.frames += counts.any(axis=1)

    def figures(self, class_names: Sequence[str] = ()) -> dict[str, float]:
        """Return the metrics of all frames so far.

        Args:
            class_names: names of the classes; without them there is no IoU of single classes.
        """
        if not self.confusion.any():
            return {}
        labelled, hit = self.confusion.sum(axis=1), np.diag(self.confusion)
        iou = class_iou(self.confusion)
        figures = {
            "miou": float(np.nanmean(iou)),
            "accuracy": float(hit.sum() / labelled.sum()),
            "mean_accuracy": float(np.nanmean(_ratio(hit, labelled))),
            "fwiou": float(np.nansum(labelled * iou) / labelled.sum()),
        }
        if class_names:
            named = zip(class_names, iou.tolist(), strict=True)
            figures |= {f"iou_{name}": value for name, value in named}
            if not self.confusion[:, -1].any():  # the category of another class is unknown
                figures |= self._category_figures(class_names)
        return figures

    def _category_figures(self, class_names: Sequence[str]) -> dict[str, float]:
        """Return the IoU of each of `CATEGORIES`, and their mean (Cityscapes' IoU_cat).

        A pixel whose label belongs to no category does not count. A pixel for which only the
        prediction belongs to none is wrong for the category of its label. Without a class for each
        of the categories there are no such figures: another mean would have their name.
        """
        if not all(group & set(class_names) for group in CATEGORIES.values()):
            return {}
        member = np.array([[name in of for name in class_names] for of in CATEGORIES.values()])
        labelled = self.confusion[member.any(axis=0), :-1]
        rows = member[:, member.any(axis=0)]
        hit = np.einsum("gi,ij,gj->g", rows, labelled, member, dtype=np.int64)
        iou = _ratio(hit, rows @ labelled.sum(axis=1) + member @ labelled.sum(axis=0) - hit)
        if np.isnan(iou).all():
            return {}
        figures = {
            f"category_iou_{name}": value
            for name, value in zip(CATEGORIES, iou.tolist(), strict=True)
        }
        return {"category_miou": float(np.nanmean(iou)), **figures}


def class_iou(confusion: NDArray[Any]) -> NDArray[np.float64]:
    """Return the IoU (..., C) of confusions (..., C, C + 1); NaN for classes that do not occur."""
    hit = np.diagonal(confusion, axis1=-2, axis2=-1)
    return _ratio(hit, confusion.sum(axis=-1) + confusion.sum(axis=-2)[..., :-1] - hit)


class RoadScores(Accumulator):
    """IoU of the road against hand-drawn masks.

    Predicted road is the class of that name, whatever other classes there are.

    Attributes:
        counts: int64 (2, C + 1), pixels by mask (no road, road) and predicted class.
    """

    def __init__(self, num_classes: int) -> None:
        self.counts: NDArray[np.int64] = np.zeros((2, num_classes + 1), dtype=np.int64)

    def update(self, prediction: NDArray[np.integer], road_mask: NDArray[np.integer]) -> None:
        """Count a frame.

        Args:
            prediction: class ids (H, W).
            road_mask: (H, W), 0 = not road, 1 = road, anything else = unknown.
        """
        for value in (0, 1):
            ids = prediction[road_mask == value]
            self.counts[value] += np.bincount(ids, minlength=self.counts.shape[1])

    def figures(self, class_names: Sequence[str]) -> dict[str, float]:
        """Return the IoU of the class "road", in any case; NaN without any pixel of either."""
        names = [name.lower() for name in class_names]
        if not self.counts.any() or ROAD not in names:
            return {}
        road = names.index(ROAD)
        hit = self.counts[1, road]
        return {"road_iou": float(_ratio(hit, self.counts[1].sum() + self.counts[0, road]))}


class ErrorSums(Accumulator):
    """Mean absolute and root mean square error, from sums over frames."""

    def __init__(self) -> None:
        self._sums = np.zeros(3)  # pixels, sum |e|, sum e^2

    @property
    def mean(self) -> float:
        """The mean absolute error; NaN without errors."""
        return float(_ratio(self._sums[1], self._sums[0]))

    def add(self, error: NDArray[np.float64]) -> None:
        """Count errors of any shape."""
        self._sums += error.size, np.abs(error).sum(), np.square(error).sum()

    @property
    def sums(self) -> NDArray[np.float64]:
        """Number of errors, sum of their absolute values and sum of their squares: float64 (3,)."""
        return self._sums.copy()

    def figures(self, name: str) -> dict[str, float]:
        """Return mae_NAME and rmse_NAME of all errors so far, in their unit."""
        pixels, absolute, square = self._sums.tolist()
        if not pixels:
            return {}
        return {f"mae_{name}": absolute / pixels, f"rmse_{name}": math.sqrt(square / pixels)}


class DepthErrors:
    """The errors of an answer to one frame, where its true depth is scored.

    Args:
        answer: float (H, W) [m]; 0, "no answer", is scored as a depth.
        depth: the true depth, float (H, W) [m]; 0, negative or not finite = unknown.
        farthest_m: farthest true depth that is scored [m].

    Attributes:
        known: bool (H, W), the N pixels that are scored.
        truth: the true depth of the scored pixels, float64 (N,) [m].
        answer: the answer there, float64 (N,) [m].
        error: answer minus truth, float64 (N,) [m].
        unscored: number of pixels with a farther true depth, and of all with a true depth.
    """

    def __init__(
        self,
        answer: NDArray[np.floating],
        depth: NDArray[np.floating],
        farthest_m: float = FARTHEST_M,
    ) -> None:
        self.known = scored(depth, farthest_m)
        self.truth = depth[self.known].astype(np.float64)
        self.answer = answer[self.known].astype(np.float64)
        self.error = self.answer - self.truth
        self.unscored = np.count_nonzero(depth > farthest_m), np.count_nonzero(depth > 0)


class DepthScores(Accumulator):
    """MAE, RMSE and median of depth, MAE and RMSE of its inverse, within ranges, and near returns.

    A range contains the true depths above its first and up to its last value [m]; the last one ends
    at `farthest_m`, if that is beyond `FARTHEST_M`. The median comes from a histogram and is exact
    to 0.3 %. Inverse depth is scored like KITTI scores depth completion [1/km], and where focal
    length and baseline are known also as disparity, d = f * b / depth, like the paper on
    Cityscapes, in pixels of the data set's images.

    Attributes:
        unscored: int64 (2,), pixels with such depths, and all pixels with a true depth.
    """

    def __init__(self, farthest_m: float = FARTHEST_M) -> None:
        self.unscored: NDArray[np.int64] = np.zeros(2, dtype=np.int64)
        self._metres, self._per_km, self._px = ErrorSums(), ErrorSums(), ErrorSums()
        beyond = ((FARTHEST_M, farthest_m),) if farthest_m > FARTHEST_M else ()
        self._ranges = {item: ErrorSums() for item in (*RANGES_M, *beyond)}
        self._regions = {region: ErrorSums() for region in RETURN_DISTANCES}
        self._histogram = np.zeros(len(_ERROR_BINS_M) - 1)

    def update(
        self,
        errors: DepthErrors,
        focal_baseline_px_m: float | None = None,
        fed: NDArray[np.floating] | None = None,
    ) -> None:
        """Count a frame.

        Args:
            errors: its errors. Before depth is inverted, values below 0.1 m become 0.1 m.
            focal_baseline_px_m: focal length times baseline [px m]; None: there is no disparity.
            fed: the depth that was fed, float (H, W), 0 = no return, for the errors in each of
                `RETURN_DISTANCES`; None: these are not counted.
        """
        truth, error = errors.truth, errors.error
        self.unscored += errors.unscored
        self._metres.add(error)
        # Errors beyond the bins count in the last one.
        self._histogram += np.histogram(
            np.minimum(np.abs(error), _ERROR_BINS_M[-1]), _ERROR_BINS_M
        )[0]
        for (above, limit), sums in self._ranges.items():
            sums.add(error[(truth > above) & (truth <= limit)])
        inverse = 1 / np.maximum(errors.answer, _NEAREST_M) - 1 / truth
        self._per_km.add(1000 * inverse)
        if focal_baseline_px_m is not None:
            self._px.add(focal_baseline_px_m * inverse)
        if fed is not None:
            for region, mask in split_distances(distance_px(fed > 0)).items():
                self._regions[region].add(error[mask[errors.known]])

    @property
    def sums(self) -> NDArray[np.float64]:
        """Number of scored pixels, sum of |error| [m] and sum of its square: float64 (3,)."""
        return self._metres.sums

    def figures(self) -> dict[str, float]:
        """Return the metrics of all frames so far."""
        figures = self._metres.figures("m")
        if not figures:
            return {}
        for (above, limit), sums in self._ranges.items():
            figures |= sums.figures(f"m_{above:g}_{limit:g}")
        until = self._histogram.cumsum()
        middle = int(np.searchsorted(until, until[-1] / 2))
        figures["median_m"] = math.sqrt(_ERROR_BINS_M[middle] * _ERROR_BINS_M[middle + 1])
        inverse = self._per_km.figures("per_km")
        figures |= {f"i{name}": value for name, value in inverse.items()}
        figures |= self._px.figures("px")
        for region, sums in self._regions.items():
            figures |= sums.figures(f"m_{region}")
        return figures


class UncertaintyScores(Accumulator):
    """Error of the most confident shares of the pixels of all frames together, and coverage.

    The pixels of all frames are ranked together with a histogram of `_SCALE_BINS` bins over the
    logarithm of the uncertainty, so that memory is bounded. If a share ends within a bin, a part of
    the bin is taken, as if its pixels had equal errors.
    """

    def __init__(self) -> None:
        # The columns are number of pixels and sum |e|.
        self._bins = np.zeros((_SCALE_BINS, 2))
        self._within = np.zeros(2)  # pixels whose error is at most one and two scales

    def update(self, uncertainty: NDArray[np.floating], errors: DepthErrors) -> None:
        """Count a frame by the scale of its Laplace distributions, float (H, W) [m], and errors."""
        scale, error = uncertainty[errors.known].astype(np.float64), np.abs(errors.error)
        place = np.log(np.clip(scale, _LOWEST_M, _HIGHEST_M) / _LOWEST_M)
        index = (place / np.log(_HIGHEST_M / _LOWEST_M) * (_SCALE_BINS - 1)).astype(np.intp)
        self._bins[:, 0] += np.bincount(index, minlength=_SCALE_BINS)
        self._bins[:, 1] += np.bincount(index, weights=error, minlength=_SCALE_BINS)
        self._within += [(error <= factor * scale).sum() for factor in (1, 2)]

    def reliability(self, groups: int = 10) -> list[tuple[float, float]]:
        """Return mean scale and mean |error| [m] of pixels in groups of equal number, by scale.

        The mean |error| of a Laplace distribution is its scale.
        """
        pixels = self._bins[:, 0].sum()
        if not pixels:
            return []
        middles = np.geomspace(_LOWEST_M, _HIGHEST_M, _SCALE_BINS)
        sums = np.stack([self._bins[:, 0], self._bins[:, 0] * middles, self._bins[:, 1]])
        counts, scales, errors = np.pad(sums, ((0, 0), (1, 0))).cumsum(axis=1)
        at = np.linspace(0, pixels, groups + 1)
        means = (np.diff(np.interp(at, counts, each)) for each in (scales, errors))
        scale, error = (each * groups / pixels for each in means)
        return list(zip(scale.tolist(), error.tolist(), strict=True))

    def figures(self) -> dict[str, float]:
        """Return the errors [m] of the confident pixels, and the coverage of the errors.

        coverage_1 and coverage_2 are the shares within one and two scales, see `LAPLACE_COVERAGE`.
        """
        pixels = self._bins[:, 0].sum()
        if not pixels:
            return {}
        counts, errors = np.vstack([np.zeros(2), self._bins.cumsum(axis=0)]).T
        figures = {
            f"mae_m_confident_{100 * share:.0f}": float(
                np.interp(share * pixels, counts, errors) / (share * pixels)
            )
            for share in _CONFIDENT
        }
        within = (self._within / pixels).tolist()
        return figures | dict(zip(("coverage_1", "coverage_2"), within, strict=True))


class BoundaryScores(Accumulator):
    """Boundary precision, recall and F-score at a tolerance in pixels.

    Predicted boundary is where the probability exceeds a threshold. True boundary is where the
    label changes, see `training.losses.boundary.boundary_target`. A predicted pixel is right if a
    true pixel lies within `TOLERANCE_PX` of it (Euclidean), and a true pixel is found if a
    predicted one lies so near; this is dilation, not one-to-one matching. Predictions are not
    thinned: a thick line within the tolerance of the truth is right. Pixels whose truth is unknown
    are left out. `figures` takes the threshold with the best F-score over the whole set (ODS).
    """

    def __init__(self) -> None:
        # There is one row for each threshold: predicted, right, true and found pixels.
        self._counts = np.zeros((len(BOUNDARY_THRESHOLDS), 4), dtype=np.int64)

    def update(self, probability: NDArray[np.floating], semantic: NDArray[np.integer]) -> None:
        """Count a frame.

        Args:
            probability: probability of a boundary, float (H, W), 0..1.
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

    def figures(self, threshold: float | None = None) -> dict[str, float]:
        """Return the metrics of all frames so far at a threshold; None: at the best one.

        If nothing was predicted, precision is NaN and the F-score is 0.
        """
        predicted, right, true, found = self._counts.T
        if not true.any():
            return {}
        precision, recall = _ratio(right, predicted), _ratio(found, true)
        f_score = np.where(right * found, _ratio(2 * precision * recall, precision + recall), 0.0)
        best = f_score.argmax() if threshold is None else BOUNDARY_THRESHOLDS.index(threshold)
        return {
            "boundary_f": float(f_score[best]),
            "boundary_precision": float(precision[best]),
            "boundary_recall": float(recall[best]),
            "boundary_threshold": BOUNDARY_THRESHOLDS[best],
        }


def scored(depth: NDArray[np.floating], farthest_m: float = FARTHEST_M) -> NDArray[np.bool_]:
    """Return where a true depth [m] is known and counts."""
    return np.asarray((depth > 0) & (depth <= farthest_m))


def _ratio(numerator: Any, denominator: Any) -> NDArray[np.float64]:
    """Divide; 0 / 0 is NaN without a warning."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.true_divide(numerator, denominator), dtype=np.float64)


def frame_errors(
    depth: NDArray[np.float32], truth: NDArray[np.float32]
) -> tuple[float, float, float]:
    """Return MAE, RMSE and median of the absolute errors [m] of a frame with truth.

    A depth beyond `FARTHEST_M` counts as that value; otherwise a method that does not know the
    limit would be at a disadvantage.

    Args:
        depth: (H, W), metres.
        truth: (H, W), metres, 0 = none; depths beyond `FARTHEST_M` are not scored.
    """
    known = scored(truth)
    error = np.abs(np.minimum(depth[known], FARTHEST_M) - truth[known])
    return float(error.mean()), math.sqrt(np.square(error).mean()), float(np.median(error))


def split_distances(to_return_px: NDArray[np.float32]) -> dict[str, NDArray[np.bool_]]:
    """Return the mask, bool (H, W), of each of `RETURN_DISTANCES`; they do not overlap.

    `to_return_px`, (H, W), is the distance to the nearest return that was fed.
    """
    masks, above = {}, -1.0
    for region, limit in RETURN_DISTANCES.items():
        masks[region] = (to_return_px > above) & (to_return_px <= limit)
        above = limit
    return masks


def distance_px(mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the distance of every pixel to the nearest of the mask; infinite if it is empty."""
    if not mask.any():  # OpenCV's distance would be finite
        return np.full(mask.shape, np.inf, np.float32)
    return np.asarray(
        cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    )
