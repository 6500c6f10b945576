"""A drive of KITTI raw data (Geiger et al. 2013), its scans projected into the camera."""

import os
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from runtime.checks import shown
from runtime.errors import InputError
from runtime.io.calibration import RAW_CAMERAS, RAW_SCANNER, Calibration, find_raw_calibration
from runtime.io.images import RGB_SUFFIXES, list_files
from runtime.read_input import read_text
from runtime.sources.folders import FolderSource
from runtime.sources.source import ListedFrame, by_number, up_to
from runtime.sync.outcome import Sensor
from runtime.sync.stamp import DEFAULT_MAX_SKEW_MS
from runtime.sync.stamp_matching import match_by_stamp

_SCANS = (".bin",)


class KittiRawSource(FolderSource):
    """``image_0<camera>/data/*.png`` and ``velodyne_points/data/*.bin`` of a drive.

    Images and scans are matched by the time stamps in timestamps.txt, or by their numbers where a
    sensor has no such file. An image without a scan is a frame of the camera alone; a scan without
    an image is left out.

    Args:
        drive: folder like 2011_09_26_drive_0001_sync.
        camera: 2 = left, 3 = right; 0 and 1 are grey.
        calibration: as `Calibration.from_file`; None: KITTI's files in the drive's folder or the
            one above.
        max_skew_ms: largest difference of the time stamps of an image and its scan; None: match by
            number.

    Raises:
        InputError: if a folder, the calibration or a time stamp is missing or damaged.
    """

    accepted = "a drive of KITTI raw data (holds velodyne_points/data/)"
    options = ("camera", "calibration", "max_skew_ms")
    camera_alone = True
    calibration: Calibration

    def __init__(
        self,
        drive: Path,
        *,
        camera: int = 2,
        calibration: Path | None = None,
        max_skew_ms: float | None = DEFAULT_MAX_SKEW_MS,
    ) -> None:
        images, scans = drive / f"image_{camera:02d}", drive / "velodyne_points"
        for folder in (images / "data", scans / "data"):
            if not os.path.isdir(folder):
                raise InputError(
                    f"{drive} is not a drive of KITTI raw data: {folder} is missing; give a folder "
                    "like 2011_09_26/2011_09_26_drive_0001_sync, or another --camera"
                )
        if calibration is None:
            calibration = find_raw_calibration(drive)
            if calibration is None:
                raise InputError(
                    f"neither {drive} nor {Path(os.path.realpath(drive)).parent} has KITTI's "
                    f"{RAW_CAMERAS} and {RAW_SCANNER}: copy the calibration files of that day "
                    "there, or give --calibration"
                )
        super().__init__(images / "data", points=scans / "data", calibration=calibration)
        self._drive, self._camera = drive, camera
        self._stamped: list[tuple[Sensor, int, Path]] = []
        if max_skew_ms is not None:
            pictures = _read_stamps(Sensor.IMAGE, images, RGB_SUFFIXES)
            returns = _read_stamps(Sensor.DEPTH, scans, _SCANS)
            if pictures and returns:
                self._stamped = sorted(pictures + returns, key=lambda message: message[1])
        self._max_skew_ms = max_skew_ms if self._stamped else None

    @staticmethod
    def accepts(path: Path) -> bool:
        """See `Source.accepts`."""
        return os.path.isdir(path / "velodyne_points" / "data")

    def list_frames(self, *, limit: int | None = None) -> tuple[ListedFrame, ...]:
        """See `Source.list_frames`."""
        if self._max_skew_ms is None:
            return super().list_frames(limit=limit)
        self._left_out.clear()
        return up_to(self._match(self._max_skew_ms), limit)

    def _list_depths(self, folder: Path) -> dict[str, Path]:
        return list_files(folder, _SCANS)

    def _match(self, max_skew_ms: float) -> Iterator[ListedFrame]:
        pairs = match_by_stamp(self._stamped, max_skew_ms=max_skew_ms, left_out=self._left_out)
        for sequence, pair in enumerate(pairs):
            yield ListedFrame.of_pair(sequence, pair.image.data.stem, pair)

    @property
    def inputs(self) -> dict[str, Any]:
        """See `Source.inputs`."""
        return {
            "drive": str(self._drive),
            "camera": self._camera,
            "calibration": str(self._calibration),
            "max_skew_ms": self._max_skew_ms,
            "left_out": dict(self._left_out),
        }


def _read_stamps(
    sensor: Sensor, folder: Path, suffixes: tuple[str, ...]
) -> list[tuple[Sensor, int, Path]]:
    """(sensor, nanoseconds, path) of each number: its line of timestamps.txt, from 0.

    Empty without the file. Raises InputError for a line that is no time, and for a number without
    one.
    """
    numbers = by_number(list_files(folder / "data", suffixes))
    path = folder / "timestamps.txt"
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
        (sensor, _nanoseconds(lines[number], f"line {number + 1} of {path}"), file)
        for number, file in numbers.items()
    ]


def _nanoseconds(text: str, where: str) -> int:
    """Nanoseconds since 1970 of "2011-09-26 13:02:25.964389445", taken as UTC."""
    whole, _, fraction = text.strip().partition(".")
    try:
        if not (fraction or "0").isdecimal():  # int() takes signs and underscores
            raise ValueError(fraction)
        seconds = datetime.strptime(whole, "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC).timestamp()
        return int(seconds) * 10**9 + int(fraction[:9].ljust(9, "0"))
    except ValueError as error:
        raise InputError(
            f"{where} is {shown(text)}, expected a time like 2011-09-26 13:02:25.964389445"
        ) from error
