"""Two figures for how well returns fit the image under a trial rotation.

The edge figure is the mean boundary probability at the jumps of the scan, minus the mean at all
returns. The depth figure is the correlation of the logarithms of the returns' depths and of the
depths that the network predicts from the image alone. Both are largest at the right rotation.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from runtime.alignment.view import View
from runtime.checks.log_depth import correlation, log_depth
from runtime.geometry.lens import pixels_of_rays

AXES = ("yaw", "pitch", "roll")
BLUR = 2 / 375  # blur of the boundary for the comparison of figures, in image heights
_LEAST = 30  # least number of returns, or jumps, inside the image
_NEAREST_M = 0.1
# Least medians of returns that fit. Right calibrations have a depth figure of 0.57 and more and an
# edge figure of 0.07 to 0.16, wrong ones a depth figure of up to 0.07.
LEAST_CORRELATION, _LEAST_EDGE = 0.5, 0.02

Angles = Sequence[float] | NDArray[np.float64]


class FitScores(NamedTuple):
    """The edge and the depth figure of a view; 0 if too few returns are inside the image."""

    edge: float
    depth_correlation: float

    @property
    def fit(self) -> bool:
        """Whether returns with these medians fit the images."""
        return self.depth_correlation >= LEAST_CORRELATION and self.edge >= _LEAST_EDGE


def rotation(angles: Angles) -> NDArray[np.float64]:
    """Return the matrix (3, 3) of yaw, pitch and roll [degrees] in the axes of the camera.

    Positive yaw moves returns to the right, positive pitch up, positive roll clockwise.
    """
    (sy, sp, sr), (cy, cp, cr) = np.sin(np.radians(angles)), np.cos(np.radians(angles))
    yaw = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    pitch = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    roll = np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
    return np.asarray(yaw @ pitch @ roll)


def fit_scores(view: View, angles: Angles = (0, 0, 0), *, blur: float = BLUR) -> FitScores:
    """Return the figures of a view with its returns turned about the LiDAR's origin."""
    boundary, turn = view.blurred_boundary(blur), rotation(angles)
    row, column, depth = pixels_of(view, view.returns, turn)
    at_row, at_column, _ = pixels_of(view, view.jumps, turn)
    edge = depth_correlation = 0.0
    if len(row) >= _LEAST:
        depth_correlation = correlation(view.log_depth[row, column], log_depth(depth))
        if len(at_row) >= _LEAST:
            edge = float(boundary[at_row, at_column].mean() - boundary[row, column].mean())
    return FitScores(edge, depth_correlation)


def total_scores(
    views: Iterable[View], angles: Angles, *, blur: float = BLUR
) -> NDArray[np.float64]:
    """Return the sum of both figures of each view, float64 (frames,)."""
    return np.array([sum(fit_scores(view, angles, blur=blur)) for view in views])


def pixels_of(
    view: View, points: NDArray[np.float32], turn: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float32]]:
    """Row and column in the answers of a view, and depth [m], of turned points inside its image."""
    calibration, (height, width) = view.calibration, view.boundary.shape
    place = calibration.extrinsics[:3, 3].astype(np.float32)
    turned = points @ turn.T.astype(np.float32) + place
    turned = turned[turned[:, 2] > _NEAREST_M]
    z = turned[:, 2]
    rays = turned[:, 0] / z, turned[:, 1] / z
    pixels = pixels_of_rays(*rays, calibration.lens_model, calibration.intrinsics, view.size)
    column, row = (np.rint((each + 0.5) / view.shrink - 0.5).astype(np.intp) for each in pixels)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    return row[inside], column[inside], z[inside]
