"""Scan lines of recorded LiDAR returns.

Most recordings have no denser ground truth. Depth is scored with some of the scan lines as input
and others as target, so every return gets its line before the projection.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.geometry.projection import project_with_rows

# Height of the bands of `elevation_bands`: about the distance of two lines [degrees].
_BAND_DEG = 0.5
# Steps back in azimuth smaller than this are jitter inside one line, not the next line [degrees].
_LINE_BREAK_DEG = 5.0


def scan_line_of(points: NDArray[np.float32]) -> NDArray[np.int16]:
    """Number the scan line of every return: int16 (N,), from 0 without gaps, top to bottom.

    `points`, float32 (N, 3) or wider, are in KITTI's own order: line after line, first the sensor's
    upper block of lasers and then its lower one, which overlap by a line or two; each line goes
    counter-clockwise from straight ahead. Cropping to the camera's view keeps that order, so a line
    ends where the azimuth (0..360 degrees) steps back. Elevation does not separate lines: within
    one line it varies by several line spacings, because the sensor is tilted. A line without a
    return in view gets no number.
    """
    azimuth = np.degrees(np.arctan2(points[:, 1], points[:, 0])) % 360.0
    line = np.zeros(len(points), dtype=np.int16)
    line[1:] = np.cumsum(np.diff(azimuth) < -_LINE_BREAK_DEG)
    return line


def elevation_bands(
    depth: NDArray[np.float32], intrinsics: NDArray[np.float64] | None
) -> NDArray[np.int16]:
    """Number bands of elevation, top to bottom, for scans whose points have no order.

    Args:
        depth: (H, W), 0 = no return.
        intrinsics: (3, 3); None: the focal length is the length of the larger side.

    Returns:
        int16 (H, W), from 0, -1 where there is no return.
    """
    height, width = depth.shape
    if intrinsics is None:
        side = float(max(height, width))
        intrinsics = np.array([[side, 0, width / 2], [0, side, height / 2], [0, 0, 1]])
    rows, columns = np.mgrid[:height, :width]
    across = (columns - intrinsics[0, 2]) / intrinsics[0, 0]
    down = (rows - intrinsics[1, 2]) / intrinsics[1, 1]
    band = np.degrees(np.arctan2(down, np.hypot(across, 1.0))) // _BAND_DEG
    return np.where(depth > 0, band - band.min(), -1).astype(np.int16)


def project_lines(
    points: NDArray[np.float32],
    intrinsics: NDArray[np.floating[Any]],
    extrinsics: NDArray[np.floating[Any]],
    size: tuple[int, int],
) -> tuple[NDArray[np.float32], NDArray[np.int16]]:
    """Project a scan with the scan line of every pixel.

    Args:
        points: see `scan_line_of`.
        intrinsics: see `runtime.project_points`.
        extrinsics: see `runtime.project_points`.
        size: see `runtime.project_points`.

    Returns:
        Depth, float32 (H, W) [m], 0 = none, and the line, int16 (H, W), -1 = none.

    Raises:
        InputError: in the cases of `runtime.project_points`.
    """
    depth, rows = project_with_rows(points, intrinsics, extrinsics, size)
    line = np.full(size, -1, dtype=np.int16)
    measured = rows >= 0
    line[measured] = scan_line_of(points)[rows[measured]]
    return depth, line
