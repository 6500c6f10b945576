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

from runtime.base.arguments import check_number
from runtime.base.arrays import Bools, Float32
from runtime.base.errors import InputError
from runtime.checks.view import log_depth
from runtime.engine.prediction import Prediction
from runtime.geometry.returns import is_measured

_SHARE = "consistency, the share of the returns that is held out,"
# Weight of a new frame in the running means of hold-out error, edge agreement and scale error.
_WEIGHTS = np.array([0.1, 0.1, 0.5])
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
        # Running means, and means of the first minute, of the three figures; NaN without any.
        self._means, self._first_means = np.full(3, np.nan), np.full(3, np.nan)
        self._frames = 0
        self._first_frames = np.zeros(3)  # of each figure in the first minute
        self._first_ns: int | None = None

    @property
    def scale_is_due(self) -> bool:
        """Whether `score` needs a prediction without returns for this frame."""
        return self._frames % _SCALE_EVERY == 0

    def hold_out(self, sparse_depth: Float32) -> tuple[Float32, Bools]:
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
        sparse_depth: Float32,
        held_out: Bools,
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
        figures = np.full(3, np.nan)
        if prediction.depth is not None and held_out.any():
            figures[0] = np.abs(_log_ratio(prediction.depth, sparse_depth, held_out)).mean()
        if prediction.boundary is not None:
            measured = np.where(returns, sparse_depth, np.float32(0))
            figures[1] = _edge_agreement(prediction.boundary, measured)
        if camera_only is not None and camera_only.depth is not None and returns.any():
            figures[2] = np.median(_log_ratio(camera_only.depth, sparse_depth, returns))
        if self._first_ns is None:
            self._first_ns = stamp_ns
        is_first, seen = stamp_ns - self._first_ns < _FIRST_NS, ~np.isnan(figures)
        self._means = np.where(np.isnan(self._means), figures, self._means)
        self._means[seen] += (_WEIGHTS * (figures - self._means))[seen]
        if is_first:
            self._first_frames += seen
            self._first_means = np.where(np.isnan(self._first_means), figures, self._first_means)
            steps = (figures - self._first_means)[seen] / self._first_frames[seen]
            self._first_means[seen] += steps
        changes = np.full(3, np.nan) if is_first else self._means - self._first_means
        both = np.concatenate([self._means, changes]).tolist()
        return Consistency(*(None if np.isnan(each) else each for each in both))


def _log_ratio(depth: Float32, sparse_depth: Float32, at: Bools) -> Float32:
    return log_depth(depth[at]) - log_depth(sparse_depth[at])


def _edge_agreement(boundary: Float32, sparse_depth: Float32) -> float:
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
    return float(jumps.mean() - others.mean()) if jumps.size and others.size else np.nan
