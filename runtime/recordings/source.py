"""The interface of every source of frames: it lists its frames and reads each of them."""

import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from runtime.base.errors import InputError
from runtime.base.natural_order import contain_decimals
from runtime.checks.sensor_times import period_ns_of
from runtime.geometry.assumptions import collect_assumptions
from runtime.geometry.calibration import Calibration
from runtime.geometry.motion import FIRST_SCAN_NS, assume_middle, lidar_mount
from runtime.geometry.poses import PoseFrame, PoseTrack
from runtime.geometry.returns import check_farthest
from runtime.geometry.rig import DEFAULT_RIG, Rig
from runtime.recordings.listing import ListedFrame, left_out_note, list_places
from runtime.recordings.ros_answers import SensorFrames
from runtime.streams.frame import Frame
from runtime.streams.messages import Depth, Image, Place, Scan, Sensor

Names = tuple[str, ...]


class Source(ABC):
    """A stream of frames that can be listed and read again, by one thread at a time.

    Attributes:
        accepted: the paths that are of this kind, in words.
        options: names of its options, the keywords of its constructor.
        rig_options: names of the attributes of `Rig` that it uses.
        is_stream: whether frames are read fast only in the list's order, by the process that opened
            the source.
        calibration: calibration of the camera and, if there is one, the LiDAR; None if unknown.
        depth_scale: units per metre of the 16-bit depth maps; None if no such maps are read.
        stamps_ns: time stamps of images and depth [ns] in the order of the recording, including
            messages that belong to no frame; known after listing, empty without time stamps.
        folders: folders from which frames are read; predictions must not be written there.
        recordings: files or whole folders that outputs must not replace or write into.
    """

    accepted: ClassVar[str]
    options: ClassVar[Names] = ()
    rig_options: ClassVar[Names] = ()
    is_stream: ClassVar[bool] = False
    calibration: Calibration | None = None
    depth_scale: float | None = None
    stamps_ns: Mapping[Sensor, Sequence[int]] = MappingProxyType({})
    folders: tuple[Path, ...] = ()
    recordings: tuple[Path, ...] = ()
    _rig = DEFAULT_RIG
    _poses: PoseTrack | None = None  # of the car, whose frame is `_pose_frame`
    _pose_frame: PoseFrame | str = PoseFrame.BODY
    _period_ns: float = FIRST_SCAN_NS  # of the scans
    _rectifies = False

    @abstractmethod
    def __init__(self, path: Path, rig: Rig = DEFAULT_RIG, **options: Any) -> None:
        """Open the recording.

        Args:
            path: file or folder.
            rig: the sensors of the car; the attributes in `rig_options` are used.
            **options: the options named in `options`.

        Raises:
            InputError: if the path is not a recording of this kind.
        """

    @classmethod
    def open_cameras(
        cls, path: Path, rig: Rig = DEFAULT_RIG, **options: Any
    ) -> "dict[str, Source]":
        """Open a source for each camera that the options name.

        Args:
            path: file or folder.
            rig: see the constructor.
            **options: see the constructor; one of them may name several cameras.

        Returns:
            The sources by the names of the cameras' folders; "" is the name of an only camera.

        Raises:
            InputError: in the cases of the constructor.
        """
        return {"": cls(path, rig, **options)}

    @staticmethod
    @abstractmethod
    def accepts(path: Path) -> bool:
        """Whether a path looks like a recording of this kind; its files are not opened."""

    @abstractmethod
    def list_frames(self, *, limit: int | None = None) -> tuple[ListedFrame, ...]:
        """List the frames in order.

        Args:
            limit: the list ends after this number of complete frames; None: all frames are listed.

        Raises:
            InputError: if the source has no frames or cannot be listed.
        """

    @abstractmethod
    def read(self, frame: ListedFrame) -> Frame:
        """Read a frame of the list; reading in the list's order is fastest.

        Raises:
            InputError: if the frame is damaged or incomplete; other frames can still be read. Also
                if the source holds files open (a bag or a video) and the process was forked since.
        """

    def rectify_images(self) -> None:
        """Make `read` return images without distortion and a calibration without a lens.

        Raises:
            InputError: if the calibration has no lens.
        """
        if self.calibration is None or self.calibration.lens_model is None:
            reason = "calibration" if self.calibration is None else "lens in their calibration"
            raise InputError(f"the images cannot be rectified: there is no {reason}")
        self._rectifies = True

    def collecting(self) -> AbstractContextManager[None]:
        """Collect the assumptions that this thread makes inside a block in `notes`."""
        return collect_assumptions(self._lines)

    def measured(
        self,
        frame: ListedFrame,
        rgb: NDArray[np.uint8],
        depth: NDArray[np.float32] | Depth | Scan | None = None,
        calibration: Calibration | None = None,
    ) -> Frame:
        """Return a frame with what its sensors measured, the depth projected into the image.

        The image is rectified if this was requested. A scan whose points have no times gets the
        time of its middle, and poses move its returns to the time of the image.

        Args:
            frame: a frame of the list.
            rgb: uint8 (H, W, 3), RGB.
            depth: a depth map, float32 (H, W) in metres, 0 where there is no return; or a scan,
                whose points have times only if these are known.
            calibration: calibration of the camera, for a scan also of the LiDAR.

        Raises:
            InputError: if the calibration is for images of another size, which would silently
                falsify clouds and the focal length; and for a depth map of a rectified image.
        """
        if isinstance(depth, np.ndarray):
            check_farthest(depth)
            depth = Depth(depth)
        poses, image_ns, depth_ns = None, frame.image_stamp_ns, frame.depth_stamp_ns
        if depth is not None:
            depth = replace(depth, stamp_ns=depth_ns)
        with self.collecting():
            if calibration is not None:
                calibration.require_size(rgb.shape[:2])
                if self._rectifies and isinstance(depth, Depth):
                    raise InputError(
                        "a depth map lies on the pixels of the distorted image: no `rectify=True`"
                    )
                if self._rectifies:
                    rgb, calibration = calibration.rectify(rgb), calibration.rectified
                if self._poses is not None:
                    poses = self._poses.mounted(lidar_mount(self._pose_frame, calibration))
            if isinstance(depth, Scan) and depth.times is None and depth_ns is not None:
                depth = replace(depth, times=depth_ns + self._to_middle_ns)
                if poses is not None and depth_ns != image_ns and self._rig.scan_stamp is None:
                    assume_middle()
            image = Image(rgb, stamp_ns=image_ns)
            return Frame(image, depth, frame.reused, calibration, poses, frame.name)

    @property
    @abstractmethod
    def inputs(self) -> dict[str, Any]:
        """The inputs for report.json; after listing, with the counts of skipped messages."""

    @property
    def lidar_place(self) -> tuple[str, str, NDArray[np.float64] | None]:
        """Names of the frames of camera and LiDAR, and the LiDAR's position in the camera's [m].

        The position is float64 (3,), or None if it is unknown.
        """
        known = self.calibration
        return "camera", "lidar", None if known is None else known.extrinsics[:3, 3]

    @property
    def notes(self) -> tuple[str, ...]:
        """Lines for the terminal: guesses and, after listing, the skipped messages."""
        return (*self._lines, *left_out_note(self.left_out))

    @property
    def sensor_frames(self) -> SensorFrames:
        """The frames of the sensors in the terms of ROS, with invented names for other formats."""
        return SensorFrames.of(self.calibration)

    @property
    def _rig_facts(self) -> dict[str, Any]:
        """The attributes of the rig that are used, ready for JSON."""
        facts = {name: getattr(self._rig, name) for name in self.rig_options}
        if "scan_stamp" in facts:
            facts["scan_stamp"] = self._rig.scan_stamp or "middle"
        calibration = self._rig.calibration
        is_array = isinstance(calibration, Calibration)
        facts["calibration"] = "a Calibration" if is_array else calibration and str(calibration)
        return facts

    @cached_property
    def left_out(self) -> Counter[str]:
        """Counts of what is in no frame, such as "image: duplicate"; known after listing."""
        return Counter()

    @cached_property
    def _lines(self) -> list[str]:
        return []

    @property
    def _to_middle_ns(self) -> int:
        """Time from the stamp of a scan to its middle."""
        return round(self._rig.stamp_to_middle * self._period_ns)

    def _note(self, line: str) -> None:
        """Add a line to `notes`, once, since the frames may be listed more than once."""
        if line not in self._lines:
            self._lines.append(line)

    def _match(
        self, places: Iterable[Place], *, limit: int | None, camera_only: bool
    ) -> tuple[ListedFrame, ...]:
        """List the frames of messages, see `list_places`."""
        listing = list_places(places, self._rig, limit=limit, camera_only=camera_only)
        self.stamps_ns, frames = listing.stamps_ns, listing.frames
        self.left_out.update(listing.left_out)
        scans_ns = [f.depth_stamp_ns for f in frames if f.depth_stamp_ns is not None]
        self._period_ns = period_ns_of(scans_ns, FIRST_SCAN_NS)
        return frames

    def has_lidar(self, frames: Iterable[ListedFrame]) -> bool:
        """Whether the recording has depth, in these frames of its list or in no frame."""
        has_messages = bool(self.stamps_ns.get(Sensor.DEPTH))
        return has_messages or any(each.depth is not None for each in frames)

    def close(self) -> None:  # noqa: B027 - most hold nothing open
        """Close open files. It may be called more than once."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def files_by_number(files: Mapping[str, Path]) -> dict[int, Path]:
    """Map the number at the end of each file's stem to the file. Raises InputError."""
    numbers: dict[int, Path] = {}
    are_times = contain_decimals(files)
    for stem, path in files.items():
        digits = re.search("[0-9]+$", stem)
        if digits is None or are_times:
            raise InputError(f"the name of {path} must end in the number of its frame, from 0 on")
        number = int(digits[0])
        if number in numbers:
            raise InputError(f"{numbers[number]} and {path} have the same number: remove one")
        numbers[number] = path
    return numbers


def pose_track(stamped: Iterable[tuple[int, NDArray[np.float64]]]) -> PoseTrack:
    """Return the track of poses in any order; of equal stamps the first counts.

    Raises InputError.
    """
    first: dict[int, NDArray[np.float64]] = {}
    for stamp_ns, pose in stamped:
        first.setdefault(stamp_ns, pose)
    stamps_ns = sorted(first)
    return PoseTrack.of([first[stamp_ns] for stamp_ns in stamps_ns], stamps_ns)
