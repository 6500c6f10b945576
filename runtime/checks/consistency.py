"""Figures that show whether camera and LiDAR are still calibrated and in sync; off by default.

Which figure changes depends on the fault (measured in docs/results.md): edge agreement and hold-out
error change with a rotated calibration or shifted stamps, the scale error with wrong depths.
Returns are held out in squares, because between nearby returns the network interpolates, whatever
the image shows. There are no limits: the usual values depend on model, sensors and roads, so each
figure is accompanied by its change since the first minute of the stream.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.base.arguments import check_number
from runtime.base.errors import InputError
from runtime.checks.view import log_depth
from runtime.engine.prediction import Prediction
from runtime.geometry.returns import is_measured

_SHARE = "consistency, the share of the returns that is held out,"
_WEIGHT = 0.1  # weight of a new frame in the running means
_SCALE_EVERY = 10  # frames from one scale error, which needs a second prediction, to the next
_SQUARES = 8  # squares per image height; whole squares are held out
_NEIGHBOUR_PX = 8  # largest distance of two returns of a row or column that are compared
_JUMP = 1.25  # ratio of the depths of two neighbouring returns at an object edge
_NEAR_M = 30.0  # farther returns are too sparse to be compared with their neighbours
_FIRST_NS = 60_000_000_000  # the first minute, with which later frames are compared


@dataclass(frozen=True)
class Consistency:
    """Running means over the frames of a stream; None before the first frame that has the figure.

    Attributes:
        holdout_error: mean |log(depth / return)| over the returns that were held out.
        edge_agreement: mean boundary probability where the depth of neighbouring returns jumps,
            minus the mean where it does not; it falls when returns no longer fit the image.
        scale_error: median log(depth / return) where depth is predicted from the camera alone,
            every 10th frame; it shifts with the LiDAR's scale, and is not near 0 for a model
            without the camera's focal length.
        holdout_change: `holdout_error` minus its mean over the first minute of the stream, by the
            stamps; None during that minute.
        edge_change: the change of `edge_agreement`.
        scale_change: the change of `scale_error`.
    """

    holdout_error: float | None = None
    edge_agreement: float | None = None
    scale_error: float | None = None
    holdout_change: float | None = None
    edge_change: float | None = None
    scale_change: float | None = None


class ConsistencyCheck:
    """Holds out a share of each frame's returns and compares the prediction with them.

    Args:
        share: share of the returns, 1e-6 to 0.5.

    Raises:
        InputError: if the share is out of range.
    """

    def __init__(self, share: float) -> None:
        self._share = check_number(_SHARE, share, 1e-6, 0.5, error=InputError)
        self._random = np.random.default_rng(0)
        self._holdout, self._edges, self._scale = _Figure(), _Figure(), _Figure(weight=0.5)
        self._frames = 0
        self._first_ns: int | None = None

    @property
    def scale_is_due(self) -> bool:
        """Whether `score` needs a prediction without returns for this frame."""
        return self._frames % _SCALE_EVERY == 0

    def hold_out(
        self, sparse_depth: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Return the remaining returns in a new array, and the mask of the held-out returns."""
        height, width = sparse_depth.shape
        side = max(height // _SQUARES, 1)
        squares = self._random.random((-(-height // side), -(-width // side))) < self._share
        taken = squares.repeat(side, axis=0).repeat(side, axis=1)[:height, :width]
        held_out = is_measured(sparse_depth) & taken
        return np.where(held_out, np.float32(0), sparse_depth), held_out

    def score(
        self,
        prediction: Prediction,
        camera_only: Prediction | None,
        sparse_depth: NDArray[np.float32],
        held_out: NDArray[np.bool_],
        *,
        stamp_ns: int = 0,
    ) -> Consistency:
        """Add a frame and return the running means.

        Args:
            prediction: prediction from the remaining returns.
            camera_only: prediction without any return; None unless `scale_is_due`.
            sparse_depth: float32 (H, W), metres, all returns.
            held_out: bool (H, W), the mask that `hold_out` returned.
            stamp_ns: time stamp of the image.
        """
        self._frames += 1
        returns = is_measured(sparse_depth)
        holdout_error = edge_agreement = scale_error = None
        if prediction.depth is not None and held_out.any():
            ratio = _log_ratio(prediction.depth, sparse_depth, held_out)
            holdout_error = float(np.abs(ratio).mean())
        if prediction.boundary is not None:
            measured = np.where(returns, sparse_depth, np.float32(0))
            edge_agreement = _edge_agreement(prediction.boundary, measured)
        if camera_only is not None and camera_only.depth is not None and returns.any():
            scale_error = float(np.median(_log_ratio(camera_only.depth, sparse_depth, returns)))
        if self._first_ns is None:
            self._first_ns = stamp_ns
        first = stamp_ns - self._first_ns < _FIRST_NS
        figures = self._holdout, self._edges, self._scale
        values = holdout_error, edge_agreement, scale_error
        for figure, value in zip(figures, values, strict=True):
            figure.add(value, first=first)
        return Consistency(
            *(figure.mean for figure in figures),
            *(None if first else figure.change for figure in figures),
        )


class _Figure:
    """A running mean, and the mean of the first minute."""

    def __init__(self, *, weight: float = _WEIGHT) -> None:
        self.mean: float | None = None
        self._weight, self._first, self._frames = weight, 0.0, 0

    @property
    def change(self) -> float | None:
        """Running mean minus the mean of the first minute; None if that minute has no figure."""
        return self.mean - self._first if self.mean is not None and self._frames else None

    def add(self, value: float | None, *, first: bool) -> None:
        """Add the figure of a frame; None if the frame has none."""
        if value is None:
            return
        self.mean = value if self.mean is None else self.mean + self._weight * (value - self.mean)
        if first:
            self._frames += 1
            self._first += (value - self._first) / self._frames


def _log_ratio(
    depth: NDArray[np.float32], sparse_depth: NDArray[np.float32], at: NDArray[np.bool_]
) -> NDArray[np.float32]:
    return log_depth(depth[at]) - log_depth(sparse_depth[at])


def _edge_agreement(
    boundary: NDArray[np.float32], sparse_depth: NDArray[np.float32]
) -> float | None:
    """Mean boundary probability at returns with a depth jump beside them, minus the others'."""
    around = cv2.dilate(boundary, np.ones((3, 3), np.uint8))
    at_jumps, elsewhere = [], []
    for depth, values in ((sparse_depth, around), (sparse_depth.T, around.T)):
        row, column = np.nonzero(depth)  # row after row
        z = depth[row, column]
        beside = (row[1:] == row[:-1]) & (column[1:] - column[:-1] < _NEIGHBOUR_PX)
        nearer, farther = np.minimum(z[1:], z[:-1]), np.maximum(z[1:], z[:-1])
        jump = beside & (farther > _JUMP * nearer) & (nearer < _NEAR_M)
        between = values[row[1:], (column[1:] + column[:-1]) // 2]
        at_jumps.append(between[jump])
        elsewhere.append(between[beside & ~jump])
    jumps, others = np.concatenate(at_jumps), np.concatenate(elsewhere)
    if not jumps.size or not others.size:
        return None
    return float(jumps.mean() - others.mean())
