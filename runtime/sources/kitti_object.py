"""Frames in the layout of KITTI's object data (Geiger et al. 2012), which View-of-Delft shares."""

import os
from pathlib import Path

from runtime.errors import InputError
from runtime.sources.folders import FolderSource


class KittiObjectSource(FolderSource):
    """``image_<camera>/ID.png``, ``velodyne/ID.bin`` and ``calib/ID.txt``.

    Each frame has a calibration of its own. An image without a scan is a frame of the camera alone;
    a scan without an image is left out. Everything else in the folder is ignored.

    Args:
        path: folder like training.
        camera: 2 = left, 3 = right.
        points: folder of the scans; None: velodyne.
        point_columns: numbers per point of .bin scans; None: as `read_scan`.
        calibration: see `FolderSource`; None: calib.

    Raises:
        InputError: if the images are missing, and if a calibration cannot be read.
    """

    accepted = "KITTI's object layout (holds image_2/, velodyne/ and calib/)"
    options = ("camera", "points", "point_columns", "calibration")
    camera_alone = True

    def __init__(
        self,
        path: Path,
        *,
        camera: int = 2,
        points: Path | None = None,
        point_columns: int | None = None,
        calibration: Path | None = None,
    ) -> None:
        images = path / f"image_{camera}"
        if not os.path.isdir(images):
            raise InputError(
                f"{path} is not in KITTI's object layout: {images} is missing; give a folder like "
                "training, or another camera= in --source"
            )
        scans = path / "velodyne"
        super().__init__(
            images,
            points=points or (scans if os.path.isdir(scans) else None),
            point_columns=point_columns,
            calibration=calibration or path / "calib",
            camera=camera,
        )
        if self._depth is None:
            self._note("no velodyne folder, so only the camera is used; --points names the scans")

    @staticmethod
    def accepts(path: Path) -> bool:
        """See `Source.accepts`."""
        return os.path.isdir(path / "image_2") and os.path.isdir(path / "calib")
