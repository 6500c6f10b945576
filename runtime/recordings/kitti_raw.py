"""A drive of KITTI's raw data (Geiger et al. 2013), with its scans projected into the camera."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from runtime.base.errors import InputError
from runtime.base.stamp import parse_date
from runtime.files.read_input import read_text
from runtime.geometry.calibration import RAW_CAMERAS, RAW_SCANNER, Calibration, find_raw_calibration
from runtime.geometry.kitti_calibration import NumbersFile
from runtime.geometry.odometry import ODOMETRY
from runtime.geometry.rig import DEFAULT_RIG, Rig
from runtime.geometry.rigid import nearest_rigid
from runtime.recordings.folders import FolderSource
from runtime.recordings.images import RGB_SUFFIXES, list_files
from runtime.recordings.listing import ListedFrame
from runtime.recordings.poses import read_oxts_poses
from runtime.recordings.source import files_by_number, pose_track
from runtime.streams.messages import Place, Sensor

RAW_IMU = "calib_imu_to_velo.txt"
_SCANS = (".bin",)
_STAMPS = "timestamps.txt"


class KittiRawSource(FolderSource):
    """Images in `image_0<camera>/data/*.png` and scans in `velodyne_points/data/*.bin` of a drive.

    Images and scans are matched by the time stamps in timestamps.txt, or by their numbers if a
    sensor has no such file. An image without a scan takes an older scan or becomes a frame of the
    camera alone. A scan without an image is left out. If the drive has poses in `oxts/` and
    calib_imu_to_velo.txt, which places the IMU that they describe, scans are moved to the time of
    the image. The images of a drive whose name ends in _extract are not rectified and have the lens
    of the calibration.

    Args:
        drive: folder of the drive, such as 2011_09_26_drive_0001_sync.
        rig: without a calibration in it, KITTI's files in the drive's folder or in its parent are
            read. The time stamps of KITTI mark the middle of a scan.
        camera: 2 is the left and 3 the right colour camera; 0 and 1 are grey.
        poses: "odometry": they are found from the scans, and those of the drive are not used.

    Raises:
        InputError: if a folder, the calibration or a time stamp is missing or damaged, or if
            `poses` is a file.
    """

    accepted = "a drive of KITTI raw data (holds velodyne_points/data/)"
    options = ("camera", "poses")
    rig_options = ("calibration", "max_skew_ms", "reuse_depth_ms", "scan_stamp")
    camera_alone = True
    calibration: Calibration

    def __init__(
        self, drive: Path, rig: Rig = DEFAULT_RIG, *, camera: int = 2, poses: Path | None = None
    ) -> None:
        if poses not in (None, Path(ODOMETRY)):
            raise InputError(
                f"a drive holds its own poses, and `poses={ODOMETRY}` finds others: got {poses}"
            )
        images, scans = drive / f"image_{camera:02d}", drive / "velodyne_points"
        for folder in (images / "data", scans / "data"):
            if not os.path.isdir(folder):
                raise InputError(
                    f"{drive} is not a drive of KITTI raw data: {folder} is missing; give a folder "
                    "like 2011_09_26/2011_09_26_drive_0001_sync, or another `camera=`"
                )
        calibration = rig.calibration or find_raw_calibration(drive)
        if calibration is None:
            raise InputError(
                f"neither {drive} nor {Path(os.path.realpath(drive)).parent} has KITTI's "
                f"{RAW_CAMERAS} and {RAW_SCANNER} of that day: copy them, or give `calibration=`"
            )
        self._kitti_rectified = not os.path.realpath(drive).endswith("_extract")
        stamp = rig.scan_stamp or "middle"  # as KITTI documents it
        rig = replace(rig, calibration=calibration, scan_stamp=stamp)
        given = {"points": scans / "data", "camera": camera, "poses": poses}
        super().__init__(images / "data", replace(rig, reuse_depth_ms=None), **given)
        self._drive, self._rig = drive, rig
        self._oxts: Path | None = None  # folder of the poses, if they are used
        self._stamped: list[Place] = []
        pictures = _read_stamps(Sensor.IMAGE, images, RGB_SUFFIXES)
        returns = _read_stamps(Sensor.DEPTH, scans, _SCANS)
        if pictures and returns:
            self._stamped = sorted(pictures + returns, key=lambda place: place.stamp_ns)
        if self._is_odometry:
            self._note(f"poses by odometry: those of {drive / 'oxts'}, if any, are not used")
        elif self._stamped and not isinstance(calibration, Calibration):
            with self.collecting():
                self._read_oxts(drive / "oxts", Path(calibration) / RAW_IMU)

    @staticmethod
    def accepts(path: Path) -> bool:
        """See `Source.accepts`."""
        return os.path.isdir(path / "velodyne_points" / "data")

    def list_frames(self, *, limit: int | None = None) -> tuple[ListedFrame, ...]:
        """See `Source.list_frames`."""
        if not self._stamped:
            return super().list_frames(limit=limit)
        self.left_out.clear()
        return self._match(self._stamped, limit=limit, camera_only=False)

    def _read_oxts(self, folder: Path, mount: Path) -> None:
        """Read the poses of the car if there are any. Raises InputError if they are damaged."""
        missing = [each for each in (folder / "data", folder / _STAMPS, mount) if not each.exists()]
        if missing:
            self._note(f"no poses: {missing[0]} is missing")
            return
        numbers, lidar_from_body = NumbersFile(mount), np.eye(4)
        lidar_from_body[:3] = np.hstack([numbers.matrix("R", 3, 3), numbers.matrix("T", 3, 1)])
        lidar_from_body = nearest_rigid(str(mount), lidar_from_body)
        stamped = _read_stamps(Sensor.POSE, folder, (".txt",))
        stamped.sort(key=lambda each: each.stamp_ns)
        poses = read_oxts_poses(Path(str(each.at)) for each in stamped)
        self._poses = pose_track(zip((each.stamp_ns for each in stamped), poses, strict=True))
        self._oxts = folder
        body_from_lidar = np.asarray(np.linalg.inv(lidar_from_body), np.float64)
        self.calibration = replace(self.calibration, body_from_lidar=body_from_lidar)

    def _list_depths(self, folder: Path) -> dict[str, Path]:
        return list_files(folder, _SCANS)

    @property
    def inputs(self) -> dict[str, Any]:
        """See `Source.inputs`."""
        return super().inputs | {
            "drive": str(self._drive),
            "camera": self._given.camera,
            "max_skew_ms": self._rig.max_skew_ms if self._stamped else None,
            "reuse_depth_ms": self._rig.max_depth_age_ms,
            "poses": ODOMETRY if self._is_odometry else self._oxts and str(self._oxts),
        }


def _read_stamps(sensor: Sensor, folder: Path, suffixes: tuple[str, ...]) -> list[Place]:
    """The files with their times; a file's number is the line of its time, from 0.

    The list is empty if there is no file of time stamps. Raises InputError if a line is not a time,
    and if a file's number has no line.
    """
    numbers = files_by_number(list_files(folder / "data", suffixes))
    path = folder / _STAMPS
    if not os.path.lexists(path):
        return []
    lines = read_text(path).splitlines()
    last = max(numbers)
    if last >= len(lines):
        raise InputError(
            f"{path} has {len(lines)} lines, {numbers[last].name} is number {last}, counted from "
            "0: the file is truncated or of another drive"
        )
    return [
        Place(sensor, file, parse_date(lines[number], f"line {number + 1} of {path}"))
        for number, file in numbers.items()
    ]
