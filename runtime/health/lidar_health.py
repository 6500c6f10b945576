"""A LiDAR of which a part is gone: a sector behind dirt, lines whose lasers have failed.

What a LiDAR gives depends on its make and its mounting, so each stream is compared with itself: the
returns in 16 columns and 8 rows of cells over the picture with their running means over the frames
that were found whole. A street changes them less than a failure does: none of 60 frames of KITTI's
drive 2011_09_26 is flagged. What is missing from the first frame on is not found.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

LIDAR_SECTOR_LOST = "lidar_sector_lost"
LIDAR_LINES_LOST = "lidar_lines_lost"

_COLUMNS, _ROWS = 16, 8
_LEARNED_FROM = 5  # frames before anything is said
_MEMORY = 0.1  # weight of a new frame in the running mean
_LEAST_RETURNS = 30  # of a cell's mean, to be looked at
_LEAST_SHARE = 0.03  # of all returns, to be looked at
_CELL_LOST = 0.25  # of its mean
_TOTAL_LOST = 0.7  # of all returns: lines between the others are gone


class LidarHealth:
    """Looks at one sparse depth map of a LiDAR after the other."""

    def __init__(self) -> None:
        self._means: list[NDArray[np.float64]] | None = None
        self._frames = 0

    def check(self, sparse_depth: NDArray[np.float32]) -> tuple[str, ...]:
        """Return what is wrong with float32 (H, W) [m], 0 = no return; () if nothing.

        A map without any return is not looked at: `Prediction.degraded` tells of it.
        """
        mask = ((sparse_depth > 0) & (sparse_depth < np.inf)).view(np.uint8)
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
    """Sum counts a row or column over `cells` parts of about the same width."""
    edges = np.arange(cells) * len(counts) // cells
    return np.add.reduceat(counts, edges).astype(np.float64)


def _lost(now: NDArray[np.float64], mean: NDArray[np.float64]) -> bool:
    looked_at = (mean >= _LEAST_RETURNS) & (mean >= _LEAST_SHARE * mean.sum())
    return bool((looked_at & (now < _CELL_LOST * mean)).any())
