"""Checks of the sensors' data of a frame, against the frames before it.

Image: frozen, black, overexposed. LiDAR: a lost sector (dirt), lost scan lines (failed lasers). The
usual returns depend on the LiDAR and its mounting, so a stream is compared with itself: the returns
in 16 columns and in 8 rows of the image, against their running means over the frames without a
fault. Scenes change them less than a failure: none of 60 frames of KITTI's drive 2011_09_26 is
flagged. A part that is missing from the first frame on is not detected.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.contract.contract import MAX_RETURN_M, farthest_return

IMAGE_FROZEN = "image_frozen"  # the same bytes as the image before
IMAGE_BLACK = "image_black"  # nearly every pixel is dark
IMAGE_OVEREXPOSED = "image_overexposed"  # half of the pixels are saturated
LIDAR_SECTOR_LOST = "lidar_sector_lost"
LIDAR_LINES_LOST = "lidar_lines_lost"

_GLANCE = 16  # every 16th row and column are compared first
_STEP = 4  # every 4th row and column are checked for brightness
_DARK, _DARK_SHARE = 12, 0.99  # brightest channel, of 255
_BRIGHT, _BRIGHT_SHARE = 250, 0.5  # darkest channel

_COLUMNS, _ROWS = 16, 8
_LEARNED_FROM = 5  # frames before the first check
_MEMORY = 0.1  # weight of a new frame in the running mean
# A cell is checked if its mean has so many returns, and this share of all.
_LEAST_RETURNS, _LEAST_SHARE = 30, 0.03
_CELL_LOST = 0.25  # share of its mean below which a cell is lost
_TOTAL_LOST = 0.7  # the same of all returns: scan lines that are lost all over the image


class FrameHealth:
    """Check one frame of a stream after another. Not thread-safe."""

    def __init__(self) -> None:
        self._before: NDArray[np.uint8] | None = None
        #: Running means of the returns in each column and in each row of cells.
        self._means = np.zeros(_COLUMNS), np.zeros(_ROWS)
        self._learned = 0  # frames in the means

    def check(
        self,
        rgb: NDArray[np.uint8],
        sparse_depth: NDArray[np.float32],
        *,
        range_m: float = MAX_RETURN_M,
    ) -> tuple[str, ...]:
        """Return what is wrong with the sensors.

        Args:
            rgb: uint8 (H, W, 3); it is kept until the next frame and must not be written to.
            sparse_depth: float32 (H, W), metres, 0 = no return. A map without any return is not
                checked: `Prediction.degraded` reports it.
            range_m: depth range of the frame; farther depths than `farthest_return` are no returns.

        Returns:
            Of "image_frozen", "image_black", "image_overexposed", "lidar_sector_lost" and
            "lidar_lines_lost"; () if nothing is wrong.
        """
        is_return = (sparse_depth > 0) & (sparse_depth <= farthest_return(range_m))
        return (*self._image_faults(rgb), *self._lidar_faults(is_return))

    def _image_faults(self, rgb: NDArray[np.uint8]) -> list[str]:
        before, self._before = self._before, rgb
        found = []
        if (
            before is not None
            and np.array_equal(before[::_GLANCE, ::_GLANCE], rgb[::_GLANCE, ::_GLANCE])
            and np.array_equal(before, rgb)
        ):
            found.append(IMAGE_FROZEN)
        red, green, blue = np.moveaxis(rgb[::_STEP, ::_STEP], 2, 0)
        if np.mean(np.maximum(np.maximum(red, green), blue) <= _DARK) >= _DARK_SHARE:
            found.append(IMAGE_BLACK)
        if np.mean(np.minimum(np.minimum(red, green), blue) >= _BRIGHT) >= _BRIGHT_SHARE:
            found.append(IMAGE_OVEREXPOSED)
        return found

    def _lidar_faults(self, is_return: NDArray[np.bool_]) -> list[str]:
        mask = is_return.view(np.uint8)
        columns = _cells(cv2.reduce(mask, 0, cv2.REDUCE_SUM, dtype=cv2.CV_32S), _COLUMNS)
        rows = _cells(cv2.reduce(mask, 1, cv2.REDUCE_SUM, dtype=cv2.CV_32S), _ROWS)
        total, mean_columns, mean_rows = columns.sum(), *self._means
        if total == 0:
            return []
        if self._learned >= _LEARNED_FROM:
            row_lost = _any_lost(rows, mean_rows)
            if _any_lost(columns, mean_columns) and not row_lost:
                return [LIDAR_SECTOR_LOST]
            if row_lost or total < _TOTAL_LOST * mean_columns.sum():
                return [LIDAR_LINES_LOST]
        self._learned += 1
        weight = max(_MEMORY, 1 / self._learned)
        mean_columns += weight * (columns - mean_columns)
        mean_rows += weight * (rows - mean_rows)
        return []


def _cells(counts: NDArray[Any], cells: int) -> NDArray[np.float64]:
    """Sum the counts of rows or columns over `cells` parts of about the same width."""
    edges = np.arange(cells) * counts.size // cells
    return np.add.reduceat(counts.ravel(), edges).astype(np.float64)


def _any_lost(now: NDArray[np.float64], mean: NDArray[np.float64]) -> bool:
    checked = (mean >= _LEAST_RETURNS) & (mean >= _LEAST_SHARE * mean.sum())
    return bool((checked & (now < _CELL_LOST * mean)).any())
