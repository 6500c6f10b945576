"""A variant of a Virtual KITTI 2 scene (Cabon et al. 2020), also as `ssdnet-render` writes it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from runtime.errors import InputError
from runtime.io.calibration import Calibration
from runtime.io.images import list_pictures
from runtime.sources.folders import read_pair
from runtime.sources.frames import Frame
from runtime.sources.source import ListedFrame, Source, pair_up

_UNITS_A_METRE = 100.0
_SKY_M = np.float32(65535) / np.float32(_UNITS_A_METRE)


class VirtualKittiSource(Source):
    """``frames/rgb/Camera_<n>/rgb_*.jpg`` and ``frames/depth/Camera_<n>/depth_*.png`` [cm].

    variant: folder like Scene01/clone
    camera: 0 = left, 1 = right

    Depth is that of every pixel, 0 for the sky. Frames have no stamps. The focal length comes from
    intrinsic.txt, if that is there.
    """

    options = ("camera",)

    def __init__(self, variant: Path, *, camera: int = 0) -> None:
        self._variant, self._camera = variant, camera
        rgb, depth = (variant / "frames" / kind / f"Camera_{camera}" for kind in ("rgb", "depth"))
        for folder in (rgb, depth):
            if not folder.is_dir():
                raise InputError(
                    f"{variant} is no variant of a Virtual KITTI 2 scene, {folder} is missing: "
                    "give a folder like Scene01/clone, or another --camera"
                )
        self.folders = (rgb, depth)
        intrinsics = variant / "intrinsic.txt"
        if intrinsics.exists():
            self.calibration = _read_calibration(intrinsics, camera)

    def list_frames(self, *, limit: int | None = None) -> tuple[ListedFrame, ...]:
        """See `Source.list_frames`. A number without a partner is listed too."""
        rgb, depth = self.folders
        pictures = _by_number(list_pictures(rgb), "rgb_")
        maps = _by_number(list_pictures(depth, (".png",)), "depth_")
        if not pictures.keys() & maps.keys():
            raise InputError(f"no number occurs both as rgb_* in {rgb} and as depth_* in {depth}")
        return pair_up(sorted(pictures.keys() | maps.keys()), pictures, maps, limit=limit)

    def read(self, frame: ListedFrame) -> Frame:
        """See `Source.read`. Raises InputError also where one of the two files is missing."""
        read = read_pair(frame, depth_scale=_UNITS_A_METRE, calibration=self.calibration)
        depth = np.where(read.sparse_depth < _SKY_M, read.sparse_depth, np.float32(0))
        return replace(read, sparse_depth=depth)

    @property
    def inputs(self) -> dict[str, Any]:
        """See `Source.inputs`."""
        return {"variant": str(self._variant), "camera": self._camera}


def _by_number(paths: dict[str, Path], prefix: str) -> dict[str, Path]:
    return {
        stem.removeprefix(prefix): path for stem, path in paths.items() if stem.startswith(prefix)
    }


def _read_calibration(path: Path, camera: int) -> Calibration:
    """The camera's intrinsics of its first row 'frame cameraID fx fy cx cy'; depth is its own.

    Raises InputError for a file without such a row.
    """
    try:
        rows = [line.split() for line in path.read_text(encoding="utf-8").splitlines()]
        row = next(row for row in rows if len(row) == 6 and row[1] == str(camera))
        fx, fy, cx, cy = (float(number) for number in row[2:])
    except (OSError, ValueError, StopIteration) as error:  # UnicodeDecodeError is a ValueError
        raise InputError(
            f"{path} has no row 'frame cameraID fx fy cx cy' of camera {camera}: restore it, or "
            "remove it and give --focal-length"
        ) from error
    intrinsics = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)
    return Calibration(intrinsics, np.eye(4))
