"""The images, depth maps and intrinsics of a variant of a Virtual KITTI 2 scene."""

import os
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from runtime.checks import shown
from runtime.errors import InputError
from runtime.io.calibration import Calibration
from runtime.io.images import DEPTH_SUFFIXES, list_files, read_sparse_depth
from runtime.read_input import read_text
from runtime.sources.source import ListedFrame, pair_up

_UNITS_A_METRE = 100.0
_SKY_M = np.float32(65535) / np.float32(_UNITS_A_METRE)


class VirtualKittiVariant:
    """``frames/rgb/Camera_<n>/rgb_*.jpg``, ``frames/depth/Camera_<n>/depth_*.png``, intrinsic.txt.

    Args:
        variant: folder like Scene01/clone.
        camera: 0 = left, 1 = right.

    Attributes:
        calibrations: frame number -> calibration.

    Raises:
        InputError: if a folder or intrinsic.txt is missing, or intrinsic.txt is damaged.
    """

    def __init__(self, variant: Path, *, camera: int = 0) -> None:
        self._folders = [
            variant / "frames" / kind / f"Camera_{camera}" for kind in ("rgb", "depth")
        ]
        for folder in self._folders:
            if not os.path.isdir(folder):
                raise InputError(
                    f"{variant} is not a variant of a Virtual KITTI 2 scene: {folder} is missing"
                )
        intrinsics = variant / "intrinsic.txt"
        if not os.path.lexists(intrinsics):
            raise InputError(f"{intrinsics}: missing")
        self.calibrations = _read_calibrations(intrinsics, camera)

    def list_frames(self) -> tuple[ListedFrame, ...]:
        """List the numbers in order; one without a partner is listed, too."""
        rgb, depth = self._folders
        images = _by_number(list_files(rgb), "rgb_")
        maps = _by_number(list_files(depth, DEPTH_SUFFIXES), "depth_")
        if not images.keys() & maps.keys():
            raise InputError(f"no number occurs both as rgb_* in {rgb} and as depth_* in {depth}")
        return pair_up(sorted(images.keys() | maps.keys()), images, maps, limit=None)


def read_depth(path: Path) -> NDArray[np.float32]:
    """Read a depth map of Virtual KITTI: float32 (H, W) [m], 0 for the sky. Raises InputError."""
    depth = read_sparse_depth(path, depth_scale=_UNITS_A_METRE)
    return np.where(depth < _SKY_M, depth, np.float32(0))


def _by_number(paths: dict[str, Path], prefix: str) -> dict[str, Path]:
    """Files whose stem is the prefix and a number, by that number as it is written."""
    found = {stem: re.fullmatch(f"{prefix}([0-9]+)", stem) for stem in paths}
    return {match[1]: paths[stem] for stem, match in found.items() if match is not None}


def _read_calibrations(path: Path, camera: int) -> dict[int, Calibration]:
    """A camera's calibration of each frame, from rows 'frame cameraID fx fy cx cy' under a header.

    Equal ones are one object, and their depth is the camera's own. Raises InputError for rows of
    another form and for a file without a row of the camera.
    """
    rows = [line.split() for line in read_text(path).splitlines()[1:]]
    made: dict[tuple[float, ...], Calibration] = {}
    calibrations: dict[int, Calibration] = {}
    for row in filter(None, rows):
        try:
            number, row_camera = int(row[0]), int(row[1])
            fx, fy, cx, cy = numbers = tuple(float(text) for text in row[2:])
        except (IndexError, ValueError) as error:
            raise InputError(
                f"{path}: {shown(' '.join(row))} is not 'frame cameraID fx fy cx cy': "
                "restore the file"
            ) from error
        if row_camera == camera:
            if numbers not in made:
                intrinsics = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)
                made[numbers] = Calibration(intrinsics, np.eye(4))
            calibrations[number] = made[numbers]
    if not calibrations:
        raise InputError(
            f"{path} has no row 'frame cameraID fx fy cx cy' of camera {camera}: restore the file"
        )
    return calibrations
