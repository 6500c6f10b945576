"""Whether two models differ on the same frames: paired differences with a 95 % interval.

The bootstrap (Efron and Tibshirani 1993) draws the frames repeatedly with replacement, the same
ones for both models, and takes the 2.5th and the 97.5th percentile of the difference. If places or
drives are known, whole places or drives are drawn: neighbouring frames are alike, and drawing
single frames would make the interval too narrow.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from training.scores.metrics import class_iou
from training.scores.score_set import FrameScore, Result, Row
from training.scores.scoring import OTHER

# Number of draws, and their seed.
_DRAWS, _SEED = 2000, 0
# Least number of places or drives to be drawn instead of frames, and of frames for a verdict. Two
# equal models differ in the same direction on all of five by chance in 6 % of the cases, on all of
# six in 3 %, and the interval is then on one side of 0 however few there are.
LEAST_DRAWN = 6
# Least share of the labels that is scored, for a verdict on classes.
LEAST_SCORED = 0.8
# Number of draws that are computed at once.
_CHUNK = 100
_Array = NDArray[np.float64]
# The sums of each frame, what gives figures of summed frames, and the names of these figures.
_Kind = tuple[Callable[[FrameScore], Any], Callable[[_Array], _Array], tuple[str, ...]]


class Interval(NamedTuple):
    """A difference with its 95 % interval, as a share or in metres."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Difference:
    """A model compared with another on the frames of one set with one input.

    Attributes:
        row: the score of the model that is judged.
        against: the model with which it is compared.
        groups: number of places or drives that were drawn; 0 if single frames were drawn.
        figures: for "miou", "mae_m", "rmse_m" and the mean error of each other head, the value of
            the model minus that of the other, if both have it.
    """

    row: Row
    against: str
    groups: int
    figures: Mapping[str, Interval] = field(default_factory=dict)

    def verdict(self, figure: str) -> str:
        """Return "better", "worse", "not distinguishable on N frames", or why there is none."""
        if figure == "miou" and self.row.scored_labels < LEAST_SCORED:
            return f"no verdict: {self.row.scored_labels:.0%} of the labels are scored"
        if self.row.frames < LEAST_DRAWN:
            return f"too few frames: {self.row.frames}, at least {LEAST_DRAWN} are needed"
        _, low, high = self.figures[figure]
        if low <= 0 <= high:
            return f"not distinguishable on {self.sample}"
        return "better" if (low > 0) == (figure == "miou") else "worse"

    @property
    def sample(self) -> str:
        """The basis of the verdict, in words."""
        return f"{self.row.frames} frames" + f" of {self.groups} places" * bool(self.groups)


def compare(results: Sequence[Result]) -> list[Difference]:
    """Compare every other model with the first one, on each set with each input.

    Args:
        results: results of `evaluate`, with the models in their order.
    """
    firsts: dict[tuple[str, str, str], Result] = {}
    found = []
    for result in results:
        row = result.row
        first = firsts.setdefault((row.data, row.lidar, row.fault), result)
        if first is not result and (figures := dict(_differences(first, result))):
            groups = len({frame.group for frame in result.frames})
            groups = groups if groups >= LEAST_DRAWN else 0
            found.append(Difference(row, first.row.model, groups, figures))
    return found


def _differences(first: Result, second: Result) -> Iterator[tuple[str, Interval]]:
    pair = [{frame.index: frame for frame in result.frames} for result in (first, second)]
    indices = sorted(set.intersection(*map(set, pair)))
    frames = [[found[index] for index in indices] for found in pair]
    names = [frame.group for frame in frames[0]]
    if len(set(names)) < LEAST_DRAWN:
        names = [str(index) for index in indices]
    group = np.unique(names, return_inverse=True)[1]
    weights = np.random.default_rng(_SEED).multinomial(
        len(set(names)), np.full(len(set(names)), 1 / len(set(names))), size=_DRAWS
    )
    heads = sorted({head for found in frames for frame in found for head in frame.others})
    kinds: list[_Kind] = [
        (attrgetter("confusion"), _mean_iou, ("miou",)),
        (attrgetter("depth"), _errors, ("mae_m", "rmse_m")),
        *((partial(_other, head), _errors, (f"{OTHER}{head}",)) for head in heads),
    ]
    for part, figures, keys in kinds:
        sums = [np.array([part(frame) for frame in found], np.float64) for found in frames]
        totals = [_by_group(each, group) for each in sums]
        if not all(total.any() for total in totals):
            continue
        whole = [figures(total.sum(axis=0)[None]) for total in totals]
        drawn = [
            np.concatenate(
                [
                    figures(np.tensordot(weights[at : at + _CHUNK], total, 1))
                    for at in range(0, _DRAWS, _CHUNK)
                ]
            )
            for total in totals
        ]
        bounds = np.nanpercentile(drawn[1] - drawn[0], (2.5, 97.5), axis=0)
        for at, key in enumerate(keys):
            value = (whole[1] - whole[0])[0, at]
            yield key, Interval(float(value), *bounds[:, at].tolist())


def _by_group(values: NDArray[np.float64], group: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the sums (groups, ...) of values (frames, ...) in each group."""
    sums = np.zeros((group.max() + 1, *values.shape[1:]))
    np.add.at(sums, group, values)
    return sums


def _other(head: str, frame: FrameScore) -> NDArray[np.float64]:
    return frame.others.get(head, np.zeros(3))


def _mean_iou(confusion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean over the classes that occur, (draws, 1); NaN if none occurs."""
    iou = class_iou(confusion)
    known = ~np.isnan(iou)
    with np.errstate(invalid="ignore"):
        mean = np.where(known, iou, 0).sum(axis=-1, keepdims=True) / known.sum(-1, keepdims=True)
    return np.asarray(mean)


def _errors(depth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return MAE and RMSE [m], (draws, 2); NaN if no pixel was drawn."""
    with np.errstate(invalid="ignore", divide="ignore"):
        means = depth[:, 1:] / depth[:, :1]
    return np.stack([means[:, 0], np.sqrt(means[:, 1])], axis=-1)
