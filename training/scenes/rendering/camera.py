"""Pinhole cameras of driving recordings."""

from dataclasses import dataclass

import numpy as np

from training.scenes.arrays import Floats
from training.scenes.names import CameraName

# Sizes (height, width) of varied cameras.
_SIZES = ((375, 1242), (375, 1242), (480, 960), (400, 720), (360, 480))


@dataclass(frozen=True)
class Camera:
    """A pinhole camera fixed to the ego car, its principal point in pixels.

    `mount_height_m` is its height above the road; for `pitch_deg`, its tilt, up is positive.
    """

    size: tuple[int, int]
    focal_px: float
    cx: float
    cy: float
    mount_height_m: float
    pitch_deg: float = 0.0

    @property
    def intrinsics(self) -> Floats:
        """Camera matrix K (3, 3)."""
        return np.array([[self.focal_px, 0, self.cx], [0, self.focal_px, self.cy], [0, 0, 1]])

    def rays(self, columns: Floats, rows: Floats) -> Floats:
        """Directions (..., 3) in the camera frame (x right, y down, z = 1) through pixels."""
        x, y = (columns - self.cx) / self.focal_px, (rows - self.cy) / self.focal_px
        return np.stack([x, y, np.ones_like(x)], axis=-1).astype(np.float32)


def make_camera(name: CameraName, size: tuple[int, int], seed: int = 0) -> Camera:
    """Make a camera with KITTI's field of view, at any (height, width).

    "varied" is a random camera for every seed. Its field of view is 45 to 105 degrees, it is 1.2 to
    2.2 m above the road and tilted by up to 4 degrees, and its size is one of `_SIZES`, whatever
    `size` is.
    """
    if name == CameraName.kitti:
        # KITTI 2011_09_26, camera 2: 1242 x 375 pixels, focal length 721.54.
        scale = size[1] / 1242.0
        return Camera(size, 721.54 * scale, 609.56 * scale, size[0] * 172.85 / 375.0, 1.65)
    rng = np.random.default_rng([seed, 5])
    height, width = _SIZES[rng.integers(len(_SIZES))]
    view = np.deg2rad(rng.uniform(45.0, 105.0 if width > 2 * height else 85.0))
    focal = width / 2 / np.tan(view / 2)
    cx, cy = width * rng.uniform(0.48, 0.52), height * rng.uniform(0.44, 0.56)
    above_road_m, pitch_deg = rng.uniform(1.2, 2.2), rng.uniform(-4.0, 2.0)
    return Camera((height, width), focal, cx, cy, above_road_m, pitch_deg)


def look_along(heading: float, pitch: float, roll: float) -> Floats:
    """Return the rotation (3, 3) from camera (x right, y down, z forward) to world (x, y, z up).

    All angles are in rad.
    """
    flat = np.cos(pitch)
    forward = np.array([np.cos(heading) * flat, np.sin(heading) * flat, np.sin(pitch)])
    right = np.array([np.sin(heading), -np.cos(heading), 0.0])
    down = np.cross(forward, right)
    c, s = np.cos(roll), np.sin(roll)
    return np.stack([c * right + s * down, -s * right + c * down, forward], axis=1)
