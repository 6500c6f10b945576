"""KITTI raw data (Geiger et al. 2013): synced drives whose LiDAR is projected here."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from runtime.errors import DatasetError
from runtime.io.calibration import Calibration
from runtime.projection import OcclusionFilter
from training.datasets.class_mapping import ClassTable
from training.datasets.image_files import read_rgb, require_folder
from training.datasets.kitti_calibration import read_points, read_raw_calibration
from training.datasets.sample import IGNORE, Sample
from training.datasets.source import Names, SourceRecipe
from training.datasets.virtual_kitti import require_partners
from training.lidar.scan import project_lines
from training.limits import STRICT

#: Images that were published without their scans.
_WITHOUT_SCAN: Mapping[str, frozenset[str]] = {
    "2011_09_26_drive_0009_sync": frozenset(f"{number:010d}" for number in range(177, 181))
}


@dataclass(frozen=True, kw_only=True, config=STRICT)
class KittiRawRecipe(SourceRecipe):
    """What a recipe says about KITTI raw data."""

    kind: Literal["kitti_raw"] = "kitti_raw"
    #: All by default.
    drives: Names | None = None
    #: 2 = left, 3 = right.
    cameras: Annotated[tuple[Literal[2, 3], ...], Field(min_length=1, max_length=2)] = (2,)
    #: Leave out the returns that the camera cannot see behind nearer ones.
    withhold_hidden: bool = False

    def open(self, folder: Path, classes: ClassTable) -> "KittiRaw":
        """See `SourceRecipe.open`; there are no classes."""
        return KittiRaw(
            folder,
            drives=self.drives,
            cameras=self.cameras,
            withhold_hidden=self.withhold_hidden,
        )


class KittiRaw:
    """Frames of ``root/<date>/<drive>/image_0<camera>/data/<number>.png`` with their scans.

    The scan of a frame is ``<drive>/velodyne_points/data/<number>.bin``, the calibration
    ``<date>/calib_cam_to_cam.txt`` and ``calib_velo_to_cam.txt``. ``drives`` names folders like
    "2011_09_26_drive_0001_sync"; all by default. ``cameras`` are 2 (left) and 3 (right).

    The depth is every return in view, the nearest where several fall into one pixel; ``scan_line``
    says which line measured it. With ``withhold_hidden`` the returns that the camera cannot see
    behind nearer ones are left out. No classes. Raises DatasetError for missing folders, frames
    without a scan, truncated scans, incomplete calibrations and images of another size than it.
    """

    def __init__(
        self,
        root: Path | str,
        *,
        drives: Sequence[str] | None = None,
        cameras: Sequence[int] = (2,),
        withhold_hidden: bool = False,
    ) -> None:
        root = require_folder(Path(root), "dates of KITTI raw data, each with its drives")
        self._withhold_hidden = withhold_hidden
        self._frames: list[tuple[Path, int, str]] = []
        self._calibrations: dict[tuple[Path, int], Calibration] = {}
        found = {path.name: path for path in sorted(root.glob("*/*_sync")) if path.is_dir()}
        unknown = sorted(set(drives or ()) - set(found))
        if unknown or not found:
            raise DatasetError(
                f"{root}: no drive {unknown[0] if unknown else '<date>/<date>_drive_*_sync'}; "
                f"found {len(found)} drives."
            )
        for name, drive in found.items():
            if drives is None or name in drives:
                for camera in cameras:
                    self._add(drive, camera)
        if not self._frames:
            raise DatasetError(f"{root}: its drives hold no images of cameras {list(cameras)}.")

    def _add(self, drive: Path, camera: int) -> None:
        images = require_folder(drive / f"image_{camera:02d}" / "data", "the drive's PNG images")
        scans = require_folder(drive / "velodyne_points" / "data", "the drive's .bin scans")
        without = _WITHOUT_SCAN.get(drive.name, frozenset())
        numbers = sorted({path.stem for path in images.glob("*.png")} - without)
        require_partners(scans, [f"{number}.bin" for number in numbers])
        self._calibrations[drive.parent, camera] = read_raw_calibration(drive.parent, camera)
        self._frames += [(drive, camera, number) for number in numbers]

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> Sample:
        drive, camera, number = self._frames[index]
        calibration = self._calibrations[drive.parent, camera]
        path = drive / f"image_{camera:02d}" / "data" / f"{number}.png"
        rgb = read_rgb(path)
        size = (rgb.shape[0], rgb.shape[1])
        expected = calibration.size or size
        if size != expected:
            raise DatasetError(
                f"{path}: its size {size[0]}x{size[1]} differs from the calibration's "
                f"{expected[0]}x{expected[1]} (height x width). Give the "
                "rectified (synced) images of this date."
            )
        points = read_points(drive / "velodyne_points" / "data" / f"{number}.bin")
        depth, scan_line = project_lines(
            points, calibration.intrinsics, calibration.extrinsics, size
        )
        sample = Sample(
            rgb=rgb,
            depth=depth,
            semantic=np.full(size, IGNORE, dtype=np.uint8),
            intrinsics=calibration.intrinsics,
            name=f"{drive.name}/{camera}/{number}",
            scan_line=scan_line,
        )
        if not self._withhold_hidden:
            return sample
        seen = OcclusionFilter().apply(depth, depth)
        lines = np.where(seen > 0, scan_line, np.int16(-1)).astype(np.int16)
        return replace(sample, depth=seen, scan_line=lines)
