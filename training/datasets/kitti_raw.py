"""KITTI raw data (Geiger et al. 2013): synced drives, whose scans are projected here."""

from collections.abc import Mapping
from itertools import chain
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from runtime.base.errors import DatasetError
from runtime.geometry.rig import Rig
from runtime.recordings.kitti_raw import KittiRawSource
from training.datasets.class_mapping import ClassTable
from training.datasets.files import dataset_errors, require_files
from training.datasets.recording import RecordedFrames, SetFrame, pair
from training.datasets.source_recipe import Names, SourceRecipe
from training.limits import STRICT

# Images that were published without their scans.
_WITHOUT_SCAN: Mapping[str, frozenset[str]] = {
    "2011_09_26_drive_0009_sync": frozenset(f"{number:010d}" for number in range(177, 181))
}


@dataclass(frozen=True, kw_only=True, config=STRICT)
class KittiRawRecipe(SourceRecipe):
    """Options of KITTI raw data in a recipe.

    Attributes:
        drives: names like "2011_09_26_drive_0001_sync"; None: all drives.
        cameras: numbers of the cameras: 2 = left, 3 = right.
    """

    kind: Literal["kitti-raw"] = "kitti-raw"
    drives: Names | None = None
    cameras: Annotated[tuple[Literal[2, 3], ...], Field(min_length=1, max_length=2)] = (2,)

    def open(self, folder: Path, classes: ClassTable) -> RecordedFrames:
        """Open `folder/<date>/<drive>/image_0<camera>/data/<number>.png` with their scans.

        The scan of a frame is `<drive>/velodyne_points/data/<number>.bin`, and the calibration is
        `<date>/calib_cam_to_cam.txt` and `calib_velo_to_cam.txt`. The depth is every return in
        view, with its scan line; of several returns in a pixel it is the nearest. There are no
        classes.

        Raises:
            DatasetError: if a folder or the scan of a frame is missing, or if a calibration is
                incomplete.
        """
        found = {path.name: path for path in sorted(folder.glob("*/*_sync")) if path.is_dir()}
        unknown = sorted(set(self.drives or ()) - set(found))
        if unknown or not found:
            raise DatasetError(
                f"{folder}: no drive {unknown[0] if unknown else '<date>/<date>_drive_*_sync'}; "
                f"found {len(found)} drives"
            )
        drives = [path for name, path in found.items() if name in (self.drives or found)]
        frames = (_frames_of(drive, camera) for drive in drives for camera in self.cameras)
        return RecordedFrames(chain.from_iterable(frames), "ordered")


@dataset_errors()
def _frames_of(drive: Path, camera: int) -> list[SetFrame]:
    source = KittiRawSource(drive, Rig(calibration=drive.parent), camera=camera, by_number=True)
    without = _WITHOUT_SCAN.get(drive.name, frozenset())
    frames = [frame for frame in source.list_frames() if frame.name not in without]
    scans, names = drive / "velodyne_points" / "data", [frame.name for frame in frames]
    require_files(scans, "scans", names, "{}.bin")
    return pair(source, frames, f"{drive.name}/{camera}", {})
