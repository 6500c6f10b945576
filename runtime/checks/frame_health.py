"""Checks of the sensor data of a frame, compared with the frames before it.

Image: frozen, black, overexposed. LiDAR: missing, empty, frozen, a lost sector (dirt), lost scan
lines (failed lasers). The usual returns depend on the LiDAR and its mounting, so a stream is
compared with itself. The returns in 16 columns and 8 rows of the image are compared with their
running means over the frames without a fault, and with their usual deviation from these means,
which is large for a LiDAR with a different pattern in every scan. Scenes change the returns less
than a failure: none of 60 frames of KITTI's drive 2011_09_26 is flagged. A part that is missing
from the first frame on is not detected.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.base.arrays import Bools, Float32, Float64, UInt8
from runtime.contract.contract import MAX_RETURN_M, farthest_return
from runtime.contract.degraded import DEGRADED, IMAGE_OVEREXPOSED
from runtime.engine.image_quality import find_measured_doubts

# Each fault with its meaning.
SENSOR_FAULTS: dict[str, str] = {
    (IMAGE_FROZEN := "image_frozen"): "same bytes as the image before",
    (IMAGE_BLACK := "image_black"): "nearly all pixels are dark",
    IMAGE_OVEREXPOSED: DEGRADED[IMAGE_OVEREXPOSED],
    (LIDAR_MISSING := "lidar_missing"): "no scan or depth map for the image",
    (LIDAR_EMPTY := "lidar_empty"): "no return of the scan is in the image",
    (LIDAR_FROZEN := "lidar_frozen"): "the same scan again, though the image changed",
    (LIDAR_SECTOR_LOST := "lidar_sector_lost"): "a sector of the LiDAR is missing",
    (LIDAR_LINES_LOST := "lidar_lines_lost"): "scan lines of the LiDAR are missing",
}

_MOST_FIELDS = 32  # a wider array is a depth map, not points
_GLANCE = 16  # every 16th row is compared first
_STEP = 4  # every 4th row and column are checked for brightness
_DARK, _DARK_SHARE = 12, 0.99  # brightest channel, of 255

_COLUMNS, _ROWS = 16, 8
_LEARNED_FROM = 5  # frames to learn from before the first check
_MEMORY = 0.1  # weight of a new frame in the running mean
# A cell is checked if its mean has at least so many returns, and this share of all returns.
_LEAST_RETURNS, _LEAST_SHARE = 30, 0.03
_CELL_LOST = 0.25  # a cell below this share of its mean is lost
_TOTAL_LOST = 0.7  # the same for all returns: scan lines that are lost all over the image
_DEVIATIONS = 3.0  # a loss is below the mean by at least so many usual deviations

_FROZEN_SCANS = 3  # scans with the same points; a driver may send each scan twice on purpose
_THUMB = (64, 24)  # width and height of the images that are compared while a scan repeats
# Least mean change of their channels, of 255. A simulator that stands still repeats scans, too, but
# then its images change by noise alone.
_CHANGED = 2.0


class FrameHealth:
    """Check one frame of a stream after another. Not thread-safe.

    Args:
        has_lidar: whether the car has a LiDAR; False: this is assumed from the first frame with
            depth on.
    """

    def __init__(self, *, has_lidar: bool = False) -> None:
        self._has_lidar = has_lidar
        self._before: UInt8 | None = None
        # Returns in each column of cells, in each row of cells, and in all cells.
        self._usual = _Usual(), _Usual(), _Usual()
        self._learned = 0  # frames in the means
        self._scan: Float32 | None = None  # the last scan
        self._scans = 0  # number of scans that equal it
        self._first_image: UInt8 | None = None  # of the first of these scans

    def check(
        self,
        rgb: UInt8,
        sparse_depth: Float32,
        *,
        scan: Float32 | None = None,
        reused: bool = False,
        range_m: float = MAX_RETURN_M,
    ) -> tuple[str, ...]:
        """Return what is wrong with the sensors.

        Args:
            rgb: uint8 (H, W, 3); it is kept until the next frame and must not be written to.
            sparse_depth: float32 (H, W), metres, 0 = no return.
            scan: the LiDAR's message for this image: points, float32 (N, 3) or wider, or a depth
                map. It is kept like the image. None: there is no message.
            reused: whether the depth is that of an older image.
            range_m: depth range of the frame; farther depths than `farthest_return` are no returns.

        Returns:
            Some of `SENSOR_FAULTS`; () if nothing is wrong.
        """
        is_return = (sparse_depth > 0) & (sparse_depth <= farthest_return(range_m))
        faults = self._image_faults(rgb)
        self._has_lidar |= scan is not None
        if scan is not None:
            if not is_return.any():
                faults.append(LIDAR_EMPTY)
                self._scan = None
            elif self._repeats(scan, rgb):
                faults.append(LIDAR_FROZEN)
        elif self._has_lidar and not reused:
            faults.append(LIDAR_MISSING)
        self._before = rgb
        return (*faults, *self._lidar_faults(is_return))

    def _repeats(self, scan: Float32, rgb: UInt8) -> bool:
        """Whether the LiDAR sends the same scan again and again while the image changes."""
        last, self._scan = self._scan, scan
        # Further columns of the points, such as times, may differ.
        width = 3 if scan.ndim == 2 and scan.shape[1] < _MOST_FIELDS else None
        if not scan.size or not _is_same(last, scan, width):
            self._scans, self._first_image = 1, None
            return False
        self._scans += 1
        if self._first_image is None and self._before is not None:
            self._first_image = _thumb(self._before)
        if self._scans < _FROZEN_SCANS or self._first_image is None:
            return False
        return float(cv2.absdiff(_thumb(rgb), self._first_image).mean()) >= _CHANGED

    def _image_faults(self, rgb: UInt8) -> list[str]:
        faults = [IMAGE_FROZEN] if _is_same(self._before, rgb) else []
        red, green, blue = np.moveaxis(rgb[::_STEP, ::_STEP], 2, 0)
        if np.mean(np.maximum(np.maximum(red, green), blue) <= _DARK) >= _DARK_SHARE:
            faults.append(IMAGE_BLACK)
        if IMAGE_OVEREXPOSED in find_measured_doubts(rgb):
            faults.append(IMAGE_OVEREXPOSED)
        return faults

    def _lidar_faults(self, is_return: Bools) -> list[str]:
        mask = is_return.view(np.uint8)
        columns = _cells(cv2.reduce(mask, 0, cv2.REDUCE_SUM, dtype=cv2.CV_32S), _COLUMNS)
        rows = _cells(cv2.reduce(mask, 1, cv2.REDUCE_SUM, dtype=cv2.CV_32S), _ROWS)
        counts = columns, rows, columns.sum(keepdims=True)
        if not columns.any():
            return []
        if self._learned >= _LEARNED_FROM:
            shares = _CELL_LOST, _CELL_LOST, _TOTAL_LOST
            lost = map(_Usual.lost, self._usual, counts, shares)
            is_column_lost, is_row_lost, is_total_lost = lost
            if is_column_lost and not is_row_lost:
                return [LIDAR_SECTOR_LOST]
            if is_row_lost or is_total_lost:
                return [LIDAR_LINES_LOST]
        self._learned += 1
        for usual, each in zip(self._usual, counts, strict=True):
            usual.learn(each, max(_MEMORY, 1 / self._learned))
        return []


class _Usual:
    """Running means of counts, and the mean squared distances of the counts from them."""

    def __init__(self) -> None:
        self._mean: Float64 | float = 0.0
        self._square: Float64 | float = 0.0

    def learn(self, counts: Float64, weight: float) -> None:
        """Learn from the counts of a frame without a fault."""
        apart = counts - self._mean
        self._mean = self._mean + weight * apart
        if weight < 1:
            self._square = (1 - weight) * (self._square + weight * apart**2)

    def lost(self, now: Float64, share: float) -> bool:
        """Whether a usually high count is below this share, and unusually far from its mean."""
        mean = np.asarray(self._mean)
        checked = (mean >= _LEAST_RETURNS) & (mean >= _LEAST_SHARE * mean.sum())
        below = mean - now > _DEVIATIONS * np.sqrt(self._square)
        return bool((checked & below & (now < share * mean)).any())


def _is_same(last: NDArray[Any] | None, now: NDArray[Any], width: int | None = None) -> bool:
    """Whether a message has the numbers of the one before it, in the first columns."""
    return (
        last is not None
        and last.shape == now.shape
        and np.array_equal(last[::_GLANCE, :width], now[::_GLANCE, :width])
        and np.array_equal(last[:, :width], now[:, :width])
    )


def _thumb(rgb: UInt8) -> UInt8:
    return np.asarray(cv2.resize(rgb, _THUMB, interpolation=cv2.INTER_AREA), np.uint8)


def _cells(counts: NDArray[Any], cells: int) -> Float64:
    """Sum the counts of rows or columns in `cells` parts of about the same width."""
    edges = np.arange(cells) * counts.size // cells
    return np.add.reduceat(counts.ravel(), edges).astype(np.float64)
