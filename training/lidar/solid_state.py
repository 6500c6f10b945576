"""Solid-state LiDARs: a pattern in a limited field of view instead of scan lines."""

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from training.lidar.simulate import Depth, measure

Looked = NDArray[np.bool_]

# (low, high) of random parameters: sensors like Livox Mid and Avia, and like Innoviz and HAP.
_ROSETTE_RADIUS_DEG = (19.0, 38.0)
_ROSETTE_FIRINGS = (10_000, 30_000)  # a frame of 0.1 s
_FAST_TURNS, _SLOW_TURNS = (10.0, 14.0), (6.0, 9.0)  # of the two prisms, in a frame
_RASTER_WIDTH_DEG, _RASTER_HEIGHT_DEG = (60.0, 120.0), (15.0, 30.0)
_RASTER_STEP_DEG = (0.15, 0.4)
#: Standard deviation of the sensor's tilt.
_TILT_DEG = 1.0


def solid_state_scan(depth: Depth, intrinsics: NDArray[np.float64], rng: Generator) -> Depth:
    """Simulate a solid-state LiDAR at the camera's position on dense depth.

    One of the two patterns below, of a random sensor. depth: (H, W) float32 [m], 0 = no surface.
    intrinsics: (3, 3). Returns (H, W) float32, 0 = no return.
    """
    pattern = rosette if rng.random() < 0.5 else raster
    return measure(depth, pattern(depth.shape, intrinsics, rng), intrinsics, rng)


def rosette(size: tuple[int, ...], intrinsics: NDArray[np.float64], rng: Generator) -> Looked:
    """Pixels under the rosette that two prisms draw which turn against each other: bool (H, W).

    The angle from the axis is a sum of two circular motions (Risley prisms): the loops of each turn
    pass through the middle, so that it is covered most densely, in a round field of view.
    """
    radius = np.deg2rad(rng.uniform(*_ROSETTE_RADIUS_DEG))
    time = np.linspace(0, 2 * np.pi, int(rng.integers(*_ROSETTE_FIRINGS)), endpoint=False)
    fast = rng.uniform(*_FAST_TURNS) * time + rng.uniform(0, 2 * np.pi)
    slow = rng.uniform(*_SLOW_TURNS) * time + rng.uniform(0, 2 * np.pi)
    azimuth = radius / 2 * (np.cos(fast) + np.cos(slow))
    elevation = radius / 2 * (np.sin(fast) - np.sin(slow))
    return _looked_at(size, intrinsics, azimuth, elevation + _tilt(rng))


def raster(size: tuple[int, ...], intrinsics: NDArray[np.float64], rng: Generator) -> Looked:
    """Pixels under a dense, even grid of directions in a wide and low window: bool (H, W)."""
    width = np.deg2rad(rng.uniform(*_RASTER_WIDTH_DEG))
    height = np.deg2rad(rng.uniform(*_RASTER_HEIGHT_DEG))
    step = np.deg2rad(rng.uniform(*_RASTER_STEP_DEG))
    across = np.arange(-width / 2, width / 2, step)
    down = np.arange(-height / 2, height / 2, step) + _tilt(rng)
    azimuth, elevation = np.meshgrid(across, down)
    return _looked_at(size, intrinsics, azimuth.ravel(), elevation.ravel())


def _tilt(rng: Generator) -> float:
    return float(np.deg2rad(_TILT_DEG) * rng.standard_normal())


def _looked_at(
    size: tuple[int, ...],
    intrinsics: NDArray[np.float64],
    azimuth: NDArray[np.float64],
    elevation: NDArray[np.float64],
) -> Looked:
    """Pixels in directions [rad] right of and above the optical axis, all within 90 degrees."""
    height, width = size
    u = intrinsics[0, 2] + intrinsics[0, 0] * np.tan(azimuth)
    v = intrinsics[1, 2] - intrinsics[1, 1] * np.tan(elevation) / np.cos(azimuth)
    column, row = np.rint(u).astype(int), np.rint(v).astype(int)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    looked = np.zeros((height, width), dtype=np.bool_)
    looked[row[inside], column[inside]] = True
    return looked
