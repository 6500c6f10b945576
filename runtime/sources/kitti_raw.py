"""A drive of KITTI raw data (Geiger et al. 2013), its scans projected into the camera."""

import os
from collections import Counter
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from runtime.errors import InputError
from runtime.io.calibration import Calibration
from runtime.io.images import RGB_SUFFIXES, list_files, read_rgb
from runtime.io.scan import read_scan
from runtime.read_input import read_text
from runtime.sources.frames import Frame
from runtime.sources.source import ListedFrame, Source, no_depth, pair_up, up_to
from runtime.sync.outcome import Outcome, Sensor
from runtime.sync.stamp import DEFAULT_MAX_SKEW_MS
from runtime.sync.stamp_matching import left_out_note, match_by_stamp


class KittiRawSource(Source):
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

    accepted = "a drive of KITTI raw data (holds velodyne_points/)"
    options = ("camera", "calibration", "max_skew_ms")

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
                    f"{drive} is no drive of KITTI raw data, {folder} is missing: give a folder "
                    "like 2011_09_26/2011_09_26_drive_0001_sync, or another --camera"
                )
        self.folders = (images / "data", scans / "data")
        self._drive, self._camera = drive, camera
        if calibration is None:
            own = os.path.exists(drive / "calib_cam_to_cam.txt")
            calibration = drive if own else Path(os.path.realpath(drive)).parent
            if not os.path.exists(calibration / "calib_cam_to_cam.txt"):
                raise InputError(
                    f"neither {drive} nor {calibration} has KITTI's calib_cam_to_cam.txt and "
                    "calib_velo_to_cam.txt: put the day's there, or give --calibration"
                )
        self._calibration_path = calibration
        self.calibration: Calibration = Calibration.from_file(calibration, camera=camera)
        self._images = _by_number(list_files(images / "data", RGB_SUFFIXES))
        self._scans = _by_number(list_files(scans / "data", (".bin",)))
        self._image_stamps: dict[int, int] = {}
        self._scan_stamps: dict[int, int] = {}
        if max_skew_ms is not None:
            self._image_stamps = _read_stamps(images / "timestamps.txt", self._images)
            self._scan_stamps = _read_stamps(scans / "timestamps.txt", self._scans)
        stamped = self._image_stamps and self._scan_stamps
        self._max_skew_ms = max_skew_ms if stamped else None
        self._left_out: Counter[str] = Counter()

    @staticmethod
    def accepts(path: Path) -> bool:
        """See `Source.accepts`."""
        return os.path.isdir(path / "velodyne_points")

    def list_frames(self, *, limit: int | None = None) -> tuple[ListedFrame, ...]:
        """See `Source.list_frames`."""
        self._left_out.clear()
        if self._max_skew_ms is not None:
            return up_to(self._match(self._max_skew_ms), limit)
        alone = self._scans.keys() - self._images.keys()
        self._left_out.update({f"{Sensor.DEPTH}: {Outcome.NO_IMAGE}": len(alone)} if alone else {})
        return pair_up(
            sorted(self._images),
            self._images,
            self._scans,
            limit=limit,
            name=lambda number: self._images[number].stem,
        )

    def _match(self, max_skew_ms: float) -> Iterator[ListedFrame]:
        messages = [(Sensor.IMAGE, self._image_stamps[n], p) for n, p in self._images.items()]
        messages += [(Sensor.DEPTH, self._scan_stamps[n], p) for n, p in self._scans.items()]
        messages.sort(key=lambda message: message[1])
        pairs = match_by_stamp(messages, max_skew_ms=max_skew_ms, left_out=self._left_out)
        for sequence, (image, scan, _) in enumerate(pairs):
            yield ListedFrame(
                sequence,
                image.data.stem,
                image.data,
                None if scan is None else scan.data,
                image.stamp_ns,
                None if scan is None else scan.stamp_ns,
                complete=scan is not None,
            )

    def read(self, frame: ListedFrame) -> Frame:
        """See `Source.read`."""
        rgb = read_rgb(frame.image)
        if frame.depth is None:
            sparse_depth = no_depth(rgb)
        else:
            height, width = rgb.shape[:2]
            sparse_depth = self.calibration.project(read_scan(frame.depth), (height, width))
        return Frame(
            rgb, sparse_depth, frame.image_stamp_ns, frame.depth_stamp_ns, self.calibration
        )

    @property
    def inputs(self) -> dict[str, Any]:
        """See `Source.inputs`."""
        return {
            "drive": str(self._drive),
            "camera": self._camera,
            "calibration": str(self._calibration_path),
            "max_skew_ms": self._max_skew_ms,
            "left_out": dict(self._left_out),
        }

    @property
    def notes(self) -> tuple[str, ...]:
        """See `Source.notes`."""
        return left_out_note(self._left_out)


def _by_number(paths: dict[str, Path]) -> dict[int, Path]:
    """Files by the number that is their stem. Raises InputError."""
    numbers: dict[int, Path] = {}
    for stem, path in paths.items():
        if not (stem.isascii() and stem.isdecimal()):
            raise InputError(f"{path} must have a number for a name, such as 0000000042")
        if int(stem) in numbers:
            raise InputError(f"{numbers[int(stem)]} and {path} have the same number: remove one")
        numbers[int(stem)] = path
    return numbers


def _read_stamps(path: Path, numbers: dict[int, Path]) -> dict[int, int]:
    """Nanoseconds of each number: its line of timestamps.txt, from 0; empty without the file.

    Raises InputError for a line that is no time, and for a number without one.
    """
    if not os.path.lexists(path):
        return {}
    lines = read_text(path).splitlines()
    last = max(numbers)
    if last >= len(lines):
        raise InputError(
            f"{path} has {len(lines)} lines, {numbers[last].name} is number {last}, counted from "
            "0: the file is truncated or of another drive"
        )
    return {n: _nanoseconds(lines[n], f"line {n + 1} of {path}") for n in numbers}


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
            f"{where} is {text!r:.60}, expected a time like 2011-09-26 13:02:25.964389445"
        ) from error
