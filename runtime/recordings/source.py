"""The interface of every source of frames: it lists its frames and reads each of them."""

import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from runtime.base.errors import InputError
from runtime.base.natural_order import contain_decimals, normal_form
from runtime.checks.sensor_times import period_ns_of
from runtime.geometry.assumptions import collect_assumptions
from runtime.geometry.calibration import Calibration
from runtime.geometry.motion import (
    FIRST_SCAN_NS,
    assume_middle,
    lidar_mount,
)
from runtime.geometry.poses import PoseFrame, PoseTrack
from runtime.geometry.returns import check_farthest
from runtime.geometry.rig import DEFAULT_RIG, Rig
from runtime.recordings.ros_answers import FixedTransform, SensorFrames
from runtime.streams.frame import Frame
from runtime.streams.matching import Pair, RecordingMatcher
from runtime.streams.messages import MATCHED, Depth, Image, Place, Scan, Sensor

_WAITING = 64  # messages of a sensor that wait for the other one, which may be recorded later


@dataclass(frozen=True)
class ListedFrame:
    """A frame that a source has not read yet.

    Attributes:
        sequence: index in the source, from 0.
        name: name of the frame and of its output files, unique in the source.
        image: where the source finds the image (a path, an index, ...); None if there is no image.
        depth: where the source finds the depth; None if there is no depth.
        image_stamp_ns: time of the image by its sensor's clock [ns]; None if unknown.
        depth_stamp_ns: time of the depth by its sensor's clock [ns]; None if unknown.
        complete: whether the frame has an image and depth of its own, or only an image if the
            source reads no depth.
        reused: whether the depth is an older scan, because the image has none of its own.
    """

    sequence: int
    name: str
    image: Any
    depth: Any
    image_stamp_ns: int | None = None
    depth_stamp_ns: int | None = None
    complete: bool = True
    reused: bool = False


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
    options: ClassVar[tuple[str, ...]] = ()
    rig_options: ClassVar[tuple[str, ...]] = ()
    is_stream: ClassVar[bool] = False
    calibration: Calibration | None = None
    depth_scale: float | None = None
    stamps_ns: Mapping[Sensor, Sequence[int]] = MappingProxyType({})
    folders: tuple[Path, ...] = ()
    recordings: tuple[Path, ...] = ()
    # For sources with stamps and poses:
    _rig = DEFAULT_RIG
    _period_ns = float(FIRST_SCAN_NS)  # period of the scans
    _to_middle_ns = 0  # from the stamp of a scan to its middle
    _poses: PoseTrack | None = None
    _pose_frame = PoseFrame.BODY
    _rectify = False

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
        self._rectify = True

    def collecting(self) -> AbstractContextManager[None]:
        """Collect the assumptions that this thread makes inside a block in `notes`."""
        return collect_assumptions(self._notes)

    def measured(
        self,
        frame: ListedFrame,
        rgb: NDArray[np.uint8],
        depth: NDArray[np.float32] | Depth | Scan | None = None,
        calibration: Calibration | None = None,
    ) -> Frame:
        """Return a frame with what its sensors measured, the depth projected into the image.

        Args:
            frame: a frame of the list.
            rgb: uint8 (H, W, 3), RGB.
            depth: a depth map, float32 (H, W) in metres, 0 where there is no return; or a scan,
                whose points have times only if these are known.
            calibration: calibration of the camera, for a scan also of the LiDAR.

        Raises:
            InputError: if the calibration is for images of another size, which would silently
                falsify clouds and the focal length; and for a depth map after `rectify_images`.
        """
        poses = None
        if isinstance(depth, np.ndarray):
            check_farthest(depth)
            depth = Depth(depth)
        if calibration is not None:
            calibration.require_size(rgb.shape[:2])
            if self._rectify:
                if isinstance(depth, Depth):
                    raise InputError(
                        "a depth map lies on the pixels of the distorted image: no --rectify"
                    )
                rgb, calibration = calibration.rectify(rgb), calibration.rectified
            if self._poses is not None:
                poses = self._poses.mounted(lidar_mount(self._pose_frame, calibration))
        if depth is not None:
            depth = replace(depth, stamp_ns=frame.depth_stamp_ns)
        if isinstance(depth, Scan) and depth.times is None and depth.stamp_ns is not None:
            depth = replace(depth, times=depth.stamp_ns + self._to_middle_ns)
            is_moved = poses is not None and frame.depth_stamp_ns != frame.image_stamp_ns
            if is_moved and self._rig.scan_stamp is None:
                with collect_assumptions(self._notes):
                    assume_middle("in --source")
        image = Image(rgb, stamp_ns=frame.image_stamp_ns)
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
        return (*self._notes, *left_out_note(self._left_out))

    @property
    def sensor_frames(self) -> SensorFrames:
        """The frames of the sensors in the terms of ROS, with invented names for other formats."""
        if self.calibration is None:
            return SensorFrames()
        place = FixedTransform.of("camera", "lidar", self.calibration.extrinsics)
        return SensorFrames("camera", (place,), "the calibration")

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

    @property
    def left_out(self) -> Mapping[str, int]:
        """Counts of what is in no frame, such as "image: duplicate"; known after listing."""
        return self._left_out

    @cached_property
    def _notes(self) -> list[str]:
        return []

    @cached_property
    def _left_out(self) -> Counter[str]:
        return Counter()

    def _match(
        self,
        places: Iterable[Place],
        *,
        max_skew_ms: float,
        limit: int | None,
        camera_only: bool,
        name: Callable[[Place], str] = lambda image: normal_form(Path(str(image.at)).stem),
    ) -> tuple[ListedFrame, ...]:
        """List the frames of messages, see `RecordingMatcher`.

        Args:
            places: the messages in the order of the recording.
            max_skew_ms: largest difference between the stamps of a pair.
            limit: see `list_frames`.
            camera_only: whether the recording has no depth, so that an image alone is complete.
            name: returns the name of an image's frame; the default is for data that are paths.

        Raises:
            InputError: in the cases of `RecordingMatcher`.
        """
        matching = RecordingMatcher[Place](
            max_skew_ms=max_skew_ms, reuse_depth_ms=self._rig.max_depth_age_ms, capacity=_WAITING
        )
        stamps_ns: dict[Sensor, list[int]] = {sensor: [] for sensor in MATCHED}
        self.stamps_ns = stamps_ns

        def stamped() -> Iterator[Place]:
            for place in places:
                stamps_ns[place.sensor].append(place.stamp_ns)
                yield place

        def matched() -> Iterator[Pair[Place]]:
            for decided in matching.match(stamped()):
                self._left_out.update(f"{gone.sensor}: {why}" for gone, why in decided.discarded)
                yield from decided.pairs

        def listed() -> Iterator[ListedFrame]:
            for sequence, (image, depth, reused) in enumerate(matched()):
                identity = sequence, name(image), image.at
                if depth is None:
                    yield ListedFrame(*identity, None, image.stamp_ns, complete=camera_only)
                else:
                    stamps_ns, own = (image.stamp_ns, depth.stamp_ns), not reused
                    yield ListedFrame(*identity, depth.at, *stamps_ns, own, reused)

        frames = limit_frames(listed(), limit)
        scans_ns = [f.depth_stamp_ns for f in frames if f.depth_stamp_ns is not None]
        self._period_ns = period_ns_of(scans_ns, FIRST_SCAN_NS)
        self._to_middle_ns = round(self._rig.stamp_to_middle * self._period_ns)
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


def limit_frames(frames: Iterable[ListedFrame], limit: int | None) -> tuple[ListedFrame, ...]:
    """The frames up to the `limit`-th complete one."""
    listed: list[ListedFrame] = []
    complete = 0
    for frame in frames:
        listed.append(frame)
        complete += frame.complete
        if complete == limit:
            break
    return tuple(listed)


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


def left_out_note(left_out: Mapping[str, int]) -> tuple[str, ...]:
    """One line with the counts of what is in no frame, or no line if there is nothing."""
    counts = ", ".join(f"{reason} {count}" for reason, count in sorted(left_out.items()))
    return (f"left out: {counts}",) if counts else ()


def pose_track(stamped: Iterable[tuple[int, NDArray[np.float64]]]) -> PoseTrack:
    """Return the track of poses in any order; of equal stamps the first counts.

    Raises InputError.
    """
    first: dict[int, NDArray[np.float64]] = {}
    for stamp_ns, pose in stamped:
        first.setdefault(stamp_ns, pose)
    stamps_ns = sorted(first)
    return PoseTrack.of([first[stamp_ns] for stamp_ns in stamps_ns], stamps_ns)
