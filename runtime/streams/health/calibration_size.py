"""Detects a calibration that was made for images of another size, or before they were cut.

Such a calibration puts the principal point far from the middle of the image. Images that were cut
together with their calibration look the same. Therefore the calibration is reported only if the
returns, scaled or shifted for these images, fit the depth that the model predicts from the image
alone better than before.
"""

from collections import defaultdict
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from runtime.checks.log_depth import BANDS, correlations, log_depth
from runtime.contract.degraded import IMAGE_CONSTANT
from runtime.engine.prediction import Prediction
from runtime.geometry.calibration import Calibration
from runtime.geometry.returns import is_measured

# Offset of the principal point, as a share of the image's side. KITTI, PandaSet and View-of-Delft
# have at most 0.04.
_FAR = 0.08
_LEAST_RETURNS = 200
# Least gain in correlation, the median of up to five frames. KITTI and PandaSet at 0.5, 0.67, 0.8
# and 2 times the size of their calibration gain 0.18 to 1.1; images cut at the left or right gain
# -0.3 or less.
_LEAST_GAIN = 0.1

_Index = NDArray[np.intp]


class _Change(NamedTuple):
    """A possible correction: a scale, then a shift of the principal point [px]."""

    scale: float
    left: float
    up: float

    def advice(self, size: tuple[int, int], middle: tuple[float, float]) -> str:
        seems = f"its principal point ({middle[0]:.0f}, {middle[1]:.0f}) is far from the middle of "
        seems += f"the images of {size[0]} x {size[1]}, and the returns fit them better "
        if self.scale == 1:
            return (
                "the calibration seems to be for images before they were cut: "
                f"{seems}{self.left:.0f} px farther left and {self.up:.0f} px farther up. Subtract "
                "the columns and rows that were cut at the left and above from cx and cy, in a "
                "TOML file for --calibration"
            )
        return (
            f"the calibration seems to be for images of another size: {seems}at {self.scale:.2g} "
            "times its scale. Use images of the calibrated size, or multiply the first two rows of "
            "the intrinsics by the ratio of the image width to the calibrated width, about "
            f"{self.scale:.2g}, in a TOML file for --calibration"
        )


class CalibrationSize:
    """Compares the returns of the first frames of a stream with the camera-only prediction."""

    def __init__(self) -> None:
        # Gains of each correction that the calibration may need, and the advice that belongs to it.
        self._gains: dict[str, list[float]] = defaultdict(list)
        self._advice: dict[str, str] = {}

    def add(
        self,
        camera_only: Prediction | None,
        sparse_depth: NDArray[np.float32],
        calibration: Calibration | None,
    ) -> None:
        """Add a frame; it is ignored if there is nothing to compare.

        Args:
            camera_only: prediction from the image of the frame without any return; None if it was
                not needed, because no point of the scan fell into the image.
            sparse_depth: float32 (H, W), metres, projected with the calibration.
            calibration: calibration of the frame.
        """
        if calibration is None:
            return
        height, width = sparse_depth.shape
        middle_x, middle_y = calibration.intrinsics[:2, 2]
        if min(middle_x, middle_y) <= 0:
            return
        for name, change in _changes(middle_x, middle_y, sparse_depth.shape).items():
            if camera_only is not None:
                gain = _gain(camera_only, sparse_depth, change)
            else:  # with the given calibration no return falls into the image
                gain = 1.0 if middle_x > width else None
            if gain is not None:
                self._gains[name].append(gain)
                self._advice[name] = change.advice((height, width), (middle_x, middle_y))

    def finding(self) -> str | None:
        """Return the fault of the frames so far, and its remedy; None: nothing was found."""
        gains = {name: float(np.median(gains)) for name, gains in self._gains.items()}
        best = max(gains, key=lambda name: gains[name], default="")
        return self._advice[best] if best and gains[best] >= _LEAST_GAIN else None


def _changes(middle_x: float, middle_y: float, shape: tuple[int, ...]) -> dict[str, _Change]:
    """The changes that put the principal point into the middle of images of this shape, by name."""
    height, width = shape
    changes: dict[str, _Change] = {}
    if abs(middle_x / width - 0.5) >= _FAR:
        changes["scale"] = _Change(width / (2 * middle_x), 0, 0)
    cut_x, cut_y = max(2 * middle_x - width, 0), max(2 * middle_y - height, 0)
    if cut_y >= 2 * _FAR * height:  # cut at the top, like KITTI's images for depth completion
        changes["top"] = _Change(1, cut_x / 2, cut_y)
        changes["around"] = _Change(1, cut_x / 2, cut_y / 2)
    return changes


def _gain(
    camera_only: Prediction, sparse_depth: NDArray[np.float32], change: _Change
) -> float | None:
    """Correlation gained by moving the returns as the changed calibration does; None if unknown."""
    if camera_only.depth is None or not camera_only.valid:
        return None
    height, width = sparse_depth.shape
    row, column = np.nonzero(is_measured(sparse_depth))
    moved_row, moved_column = row * change.scale - change.up, column * change.scale - change.left
    inside = (moved_row > -0.5) & (moved_row < height - 0.5)
    inside &= (moved_column > -0.5) & (moved_column < width - 0.5)
    if np.count_nonzero(inside) < _LEAST_RETURNS or IMAGE_CONSTANT in camera_only.degraded:
        return None
    seen, measured = (log_depth(each) for each in (camera_only.depth, sparse_depth[row, column]))

    def fit(row: _Index, column: _Index, measured: NDArray[np.float32]) -> float:
        return sum(correlations(row * BANDS // height, measured, seen[row, column])) / 2

    row_to, column_to = (np.rint(p[inside]).astype(np.intp) for p in (moved_row, moved_column))
    return fit(row_to, column_to, measured[inside]) - fit(row, column, measured)
