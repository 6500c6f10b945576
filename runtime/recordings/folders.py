"""Images with depth maps or scans of the same names in two folders, or one file of each."""

import contextlib
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from runtime.base.errors import InputError
from runtime.base.natural_order import in_natural_order, normal_form, numbers_in
from runtime.base.stamp import NS_PER_MS
from runtime.geometry.assumptions import assume, collect_assumptions
from runtime.geometry.calibration import RAW_CAMERAS, RAW_SCANNER, Calibration
from runtime.geometry.motion import lidar_mount, point_times
from runtime.geometry.odometry import ODOMETRY, Odometry
from runtime.geometry.poses import PoseFrame, PoseTrack
from runtime.geometry.rig import DEFAULT_RIG, Rig
from runtime.recordings.images import (
    DEPTH_SUFFIXES,
    KITTI_DEPTH_SCALE,
    RGB_SUFFIXES,
    list_files,
    read_rgb,
    read_sparse_depth,
)
from runtime.recordings.listing import ListedFrame, limit_frames
from runtime.recordings.poses import read_poses, read_timestamps
from runtime.recordings.scan import SCAN_SUFFIXES, read_scan
from runtime.recordings.source import Names, Source, pose_track
from runtime.streams.frame import Frame
from runtime.streams.messages import Outcome, Place, Scan, Sensor

_APART_NS = 100 * NS_PER_MS  # assumed interval between images without time stamps
# Number of the camera in the paths of KITTI: image_02, image_2/0.png, image_02/data.
_KITTI_CAMERA = re.compile(r"(?:^|/)image_0?([0-3])(?:/data)?(?:/[^/\n]*\.\w+)?$", re.MULTILINE)


class FolderOptions(NamedTuple):
    """The options of a `FolderSource`.

    Attributes:
        depth: folder of depth maps, or the depth map of a single image, see `read_sparse_depth`.
        points: folder of scans, or the scan of a single image, see `read_scan`. If neither `depth`
            nor `points` is given, only the camera is used.
        depth_scale: units of 16-bit depth maps per metre.
        point_columns: numbers per point of .bin scans; None: the default of `read_scan`.
        camera: number of KITTI's camera, 0 to 3; None: the number in the folder's name after links
            are followed (image_2), else 2, with a warning if another camera's scans would land
            elsewhere.
        timestamps: file with the time of each image, see `read_timestamps`; None: times are
            unknown.
        poses: file of poses, see `read_poses`, which move scans to the time of their image; or
            "odometry": they are found from the scans, see `Odometry`.
        point_time_column: index, from 0, of the column of .bin and .npy scans that holds the time
            of each point, in seconds after the time of its image.
    """

    depth: Path | None = None
    points: Path | None = None
    depth_scale: float = KITTI_DEPTH_SCALE
    point_columns: int | None = None
    camera: int | None = None
    timestamps: Path | None = None
    poses: Path | None = None
    point_time_column: int | None = None


class FolderSource(Source):
    """Pairs of files with the same stem, in natural order, see `in_natural_order`.

    If no stem occurs in both folders, files whose stems contain the same numbers are paired, such
    as image_7 and depth_7.

    Args:
        rgb: folder of PNG and JPEG files, or one such file.
        rig: the path of its calibration may also be a folder with a file for each frame, named like
            the frame; scans need a calibration. Its `pose_frame` is the frame of `poses`. With
            `reuse_depth_ms`, `poses` or `timestamps` an image without depth takes older depth or
            becomes a frame of the camera alone; without any of the three it is a frame that cannot
            be read. Images without time stamps count as 100 ms apart.
        **options: see `FolderOptions`.

    Raises:
        InputError: if a folder holds files of the other kind, if scans are given together with
            depth maps or without a calibration, if poses are given without scans, or if the
            calibration cannot be read.
    """

    accepted = "a folder of images, or one image"
    options: ClassVar[Names] = FolderOptions._fields
    rig_options: ClassVar[Names] = ("calibration", "pose_frame", "scan_stamp", "reuse_depth_ms")
    # If true, an image without depth is a frame of the camera alone, and depth without an image is
    # ignored. If false, both are frames that cannot be read.
    camera_alone = False
    # Whether the images of KITTI's raw data are rectified.
    _kitti_rectified = True

    def __init__(self, rgb: Path, rig: Rig = DEFAULT_RIG, **options: Any) -> None:
        given = self._given = FolderOptions(**options)
        self._rig = replace(rig, max_skew_ms=0)  # files of one name have one stamp
        poses, points, calibration = given.poses, given.points, rig.calibration
        is_odometry = self._is_odometry = poses == Path(ODOMETRY)
        if is_odometry and rig.pose_frame is not None:
            raise InputError("poses by odometry are those of the LiDAR: leave pose_frame out")
        if not is_odometry and (poses is None) != (rig.pose_frame is None):
            raise InputError("poses and their frame go together: give `poses=` and `pose_frame=`")
        if poses is not None and points is None:
            raise InputError(f"the poses in {poses} move scans: give `points=`")
        if is_odometry:
            Odometry()  # raises if its package is missing
        if points is not None and given.depth is not None:
            raise InputError(f"give depth maps ({given.depth}) or scans ({points}), not both")
        if points is not None and calibration is None:
            raise InputError(f"the scans in {points} cannot be projected: give `calibration=`")
        self._rgb, self._depth, self._has_scans = rgb, given.depth or points, points is not None
        self._is_one, self._what = _is_image(rgb), "scan" if self._has_scans else "depth map"
        self.depth_scale = None if self._has_scans else given.depth_scale
        paths = (rgb,) if self._depth is None else (rgb, self._depth)
        self.folders = tuple(path.parent if os.path.isfile(path) else path for path in paths)
        self._is_timed = (given.timestamps, poses, rig.reuse_depth_ms) != (None, None, None)
        self.camera_alone = self.camera_alone or self._is_timed
        self._calibration_files: dict[str, Path] = {}
        if isinstance(calibration, Calibration):
            self.calibration = calibration
        elif calibration is not None:
            with self.collecting():
                self._open_calibration(Path(calibration), given.camera)
        pose_frame = PoseFrame.LIDAR if is_odometry else rig.pose_frame
        if pose_frame is not None and self.calibration is not None:
            lidar_mount(pose_frame, self.calibration)  # raises if it is unknown
            self._pose_frame = pose_frame

    def _open_calibration(self, path: Path, camera: int | None) -> None:
        """Read the calibration; of a folder with a file per frame, the first readable one."""
        is_raw = any(os.path.lexists(path / name) for name in (RAW_CAMERAS, RAW_SCANNER))
        if os.path.isdir(path) and not is_raw:
            self._calibration_files = list_files(path, (".txt", ".toml"))
        names = in_natural_order(self._calibration_files)
        paths = [self._calibration_files[name] for name in names] or [path]
        named = _KITTI_CAMERA.search(f"{os.path.realpath(self._rgb)}\n{self._rgb.as_posix()}")
        known = int(named[1]) if camera is None and named else camera
        read = partial(
            Calibration.from_file,
            camera=2 if known is None else known,
            rectified=self._kitti_rectified,
            for_scans=self._has_scans,
        )
        self._read_calibration, self.calibration = read, _first_readable(paths, read)
        others = []
        for other in (0, 1, 3) if known is None and self._has_scans else ():
            with contextlib.suppress(InputError), collect_assumptions([]):  # it may be missing
                others.append(_first_readable(paths, partial(read, camera=other)).extrinsics)
        if not all(np.allclose(each, self.calibration.extrinsics) for each in others):
            assume(f"camera 2 of KITTI for {self._rgb}", "`camera=` says which")

    @staticmethod
    def accepts(path: Path) -> bool:
        """See `Source.accepts`."""
        return _is_image(path) or any(map(_is_image, list_entries(path)))

    def list_frames(self, *, limit: int | None = None) -> tuple[ListedFrame, ...]:
        """See `Source.list_frames`. A file without a partner is listed as well.

        Raises:
            InputError: if a folder is missing or has no images, if a stem occurs twice in a folder,
                or if no two files make a pair.
        """
        self.left_out.clear()
        only = normal_form(self._rgb.stem)
        images = {only: self._rgb} if self._is_one else self._list_images()
        depths: dict[str, Path] = {}
        if self._depth is not None:
            if self._is_one and os.path.isfile(self._depth):
                depths = {only: self._depth}
            else:
                depths = self._pair(images, self._list_depths(self._depth))
        without_image = set() if self._is_one else depths.keys() - images.keys()
        if self.camera_alone and without_image:
            self.left_out[f"{Sensor.DEPTH}: {Outcome.NO_IMAGE}"] = len(without_image)
            without_image = set()
        names = in_natural_order(images.keys() | without_image)
        if self._is_timed:
            return self._list_timed({name: images[name] for name in names}, depths, limit)
        whole = images.keys() if self._depth is None else images.keys() & depths.keys()
        frames = (
            ListedFrame(number, name, images.get(name), depths.get(name), complete=name in whole)
            for number, name in enumerate(names)
        )
        return limit_frames(frames, limit)

    def _list_timed(
        self, images: Mapping[str, Path], depths: Mapping[str, Path], limit: int | None
    ) -> tuple[ListedFrame, ...]:
        """List the frames with their times; an image without depth takes older depth."""
        if self._given.timestamps is None:
            stamps_ns = [number * _APART_NS for number in range(len(images))]
            self._note("guessed: the images are 100 ms apart; `timestamps=` says when")
        else:
            stamps_ns = read_timestamps(self._given.timestamps)
            if len(stamps_ns) != len(images):
                raise InputError(
                    f"{self._given.timestamps} has {len(stamps_ns)} lines, there are {len(images)} "
                    "images: it must have a line for each image, in natural order"
                )
        if self._given.poses is not None and not self._is_odometry:
            of_clock = self._given.timestamps is not None
            with self.collecting():
                poses_ns, poses = read_poses(self._given.poses, stamps_ns, of_clock=of_clock)
                self._poses = PoseTrack.of(poses, poses_ns)
        places: list[Place] = []
        for (name, image), stamp_ns in zip(images.items(), stamps_ns, strict=True):
            if name in depths:
                places.append(Place(Sensor.DEPTH, depths[name], stamp_ns))
            places.append(Place(Sensor.IMAGE, image, stamp_ns))
        return self._match(places, limit=limit, camera_only=self._depth is None)

    def _match(self, *places: Any, **options: Any) -> tuple[ListedFrame, ...]:
        frames = super()._match(*places, **options)
        if self._is_odometry:
            self._poses = self._find_poses(frames)
        return frames

    def _find_poses(self, frames: Sequence[ListedFrame]) -> PoseTrack:
        """Read all scans of a list for the poses of the LiDAR in their middle."""
        odometry, to_middle_ns, stamped = Odometry(), self._to_middle_ns, []
        for frame in frames:
            if frame.depth is not None and frame.depth_stamp_ns is not None and not frame.reused:
                with contextlib.suppress(InputError):  # reported when the frame is read
                    pose = odometry.add(self._read_scan(frame).points)
                    stamped.append((frame.depth_stamp_ns + to_middle_ns, pose))
        return pose_track(stamped)

    def _list_images(self) -> Mapping[str, Any]:
        return list_files(self._rgb)

    def _list_depths(self, folder: Path) -> dict[str, Path]:
        return list_files(folder, SCAN_SUFFIXES if self._has_scans else DEPTH_SUFFIXES)

    def _pair(self, images: Mapping[str, Path], depths: dict[str, Path]) -> dict[str, Path]:
        """Map the stems of the images to their depth maps or scans. Raises InputError."""
        if images.keys() & depths.keys():
            self._check_numbering(images, depths)
            return depths
        stems = {numbers: stem for stem, numbers in numbers_in(images).items()}
        numbered = {numbers: depths[stem] for stem, numbers in numbers_in(depths).items()}
        both = stems.keys() & numbered.keys() - {()}
        if not both or len(stems) < len(images) or len(numbered) < len(depths):
            raise InputError(
                f"no name occurs in both folders: {self._rgb} has {_few(images)}, {self._depth} "
                f"has {_few(depths)}: the image and the {self._what} of a frame need the same file "
                "stem, or the same numbers in it, as image_7 and depth_7"
            )
        first = min(both)
        self._note(
            f"guessed: pairs by the numbers in their names, as {images[stems[first]].name} with "
            f"{numbered[first].name}"
        )
        return {stems.get(n, path.stem): path for n, path in numbered.items()}

    def _check_numbering(self, images: Iterable[str], depths: Iterable[str]) -> None:
        """Report the assumption that two numberings are one, if one counts from another number."""
        first, second = (sorted(map(int, filter(str.isdecimal, s))) for s in (images, depths))
        apart = {after - before for before, after in zip(first, second, strict=False)}
        if len(first) == len(second) > 1 and len(apart) == 1 and apart != {0}:
            what = f"images numbered from {first[0]} and {self._what}s numbered from {second[0]}"
            with self.collecting():
                assume(
                    f"that equal numbers are one frame, of {what}", "number both from 0 or from 1"
                )

    def _read_image(self, image: Any) -> NDArray[np.uint8]:
        return read_rgb(image)

    def read(self, frame: ListedFrame) -> Frame:
        """See `Source.read`. Raises InputError also if one of the two files is missing."""
        if frame.image is None:
            raise InputError(f"{frame.name} has a {self._what}, but no image")
        if frame.depth is None and self._depth is not None and not self.camera_alone:
            raise InputError(f"{frame.name} has an image, but no {self._what}")
        depth: NDArray[np.float32] | Scan | None = None
        with self.collecting():
            rgb, calibration = self._read_image(frame.image), self.calibration
            if self._calibration_files:
                if frame.name not in self._calibration_files:
                    raise InputError(f"{frame.name} has no calibration in {self._rig.calibration}")
                calibration = self._read_calibration(self._calibration_files[frame.name])
            if frame.depth is not None and self._has_scans:
                depth = self._read_scan(frame)
            elif frame.depth is not None:
                depth = read_sparse_depth(frame.depth, depth_scale=self._given.depth_scale)
            return self.measured(frame, rgb, depth, calibration)

    def _read_scan(self, frame: ListedFrame) -> Scan:
        points, after_s = read_scan(frame.depth, columns=self._given.point_columns), None
        column, stamp_ns = self._given.point_time_column, frame.depth_stamp_ns
        if column is not None and column >= points.shape[1]:
            raise InputError(
                f"{frame.depth} has the columns 0 to {points.shape[1] - 1}, and point_time_column "
                f"is {column}: beyond x, y and z only those of .bin and .npy are read"
            )
        if column is not None and stamp_ns is not None:
            after_s = point_times(points[:, column], len(points), stamp_ns)
        with self.collecting():
            return Scan.of(points, after_s, stamp_ns)

    @property
    def inputs(self) -> dict[str, Any]:
        """See `Source.inputs`."""
        options = {"rgb": self._rgb, **self._given._asdict(), **self._rig_facts}
        del options["camera"], options["depth" if self._has_scans else "points"]
        options["depth_scale"] = self.depth_scale
        options["reuse_depth_ms"] = self._rig.max_depth_age_ms if self._is_timed else None
        inputs = {
            name: value if value is None or isinstance(value, int | float) else str(value)
            for name, value in options.items()
        }
        return inputs | ({"left_out": dict(self.left_out)} if self.camera_alone else {})


def _first_readable(paths: Sequence[Path], read: Callable[[Path], Calibration]) -> Calibration:
    """Return the first calibration that can be read, or raise the InputError of the last file."""
    for path in paths[:-1]:
        with contextlib.suppress(InputError):  # reported when its frame is read
            return read(path)
    return read(paths[-1])


def list_entries(path: Path) -> list[Path]:
    """The entries of a folder except hidden ones; none if the path is not a folder."""
    try:
        return [entry for entry in path.iterdir() if not entry.name.startswith(".")]
    except OSError:
        return []


def _is_image(path: Path) -> bool:
    return path.suffix.lower() in RGB_SUFFIXES and os.path.isfile(path)


def _few(names: Iterable[str]) -> str:
    first = in_natural_order(names)[:4]
    return ", ".join(first[:3]) + (" …" if len(first) > 3 else "")
