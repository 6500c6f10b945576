"""How well the returns of a view fit its image: the score by which readings are compared.

The boundary figure is the mean boundary probability at the jumps of the scan, minus the mean at all
returns. The depth figures are correlations of the logarithms of the returns' depths and of the
depths that the model predicts from the image alone, also without the mean of each band of rows:
"near below, far above" correlates on every road, even in a dark image. The logarithm of the ratio
of both depths finds a wrong unit, which no correlation does.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from runtime.base.arrays import Float64, Floats, Indices
from runtime.checks.view import View, correlation, log_depth

AXES = ("yaw", "pitch", "roll")
BLUR = 2 / 375  # blur of the boundary for the comparison of figures, in image heights
_LEAST = 30  # least number of returns, or jumps, inside the image
_BANDS = 48  # bands of rows over the height of the image
_EDGE_WEIGHT = 2.0
# Right returns are 0.6 to 1.3 times as far as predicted, in dark images up to 1.7 times.
_USUAL_LOG_RATIO, _MOST_OFF = 0.7, 1.0

Angles = Sequence[float] | Float64


class FitScores(NamedTuple):
    """The figures of a view, and its number of returns; all 0 if too few are inside the image."""

    edge: float = 0.0
    depth_correlation: float = 0.0
    in_bands: float = 0.0
    log_ratio: float = 0.0
    returns: float = 0

    @property
    def score(self) -> float:
        """One number by which readings are compared, at most about 1.4."""
        off = min(max(abs(self.log_ratio) - _USUAL_LOG_RATIO, 0.0), _MOST_OFF)
        return _EDGE_WEIGHT * self.edge + (self.depth_correlation + self.in_bands) / 2 - off


def median_fit(fits: Sequence[FitScores]) -> FitScores:
    """The median of each figure; all 0 of none."""
    return FitScores(*np.median(fits, axis=0).tolist()) if fits else FitScores()


def rotation(angles: Angles) -> Float64:
    """Return the matrix (3, 3) of yaw, pitch and roll [degrees] in the axes of the camera.

    Positive yaw moves returns to the right, positive pitch up, positive roll clockwise.
    """
    (sy, sp, sr), (cy, cp, cr) = np.sin(np.radians(angles)), np.cos(np.radians(angles))
    yaw = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    pitch = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    roll = np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
    return np.asarray(yaw @ pitch @ roll)


def turned(view: View, angles: Angles) -> View:
    """The view with its returns turned about the LiDAR's origin."""
    return view.near(turn=rotation(angles))


def fit_of(view: View, angles: Angles = (0, 0, 0), *, blur: float = BLUR) -> FitScores:
    """Return the figures of a view with its returns turned about the LiDAR's origin."""
    turn, (returns, jumps) = rotation(angles), view.structure
    row, column, depth = view.pixels(returns, turn)
    if len(row) < _LEAST:
        return FitScores()
    boundary, predicted = view.answer.blurred(blur), view.answer.log_depth
    at_row, at_column, _ = view.pixels(jumps, turn)
    edge = 0.0
    if len(at_row) >= _LEAST:
        edge = float(boundary[at_row, at_column].mean() - boundary[row, column].mean())
    both = log_depth(depth), predicted[row, column]
    band = row * _BANDS // len(predicted)
    within = (_without_means(band, each) for each in both)
    log_ratio = float(np.median(both[0] - both[1]))
    return FitScores(edge, correlation(*both), correlation(*within), log_ratio, len(row))


def _without_means(band: Indices, values: Floats) -> Float64:
    """The values minus the mean of their band of rows."""
    count = np.maximum(np.bincount(band, minlength=_BANDS), 1)
    return np.asarray(values - (np.bincount(band, values, _BANDS) / count)[band])
