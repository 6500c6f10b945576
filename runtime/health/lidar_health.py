"""Checks of the LiDAR: a lost sector (dirt), lost scan lines (failed lasers).

The usual returns depend on the LiDAR and its mounting, so a stream is compared with itself: the
returns in 16 columns and in 8 rows of the image, against their running means over the frames
without a fault. Scenes change them less than a failure: none of 60 frames of KITTI's drive
2011_09_26 is flagged. A part that is missing from the first frame on is not detected.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.contract import MAX_RETURN_M, farthest_return

LIDAR_SECTOR_LOST = "lidar_sector_lost"
LIDAR_LINES_LOST = "lidar_lines_lost"

_COLUMNS, _ROWS = 16, 8
_LEARNED_FROM = 5  # frames before the first check
_MEMORY = 0.1  # weight of a new frame in the running mean
_LEAST_RETURNS = 30  # mean of a cell, to be checked
_LEAST_SHARE = 0.03  # of all returns in a cell, to be checked
_CELL_LOST = 0.25  # of the cell's mean
_TOTAL_LOST = 0.7  # of the mean of all returns: single scan lines are lost all over the image


class LidarHealth:
    """Checks one sparse depth map of a LiDAR after another."""

    def __init__(self) -> None:
        self._means: list[NDArray[np.float64]] | None = None
        self._frames = 0

    def check(
        self, sparse_depth: NDArray[np.float32], *, range_m: float = MAX_RETURN_M
    ) -> tuple[str, ...]:
        """Return what is wrong with a depth map; one without any return is not checked."""
        farthest_m = farthest_return(range_m)
        mask = ((sparse_depth > 0) & (sparse_depth <= farthest_m)).view(np.uint8)
        returns = [
            _cells(cv2.reduce(mask, 0, cv2.REDUCE_SUM, dtype=cv2.CV_32S).ravel(), _COLUMNS),
            _cells(cv2.reduce(mask, 1, cv2.REDUCE_SUM, dtype=cv2.CV_32S).ravel(), _ROWS),
        ]
        total = float(returns[0].sum())
        if total == 0:
            return ()
        found = []
        if self._means is not None and self._frames >= _LEARNED_FROM:
            columns, rows = (
                _lost(now, mean) for now, mean in zip(returns, self._means, strict=True)
            )
            thinned = total < _TOTAL_LOST * self._means[0].sum()
            if columns and not rows:
                found.append(LIDAR_SECTOR_LOST)
            elif rows or thinned:
                found.append(LIDAR_LINES_LOST)
        if not found:
            self._learn(returns)
        return tuple(found)

    def _learn(self, returns: list[NDArray[np.float64]]) -> None:
        self._frames += 1
        if self._means is None:
            self._means = returns
        else:
            weight = max(_MEMORY, 1 / self._frames)
            self._means = [
                mean + weight * (now - mean) for mean, now in zip(self._means, returns, strict=True)
            ]


def _cells(counts: NDArray[Any], cells: int) -> NDArray[np.float64]:
    """Sum the counts of rows or columns over `cells` parts of about the same width."""
    edges = np.arange(cells) * len(counts) // cells
    return np.add.reduceat(counts, edges).astype(np.float64)


def _lost(now: NDArray[np.float64], mean: NDArray[np.float64]) -> bool:
    checked = (mean >= _LEAST_RETURNS) & (mean >= _LEAST_SHARE * mean.sum())
    return bool((checked & (now < _CELL_LOST * mean)).any())
