"""KITTI's calibration files (Geiger et al. 2013): matrices by name, and their product."""

import contextlib
from pathlib import Path

import numpy as np

from runtime.base.arrays import Float64, Floats, Size
from runtime.base.errors import InputError
from runtime.files.read_input import read_text
from runtime.geometry.projection import split_projection
from runtime.geometry.rigid import finite_matrix

# Names by which a file of object or odometry data is recognised; it has at least one of them.
_NAMES = ("P0", "P1", "P2", "P3", "R0_rect", "Tr_velo_to_cam", "Tr")


# (height, width) of the images of KITTI's rectified cameras for each fx, cx and cy [px], by the
# day of recording; object and odometry files do not state the size.
_SIZES = {
    (721.5377, 609.5593, 172.854): (375, 1242),  # 2011_09_26
    (707.0493, 604.0814, 180.5066): (370, 1224),  # 2011_09_28
    (718.3351, 600.3891, 181.5122): (374, 1238),  # 2011_09_29
    (707.0912, 601.8873, 183.1104): (370, 1226),  # 2011_09_30
    (718.856, 607.1928, 185.2157): (376, 1241),  # 2011_10_03
}
_SAME_PX = 0.1


def kitti_image_size(intrinsics: Floats) -> Size | None:
    """The (height, width) of KITTI's images with these intrinsics; None for any other camera."""
    numbers = intrinsics[[0, 0, 1], [0, 2, 2]]
    same = (size for known, size in _SIZES.items() if np.abs(numbers - known).max() < _SAME_PX)
    return next(same, None)


class NumbersFile:
    """A text file of `name: numbers` lines, or of numbers alone, which have the name "".

    Raises InputError if it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        lines = read_text(path).splitlines()
        lines = [line for line in lines if not line.lstrip().startswith("#")]
        entries = (line.partition(":") for line in lines)
        self._entries = {name.strip(): numbers for name, colon, numbers in entries if colon}
        if not self._entries and any(map(str.strip, lines)):
            self._entries = {"": " ".join(lines)}

    def __contains__(self, name: str) -> bool:
        return name in self._entries

    def matrix(self, name: str, rows: int, columns: int) -> Float64:
        """The numbers under a name, float64 (rows, columns).

        Raises InputError if they are missing or not finite, or if their count is wrong.
        """
        count = rows * columns
        if name not in self:
            raise InputError(
                f"{self.path} has no line '{name}:'; expected {count} numbers under it, it has "
                f"{', '.join(self._entries) or 'no lines'}"
            )
        return finite_matrix(f"{self.path}: '{name}'", self._entries[name].split(), rows, columns)

    @property
    def is_kitti(self) -> bool:
        """Whether the file has a name that KITTI uses, or consists of nine numbers."""
        with contextlib.suppress(InputError):
            return self.matrix("", 3, 3).size == 9
        return any(name in self for name in _NAMES)


def compose_matrices(
    projection: Float64, rectify: Float64, to_camera: Float64
) -> tuple[Float64, Float64]:
    """Return the camera's intrinsics (3, 3) and the extrinsics (4, 4) from the LiDAR to it.

    The arguments are P_rect (3, 4), R_rect (3, 3) and the LiDAR's R and T (3, 4). Raises InputError
    if the projection is not that of a rectified camera.
    """
    # The LiDAR is calibrated to the first camera.
    intrinsics, beside = split_projection(projection, "P of KITTI's calibration")
    rectified = np.eye(4)
    rectified[:3, :3] = rectify
    return intrinsics, beside @ rectified @ np.vstack([to_camera, np.eye(4)[3]])
