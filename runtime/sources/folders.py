"""Images and depth maps or scans of the same names in two folders, or one of each."""

import os
import re
from bisect import bisect_left
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.errors import InputError
from runtime.io.calibration import FrameCalibrations
from runtime.io.images import (
    DEPTH_SUFFIXES,
    KITTI_DEPTH_SCALE,
    RGB_SUFFIXES,
    list_files,
    natural_order,
    read_rgb,
    read_sparse_depth,
)
from runtime.io.poses import read_poses
from runtime.io.scan import SCAN_SUFFIXES, read_scan
from runtime.io.timestamps import read_timestamps
from runtime.sources.frames import Frame
from runtime.sources.recorded_motion import (
    RecordedPoses,
    frame_of,
    left_out_note,
    match_frames,
    project_listed,
)
from runtime.sources.source import ListedFrame, Source, pair_up
from runtime.sync.motion import ScanStamp, lidar_mount, point_times
from runtime.sync.outcome import Outcome, Sensor
from runtime.sync.poses import PoseFrame, PoseTrack
from runtime.sync.stamp import DEFAULT_REUSE_DEPTH_MS, NS_PER_MS

_SENSOR_WORDS = {"image", "img", "rgb", "color", "depth", "lidar", "velodyne", "points"}
_APART_NS = 100 * NS_PER_MS  # between images without times
#: Camera of a folder of KITTI: image_02, image_2/, image_02/data.
_KITTI_CAMERA = re.compile(r"(?:^|/)image_0?([0-3])(?:/data)?$")


class FolderSource(Source):
    """Pairs of files with the same stem, in natural order ("9" before "10").

    Where no stem occurs in both folders, files are paired whose stems have the same numbers and
    differ by a word, as image_7 and depth_7.

    Args:
        rgb: folder of PNG and JPEG files, or one such file.
        depth: folder of depth maps, or the one of one image, see `read_sparse_depth`.
        points: the same of scans, see `read_scan`, in place of depth; None: the camera alone.
        depth_scale: units of 16-bit depth maps per metre.
        point_columns: numbers per point of .bin scans; None: as `read_scan`.
        calibration: TOML or KITTI file, see `Calibration.from_file`, or a folder with such a file
            of the name of each frame. Scans need one.
        timestamps: file with the time of each image, see `read_timestamps`; None: unknown.
        reuse_depth_ms: an image without depth of its own takes the newest before it that is at most
            so old. None: 150 with `poses` or `timestamps`; without any of the three an image
            without depth is a frame that cannot be read. Images without times are 100 ms apart.
        poses: file of poses, see `read_poses`, by which scans are moved to the time of an image.
        pose_frame: of which they are.
        scan_stamp: what instant of a scan the time of its image is.
        point_time_column: number, from 0, of the column of .bin and .npy scans with the time of
            each point, in seconds after the time of its image.

    Raises:
        InputError: for a folder with a file of the other kind, for scans with depth or without a
            calibration, for poses without scans, and if the calibration cannot be read.
    """

    accepted = "a folder of images, or one image"
    #: True: an image without depth is a camera-only frame, and depth without an image is ignored.
    #: False: both are frames that cannot be read.
    camera_alone = False
    #: Whether images of KITTI's raw data are rectified.
    _kitti_rectified = True

    def __init__(
        self,
        rgb: Path,
        *,
        depth: Path | None = None,
        points: Path | None = None,
        depth_scale: float = KITTI_DEPTH_SCALE,
        point_columns: int | None = None,
        calibration: Path | None = None,
        timestamps: Path | None = None,
        reuse_depth_ms: float | None = None,
        poses: Path | None = None,
        pose_frame: PoseFrame | None = None,
        scan_stamp: ScanStamp = "middle",
        point_time_column: int | None = None,
    ) -> None:
        if (poses is None) != (pose_frame is None):
            raise InputError("give --poses and pose_frame= in --source together")
        if poses is not None and points is None:
            raise InputError(f"the poses in {poses} move scans: give --points")
        if points is not None and depth is not None:
            raise InputError(f"give depth maps ({depth}) or scans ({points}), not both")
        if points is not None and calibration is None:
            raise InputError(f"the scans in {points} cannot be projected: give --calibration")
        self._depth_scale, self._point_columns = depth_scale, point_columns
        self._calibration, self._has_scans = calibration, points is not None
        self._what = "scan" if self._has_scans else "depth map"
        self._rgb, self._depth, self._is_one = rgb, depth or points, _is_image(rgb)
        self._left_out: Counter[str] = Counter()
        self._notes: list[str] = []
        self._unused_scans = 0
        if self._depth is not None and os.path.isfile(self._depth) and not self._is_one:
            raise InputError(
                f"{rgb} and {self._depth} must be two folders, or an image and its {self._what}"
            )
        self.folders = tuple(
            path.parent if os.path.isfile(path) else path
            for path in (rgb, self._depth)
            if path is not None
        )
        self._timestamps, self._poses_file, self._scan_stamp = timestamps, poses, scan_stamp
        self._pose_frame, self._point_time_column = pose_frame, point_time_column
        self._is_timed = any(each is not None for each in (timestamps, poses, reuse_depth_ms))
        self.camera_alone = self.camera_alone or self._is_timed
        self._reuse_depth_ms = DEFAULT_REUSE_DEPTH_MS if reuse_depth_ms is None else reuse_depth_ms
        self._poses: RecordedPoses | None = None
        self._calibrations: FrameCalibrations | None = None
        if calibration is not None:
            camera = _KITTI_CAMERA.search(rgb.as_posix())
            self._calibrations = FrameCalibrations(
                calibration, camera=int(camera[1]) if camera else 2, rectified=self._kitti_rectified
            )
            self.calibration = self._calibrations.first
            if pose_frame is not None:
                lidar_mount(pose_frame, self.calibration)  # raises InputError if unknown

    @staticmethod
    def accepts(path: Path) -> bool:
        """See `Source.accepts`."""
        return _is_image(path) or any(map(_is_image, list_entries(path)))

    def list_frames(self, *, limit: int | None = None) -> tuple[ListedFrame, ...]:
        """See `Source.list_frames`. A name without a partner is listed too.

        Raises:
            InputError: if a folder is missing or has no images, if a stem occurs twice in a folder,
                or if no two files make a pair.
        """
        self._left_out.clear()
        self._notes.clear()
        if self._depth is not None:
            _require_option(self._depth, has_scans=self._has_scans)
        images = {self._rgb.stem: self._rgb} if self._is_one else self._list_images()
        depths = None
        if self._depth is None:
            self._find_unused_scans()
        elif self._is_one and os.path.isfile(self._depth):
            depths = {self._rgb.stem: self._depth}
        else:
            depths = self._pair(images, self._list_depths(self._depth))
        without_image = set() if self._is_one else (depths or {}).keys() - images.keys()
        if self.camera_alone and without_image:
            self._left_out[f"{Sensor.DEPTH}: {Outcome.NO_IMAGE}"] = len(without_image)
            without_image = set()
        names = sorted(images.keys() | without_image, key=natural_order)
        if self._is_timed:
            return self._list_timed(names, images, depths, limit)
        return pair_up(names, images, depths, limit=limit)

    def _list_timed(
        self,
        names: list[str],
        images: dict[str, Path],
        depths: dict[str, Path] | None,
        limit: int | None,
    ) -> tuple[ListedFrame, ...]:
        """The frames with their times; an image without depth takes an older one."""
        if self._timestamps is None:
            stamps_ns = [number * _APART_NS for number in range(len(names))]
            self._notes.append(
                "guessed: the images are 100 ms apart; timestamps= in --source says when"
            )
        else:
            stamps_ns = read_timestamps(self._timestamps)
            if len(stamps_ns) != len(names):
                raise InputError(
                    f"{self._timestamps} has {len(stamps_ns)} lines, there are {len(names)} "
                    "images: it must have a line for each image, in natural order"
                )
        if self._poses_file is not None and self._pose_frame is not None:
            of_clock = self._timestamps is not None
            poses_ns, poses = read_poses(self._poses_file, stamps_ns, of_clock=of_clock)
            self._poses = RecordedPoses(PoseTrack.of(poses, poses_ns), self._pose_frame)

        def messages() -> Iterator[tuple[Sensor, int, Path]]:
            for name, stamp_ns in zip(names, stamps_ns, strict=True):
                if name in (depths or {}):
                    yield Sensor.DEPTH, stamp_ns, (depths or {})[name]
                yield Sensor.IMAGE, stamp_ns, images[name]

        return match_frames(
            messages(),
            max_skew_ms=0,
            reuse_depth_ms=self._reuse_depth_ms,
            scan_stamp=self._scan_stamp,
            left_out=self._left_out,
            name=lambda pair: names[bisect_left(stamps_ns, pair.image.stamp_ns)],
            limit=limit,
            camera_only=depths is None,
        )

    def _list_images(self) -> dict[str, Path]:
        return list_files(self._rgb)

    def _list_depths(self, folder: Path) -> dict[str, Path]:
        return list_files(folder, SCAN_SUFFIXES if self._has_scans else DEPTH_SUFFIXES)

    def _pair(self, images: dict[str, Path], depths: dict[str, Path]) -> dict[str, Path]:
        """The depth maps or scans by the stems of their images. Raises InputError."""
        if images.keys() & depths.keys():
            return depths
        stems = {_numbers(stem): stem for stem in images}
        by_number = {_numbers(stem): path for stem, path in depths.items()}
        paired = sorted(
            number
            for number in stems.keys() & by_number.keys()
            if number and _differ_by_a_word(stems[number], by_number[number].stem)
        )
        if not paired or len(stems) < len(images) or len(by_number) < len(depths):
            raise InputError(
                f"no name occurs in both folders: {self._rgb} has {_few(images)}, {self._depth} "
                f"has {_few(depths)}: the image and the {self._what} of a frame need the same file "
                "stem, or stems that differ by a word, as image_7 and depth_7"
            )
        first = paired[0]
        self._notes.append(
            f"guessed: pairs by the numbers in their names, as {images[stems[first]].name} with "
            f"{by_number[first].name}"
        )
        return {stems.get(n, path.stem): path for n, path in by_number.items()}

    def _find_unused_scans(self) -> None:
        folder = self._rgb.parent if self._is_one else self._rgb
        kinds = tuple(suffix for suffix in SCAN_SUFFIXES if suffix != ".npy")  # may be depth maps
        scans = [path.name for path in list_entries(folder) if path.name.lower().endswith(kinds)]
        if self._is_one:
            scans = [name for name in scans if name.startswith(f"{self._rgb.stem}.")]
        self._unused_scans = len(scans)
        if scans:
            self._notes.append(
                f"warning: {folder} also holds {len(scans)} scans such as {min(scans)}, which are "
                f"not used: give --points {folder} and --calibration"
            )

    def read(self, frame: ListedFrame) -> Frame:
        """See `Source.read`. Raises InputError also where one of the two files is missing."""
        if self._depth is not None and not self.camera_alone:
            require_pair(frame, self._what)
        rgb = read_rgb(frame.image)
        found = None if self._calibrations is None else self._calibrations.of(frame.name)
        has_map = frame.depth is not None and not self._has_scans
        rgb, calibration = self._rectified(rgb, found, has_map=has_map)
        if frame.depth is None:
            return frame_of(frame, rgb, None, calibration)
        if not self._has_scans:
            sparse_depth = read_sparse_depth(frame.depth, depth_scale=self._depth_scale)
            return frame_of(frame, rgb, sparse_depth, calibration)
        assert calibration is not None  # see __init__
        scan, size = self._read_scan(frame.depth), (rgb.shape[0], rgb.shape[1])
        times = None
        if self._point_time_column is not None and frame.depth_stamp_ns is not None:
            column = scan[:, self._point_time_column]
            times = point_times(column, len(scan), frame.depth_stamp_ns)
        depth = project_listed(frame, calibration, scan, times, self._poses, size)
        return frame_of(frame, rgb, depth, calibration)

    def _read_scan(self, path: Path) -> NDArray[np.float32]:
        scan = read_scan(path, columns=self._point_columns)
        column = self._point_time_column
        if column is not None and column >= scan.shape[1]:
            raise InputError(
                f"{path} has {scan.shape[1]} columns, counted from 0, and point_time_column is "
                f"{column}: columns beyond x, y and z are read of .bin and .npy alone"
            )
        return scan

    @property
    def inputs(self) -> dict[str, Any]:
        """See `Source.inputs`."""
        depth = None if self._depth is None else str(self._depth)
        calibration = None if self._calibration is None else str(self._calibration)
        scans = {"points": depth, "point_columns": self._point_columns, "calibration": calibration}
        maps = {"depth": depth, "depth_scale": self._depth_scale}
        inputs = {"rgb": str(self._rgb), **(scans if self._has_scans else maps)}
        if self._is_timed:
            inputs["timestamps"] = None if self._timestamps is None else str(self._timestamps)
            inputs["reuse_depth_ms"] = self._reuse_depth_ms
        if self._poses_file is not None:
            inputs |= {"poses": str(self._poses_file), "pose_frame": str(self._pose_frame)}
            inputs |= {"scan_stamp": self._scan_stamp, "point_time_column": self._point_time_column}
        if self._unused_scans:
            inputs["unused_scans"] = self._unused_scans
        return inputs | ({"left_out": dict(self._left_out)} if self.camera_alone else {})

    @property
    def notes(self) -> tuple[str, ...]:
        """See `Source.notes`."""
        return (*self._notes, *left_out_note(self._left_out))


def require_pair(frame: ListedFrame, what: str = "depth map") -> None:
    """Raise InputError if a frame lacks its image or its depth map (`what`)."""
    if frame.image is None:
        raise InputError(f"{frame.name} has a {what}, but no image")
    if frame.depth is None:
        raise InputError(f"{frame.name} has an image, but no {what}")


def list_entries(path: Path) -> list[Path]:
    """What a folder holds, without hidden files; nothing if it is not a folder."""
    try:
        return [entry for entry in path.iterdir() if not entry.name.startswith(".")]
    except OSError:
        return []


def _is_image(path: Path) -> bool:
    return path.suffix.lower() in RGB_SUFFIXES and os.path.isfile(path)


def _require_option(path: Path, *, has_scans: bool) -> None:
    """Raise InputError for scans that were given as depth maps, and the reverse."""
    names = [path.name] if os.path.isfile(path) else [entry.name for entry in list_entries(path)]
    scans, maps = (
        any(name.lower().endswith(suffixes) for name in names)
        for suffixes in (SCAN_SUFFIXES, DEPTH_SUFFIXES)
    )
    if scans and not maps and not has_scans:
        raise InputError(f"{path} contains scans, not depth maps: give --points, and --calibration")
    if maps and not scans and has_scans:
        raise InputError(f"{path} contains depth maps, not scans: give --depth")


def _numbers(stem: str) -> tuple[str, ...]:
    return tuple(re.findall("[0-9]+", stem))


def _differ_by_a_word(stem: str, other: str) -> bool:
    """Whether both names have different words, or one name has an additional sensor name."""
    words, others = (Counter(re.findall(r"[^\W\d_]+", text.lower())) for text in (stem, other))
    more, less = words - others, others - words
    return bool(more and less) or (bool(more + less) and set(more + less) <= _SENSOR_WORDS)


def _few(names: dict[str, Path]) -> str:
    shown = ", ".join(sorted(names, key=natural_order)[:3])
    return f"{shown} …" if len(names) > 3 else shown
