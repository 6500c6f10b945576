"""Scan lines of recorded LiDAR returns.

Most recordings have no denser ground truth. Depth is scored with some of the scan lines as input
and others as target, so every return gets its line before the projection.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.projection import project_with_rows

#: Steps back in azimuth smaller than this are jitter inside one line, not the next line [degrees].
_LINE_BREAK_DEG = 5.0


def scan_line_of(points: NDArray[np.float32]) -> NDArray[np.int16]:
    """Number the scan line of every return: int16 (N,), from 0 without gaps, top to bottom.

    points: float32 (N, 3) or wider, in KITTI's own order: line after line, the sensor's upper block
    of lasers and then its lower one, which overlap by a line or two; each line counter-clockwise
    from straight ahead. Cropping to the camera's view keeps that order, so a line ends where the
    azimuth (0..360 degrees) steps back. Elevation does not separate lines: within one line it
    varies by several line spacings, because the sensor is tilted. A line without a return in view
    gets no number.
    """
    azimuth = np.degrees(np.arctan2(points[:, 1], points[:, 0])) % 360.0
    line = np.zeros(len(points), dtype=np.int16)
    line[1:] = np.cumsum(np.diff(azimuth) < -_LINE_BREAK_DEG)
    return line


def project_lines(
    points: NDArray[np.float32],
    intrinsics: NDArray[np.floating[Any]],
    extrinsics: NDArray[np.floating[Any]],
    size: tuple[int, int],
) -> tuple[NDArray[np.float32], NDArray[np.int16]]:
    """Project a scan with the scan line of every pixel.

    points: as in `scan_line_of`; the others as in `runtime.project_points`. Returns depth float32
    (H, W) [m], 0 = none, and the line int16 (H, W), -1 = none. InputError as in
    `runtime.project_points`.
    """
    depth, rows = project_with_rows(points, intrinsics, extrinsics, size)
    line = np.full(size, -1, dtype=np.int16)
    measured = rows >= 0
    line[measured] = scan_line_of(points)[rows[measured]]
    return depth, line
