"""A simulated LiDAR: scan lines of a sensor, or random returns, of dense depth."""

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

Depth = NDArray[np.float32]

# Elevations of the 64 beams of a Velodyne HDL-64E (deg, highest first): an upper block a third
# of a degree apart and a lower block half a degree apart (data sheet; Geiger et al. 2013).
HDL64_ELEVATIONS_DEG: NDArray[np.float64] = np.concatenate(
    [2.0 - np.arange(32) / 3.0, -8.83 - np.arange(32) / 2.0]
)

SENSOR_LINES = len(HDL64_ELEVATIONS_DEG)
# The line of a sensor with a single line.
_HORIZON_LINE = 8
# For the simulated LiDAR: the longest range [m], the standard deviations of a range [m] and of the
# tilt of a scan [degrees], and the angle between two firings of an HDL-64E at 10 Hz [degrees].
_RANGE_M, _NOISE_M, _TILT_DEG, _STEP_DEG = 85.0, 0.02, 0.4, 0.17
# Share of its returns that is lost at any range, and share that is also lost at the longest range;
# the latter grows with the square of the range.
_LOST_SHARE, _LOST_FAR_SHARE = 0.08, 0.35


def random_share(depth: Depth, share: float, rng: Generator) -> Depth:
    """Keep a random share of the measured pixels (the paper trains with 0.05).

    `depth` is float32 (H, W), metres, 0 = none, and `share` is 0 to 1. Returns float32 (H, W).
    """
    kept = rng.random(depth.shape) < share
    return np.where(kept, depth, np.float32(0))


def beam_elevations(lines: int) -> NDArray[np.float64]:
    """Return the elevation of every beam in rad, highest first.

    Fewer than 64 lines are a thinned HDL-64E; 128 lines have one more beam between every two, and
    one below.
    """
    if lines == 2 * SENSOR_LINES:
        last = 2 * HDL64_ELEVATIONS_DEG[-1] - HDL64_ELEVATIONS_DEG[-2]
        above = np.append(HDL64_ELEVATIONS_DEG, last)
        between = (above[:-1] + above[1:]) / 2
        degrees = np.stack([HDL64_ELEVATIONS_DEG, between], axis=1).ravel()
        return np.asarray(np.deg2rad(degrees))
    return np.deg2rad(HDL64_ELEVATIONS_DEG[is_kept(np.arange(SENSOR_LINES), lines)])


def is_kept(scan_line: NDArray[np.integer], lines: int) -> NDArray[np.bool_]:
    """Return whether a sensor with so many lines has each of these of the 64 lines.

    The lines are at equal distances over the field of view. Those of a sensor with fewer lines are
    a subset of those with more, and a single line is 0.7 degrees below the horizon.
    """
    return np.asarray((scan_line - _HORIZON_LINE) % (SENSOR_LINES // lines) == 0)


def scan_line_index(
    size: tuple[int, int],
    intrinsics: NDArray[np.float64],
    lines: int,
    *,
    pitch_deg: float = 0.0,
    phase: float = 0.0,
) -> NDArray[np.int16]:
    """Return the index of the beam that looks through each pixel, -1 if there is none.

    The LiDAR is at the camera's position, so a beam keeps its elevation angle, and its trace in the
    image is a slightly bent line: v = cy - fy tan(elevation) / cos(azimuth).

    Args:
        size: (height, width).
        intrinsics: (3, 3).
        lines: a divisor of 64, or 128.
        pitch_deg: tilt of the LiDAR, up is positive.
        phase: azimuth of the first firing, 0 to 1 of a step.

    Returns:
        int16 (H, W).
    """
    height, width = size
    fx, fy = intrinsics[0, 0], intrinsics[1, 1]
    cx, cy = intrinsics[0, 2], intrinsics[1, 2]
    step = np.deg2rad(_STEP_DEG)
    first = np.floor(np.arctan2(-cx, fx) / step)
    last = np.ceil(np.arctan2(width - cx, fx) / step)
    azimuth = (np.arange(first, last + 1) + phase) * step
    elevation = beam_elevations(lines) + np.deg2rad(pitch_deg)
    u = np.broadcast_to(cx + fx * np.tan(azimuth), (lines, len(azimuth)))
    v = cy - fy * np.tan(elevation)[:, None] / np.cos(azimuth)
    column, row = np.rint(u).astype(int), np.rint(v).astype(int)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    index = np.full(size, -1, dtype=np.int16)
    beam = np.broadcast_to(np.arange(lines)[:, None], inside.shape)
    index[row[inside], column[inside]] = beam[inside]
    return index


def scan_lines(depth: Depth, intrinsics: NDArray[np.float64], lines: int, rng: Generator) -> Depth:
    """Simulate a LiDAR with this number of lines, a divisor of 64 or 128, on dense depth.

    Ranges have noise, some returns are lost (more at larger distances), and the whole scan is
    tilted at random, so that lines do not fall on the same rows in every frame. At 375 x 1242 and
    64 lines about 4 % of the pixels have a return, as in KITTI.

    Args:
        depth: float32 (H, W), metres along the optical axis, 0 = no surface (sky gives no return).
        intrinsics: (3, 3).
        lines: number of lines.
        rng: source of random numbers.

    Returns:
        float32 (H, W), 0 = no return.
    """
    height, width = depth.shape
    pitch_deg = _TILT_DEG * float(rng.standard_normal())
    phase = float(rng.random())
    beam = scan_line_index((height, width), intrinsics, lines, pitch_deg=pitch_deg, phase=phase)
    row, column = np.nonzero((beam >= 0) & (depth > 0))
    x = (column - intrinsics[0, 2]) / intrinsics[0, 0]
    y = (row - intrinsics[1, 2]) / intrinsics[1, 1]
    ray_length = np.sqrt(x * x + y * y + 1.0)
    distance = depth[row, column].astype(np.float64) * ray_length
    lost = _LOST_SHARE + _LOST_FAR_SHARE * np.square(distance / _RANGE_M)
    returned = (rng.random(len(row)) >= lost) & (distance <= _RANGE_M)
    measured = distance + _NOISE_M * rng.standard_normal(len(row))
    keep = returned & (measured > 0)
    sparse = np.zeros_like(depth, dtype=np.float32)
    sparse[row[keep], column[keep]] = (measured / ray_length)[keep]
    return sparse
