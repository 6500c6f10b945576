"""Detects a calibration that was made for images of another size.

Such a calibration puts the principal point far from the middle of the image. Cropped images look
the same. So the calibration is reported only if scaling it to the size of the images moves the
returns to where they fit better to the depth that the model predicts from the image alone.
"""

import numpy as np
from numpy.typing import NDArray

from runtime.contract.degraded import IMAGE_CONSTANT
from runtime.engine.prediction import Prediction
from runtime.geometry.calibration import Calibration
from runtime.geometry.returns import is_measured
from runtime.streams.health.depth_plausibility import BANDS, correlations, log_depth

_FAR = 0.08  # offset of the principal point / width; KITTI, PandaSet, View-of-Delft: at most 0.02
_LEAST_RETURNS = 200
# Gain in correlation, median of up to five frames, of KITTI and PandaSet at 0.5, 0.67, 0.8 and 2
# times the size of their calibration: 0.18 to 1.1; cut at the left or right: -0.3 and less.
_LEAST_GAIN = 0.1

_Index = NDArray[np.intp]


class CalibrationSize:
    """Compares the returns of the first frames of a stream with the camera-only prediction."""

    def __init__(self) -> None:
        self._gains: list[float] = []
        self._suspect, self._scale = "", 1.0

    def add(
        self,
        camera_only: Prediction | None,
        sparse_depth: NDArray[np.float32],
        calibration: Calibration | None,
    ) -> None:
        """Add a frame; ignored where there is nothing to compare.

        Args:
            camera_only: prediction from the image of the frame without any return; None: not
                needed, since no point of the scan fell into the image.
            sparse_depth: float32 (H, W), metres, projected with the calibration.
            calibration: of the frame.
        """
        if calibration is None:
            return
        height, width = sparse_depth.shape
        middle_x, middle_y = calibration.intrinsics[:2, 2]
        if abs(middle_x / width - 0.5) < _FAR or middle_x <= 0:
            return
        self._scale = width / (2 * middle_x)
        if camera_only is not None:
            gain = _gain(camera_only, sparse_depth, self._scale)
        else:
            gain = 1.0 if middle_x > width else None  # no return falls into the image as it is
        if gain is None:
            return
        self._gains.append(gain)
        self._suspect = (
            f"its principal point ({middle_x:.0f}, {middle_y:.0f}) is far from the middle of the "
            f"images of {height} x {width}"
        )

    def finding(self) -> str | None:
        """What is wrong by the frames so far, and what to do; None: nothing was found."""
        if not self._gains or np.median(self._gains) < _LEAST_GAIN:
            return None
        return (
            f"the calibration seems to be for images of another size: {self._suspect}, and the "
            f"returns fit them better at {self._scale:.2g} times its scale. Use images of the "
            f"calibrated size, or multiply the first two rows of the intrinsics by the ratio of "
            f"the image width to the calibrated width, about {self._scale:.2g}, in a TOML file "
            "for --calibration"
        )


def _gain(camera_only: Prediction, sparse_depth: NDArray[np.float32], scale: float) -> float | None:
    """Correlation gained by moving the returns to `scale` times their pixels; None: not known."""
    if camera_only.depth is None or not camera_only.valid:
        return None
    height, width = sparse_depth.shape
    row, column = np.nonzero(is_measured(sparse_depth))
    inside = (row * scale < height - 0.5) & (column * scale < width - 0.5)
    if np.count_nonzero(inside) < _LEAST_RETURNS or IMAGE_CONSTANT in camera_only.degraded:
        return None
    depth, measured = camera_only.depth, np.log(sparse_depth[row, column].astype(np.float64))

    def fit(row: _Index, column: _Index, measured: NDArray[np.float64]) -> float:
        seen = log_depth(depth, row, column)
        return sum(correlations(row * BANDS // height, measured, seen)) / 2

    moved_row, moved_column = (np.rint(p[inside] * scale).astype(np.intp) for p in (row, column))
    return fit(moved_row, moved_column, measured[inside]) - fit(row, column, measured)
