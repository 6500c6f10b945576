"""A camera and a LiDAR or depth camera in a bag of ROS 1 or ROS 2 or an MCAP file."""

import contextlib
import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from runtime.errors import InputError
from runtime.io.calibration import Calibration
from runtime.sources.frames import Frame
from runtime.sources.recorded_motion import (
    RecordedPoses,
    frame_of,
    left_out_note,
    match_frames,
    project_listed,
    track_of,
)
from runtime.sources.ros_bag import RecordedMessage, RosBag
from runtime.sources.ros_messages import (
    decode_compressed_image,
    decode_depth_image,
    decode_image,
    decode_points,
    is_depth_encoding,
)
from runtime.sources.ros_poses import odometry_poses, point_times_ns, transform_poses
from runtime.sources.ros_transforms import TransformTree
from runtime.sources.source import ListedFrame, Source
from runtime.sync.matching import Pair
from runtime.sync.motion import ScanStamp
from runtime.sync.outcome import Outcome, Sensor
from runtime.sync.poses import PoseFrame
from runtime.sync.stamp import DEFAULT_MAX_SKEW_MS, DEFAULT_REUSE_DEPTH_MS

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
ODOMETRY = "nav_msgs/msg/Odometry"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
#: As depth_topic: the camera alone.
NO_TOPIC = "none"


#: Words, between / and _, of the names of topics of rectified images.
_RECTIFIED = {"rect", "rectified"}
_SUFFIXES = (".bag", ".db3", ".mcap")


class BagSource(Source):
    """Images and, matched by the time stamps in their headers, point clouds or depth images.

    A header without a stamp counts with the time at which it was recorded. An image without depth
    takes an older one, or is a frame of the camera alone; depth without an image is left out.
    Listing reads the bag once.

    Args:
        path: as `RosBag`, or an open one, which sources of other cameras read, too.
        image_topic: of Image or CompressedImage; None: the only one.
        depth_topic: of PointCloud2, or of Image in 16UC1 [mm] or 32FC1 [m] of the image's size;
            "none": the camera alone; None: the only one.
        info_topic: of CameraInfo; None: the one beside the images.
        calibration: as `Calibration.from_file`, in place of CameraInfo and /tf_static.
        max_skew_ms: largest difference of the time stamps of an image and its depth.
        reuse_depth_ms: largest age of the depth that an image without depth of its own takes.
        scan_stamp: what instant of a scan its time stamp is.
        pose_topic: of Odometry, or of TFMessage such as /tf, by which clouds are moved to the time
            of the image; "none": they are not; None: the only Odometry, else /tf, if there are any
            and /tf_static connects them to the LiDAR.

    Raises:
        InputError: if `rosbags` is not installed, the bag is damaged, a topic does not exist or
            must be chosen, or clouds have no calibration.
    """

    accepted = f"a bag ({', '.join(_SUFFIXES)}, or a folder that holds metadata.yaml)"

    def __init__(
        self,
        path: Path | RosBag,
        *,
        image_topic: str | None = None,
        depth_topic: str | None = None,
        info_topic: str | None = None,
        calibration: Path | None = None,
        max_skew_ms: float = DEFAULT_MAX_SKEW_MS,
        reuse_depth_ms: float = DEFAULT_REUSE_DEPTH_MS,
        scan_stamp: ScanStamp = "middle",
        pose_topic: str | None = None,
    ) -> None:
        self._max_skew_ms, self._calibration_path = max_skew_ms, calibration
        self._reuse_depth_ms, self._scan_stamp = reuse_depth_ms, scan_stamp
        self._pose_topic: str | None = None
        self._unused_poses = ""
        self._bag = path if isinstance(path, RosBag) else RosBag(path)
        path = self._bag.path
        self.folders = (path if os.path.isdir(path) else Path(os.path.realpath(path)).parent,)
        self.recordings = (path,)
        self._left_out: Counter[str] = Counter()
        self._guessed: list[str] = []
        try:
            self._image_topic, self._depth_topic = self._find_topics(image_topic, depth_topic)
            self._info_topic = self._find_info(info_topic)
            self.calibration = self._calibrate()
            self._poses = self._find_poses(pose_topic)
        except BaseException:
            self.close()
            raise
        # Position of a message in the bag -> its frame; messages read ahead of their frame.
        self._owners: dict[int, int] = {}
        self._kept: dict[int, RecordedMessage] = {}
        self._messages: Iterator[RecordedMessage] = iter(())
        self._next_place = 0

    @classmethod
    def open_cameras(
        cls, path: Path, *, image_topic: str | None = None, **options: Any
    ) -> dict[str, Source]:
        """Open a source for each of the topics that are joined by +, over one open bag."""
        topics = (image_topic or "").split("+")
        if len(topics) == 1:
            return super().open_cameras(path, image_topic=image_topic, **options)
        if "info_topic" in options or "calibration" in options:
            raise InputError(
                "info_topic= and --calibration are of one camera, image_topic= names "
                f"{len(topics)}: leave them out, or run each camera by itself"
            )
        bag = RosBag(path)
        return {
            topic.strip("/").replace("/", "-"): cls(bag, image_topic=topic, **options)
            for topic in topics
        }

    # --- what is in the bag ----------------------------------------------------------------------

    def _find_topics(
        self, image_topic: str | None, depth_topic: str | None
    ) -> tuple[str, str | None]:
        """The topics of images and of depth, as requested or guessed."""
        images, depths = [], []
        for topic, kind in self._bag.types.items():
            if kind == POINT_CLOUD:
                depths.append(topic)
            elif kind == COMPRESSED_IMAGE and not topic.endswith("/compressedDepth"):
                images.append(topic)
            elif kind == IMAGE:
                for message in self._bag.decoded(topic):
                    (depths if is_depth_encoding(message.encoding) else images).append(topic)
                    break
        twice = {f"{topic}/compressed" for topic in images}  # compressed copies of the same images
        image = self._choose(
            "image_topic", image_topic, images, [t for t in images if t not in twice]
        )
        if depth_topic == NO_TOPIC:
            return image, None
        return image, self._choose("depth_topic", depth_topic, depths, depths)

    def _choose(
        self, name: str, requested: str | None, fitting: list[str], candidates: list[str]
    ) -> str:
        """The requested topic, or the only candidate. Raises InputError."""
        if requested is not None and requested in fitting:
            return requested
        if requested is None and len(candidates) == 1:
            self._guessed.append(f"{name.replace('_', ' ')} {candidates[0]}")
            return candidates[0]
        what = "images" if name == "image_topic" else "point clouds or depth images"
        path = self._bag.path
        remedy = f"--source bag:{path},{name}="
        if requested is not None:
            problem = f"{name}={requested} is not a topic of {what} in {path}"
        elif candidates:
            problem = f"{path} has {len(candidates)} topics of {what}, choose one by {remedy}TOPIC"
            if name == "image_topic":
                problem += ", or several, TOPIC+TOPIC"
        else:
            problem = f"{path} has no topic of {what}"
            if name == "depth_topic":
                problem += f"; for the camera alone give {remedy}{NO_TOPIC}"
        topics = ", ".join(f"{topic} ({kind})" for topic, kind in sorted(self._bag.types.items()))
        raise InputError(f"{problem}. It has the topics {topics or '(none)'}")

    def _find_info(self, requested: str | None) -> str | None:
        """The topic of the camera's CameraInfo; None if there is none beside the images."""
        infos = [topic for topic, kind in self._bag.types.items() if kind == CAMERA_INFO]
        if requested is not None:
            if requested not in infos:
                raise InputError(
                    f"info_topic={requested} is not a topic of CameraInfo in {self._bag.path}, "
                    f"it has {', '.join(infos) or 'none'}"
                )
            return requested
        namespace = self._image_topic
        while namespace:
            namespace = namespace.rpartition("/")[0]
            if f"{namespace}/camera_info" in infos:
                return f"{namespace}/camera_info"
        return None

    def _calibrate(self) -> Calibration | None:
        """The given calibration, or that of CameraInfo and /tf_static."""
        if self._calibration_path is not None:
            return Calibration.from_file(self._calibration_path)
        info = None if self._info_topic is None else self._first(self._info_topic)
        rectified = not _RECTIFIED.isdisjoint(re.split("[/_]", self._image_topic.lower()))
        if self._depth_topic is None or self._bag.types[self._depth_topic] != POINT_CLOUD:
            # Depth images need no projection: only the focal length and clouds need a calibration.
            with contextlib.suppress(InputError):
                if info is not None:
                    fields = _fields(info)
                    return Calibration.from_camera_info(fields, _EYE, rectified=rectified)
            return None
        if info is None:
            raise InputError(
                f"{self._bag.path} has no CameraInfo beside {self._image_topic} to project "
                f"{self._depth_topic} with: give info_topic= in --source, or --calibration"
            )
        camera = self._first(self._image_topic).header.frame_id or info.header.frame_id
        lidar = self._first(self._depth_topic).header.frame_id
        extrinsics = self._tree.between(lidar, camera)
        try:
            found = Calibration.from_camera_info(_fields(info), extrinsics, rectified=rectified)
        except InputError as error:
            raise InputError(
                f"the CameraInfo of {self._info_topic}: {error}; or give --calibration"
            ) from error
        if found.lens is not None:
            self._guessed.append(f"{self._image_topic} is not rectified, by its name")
        return found

    @cached_property
    def _tree(self) -> TransformTree:
        return TransformTree(
            message
            for topic, kind in self._bag.types.items()
            if kind in TRANSFORMS and topic.endswith("tf_static")
            for message in self._bag.decoded(topic)
        )

    def _find_poses(self, requested: str | None) -> RecordedPoses | None:
        """The poses of the car, where clouds can be moved by them. Raises InputError."""
        is_cloud = self._depth_topic and self._bag.types[self._depth_topic] == POINT_CLOUD
        if not is_cloud or requested == NO_TOPIC:
            return None
        types = self._bag.types.items()
        odometry = [topic for topic, kind in types if kind == ODOMETRY]
        moving = [t for t, kind in types if kind in TRANSFORMS and not t.endswith("tf_static")]
        if requested is not None and requested not in odometry + moving:
            topics = ", ".join(sorted(odometry + moving)) or "none"
            raise InputError(
                f"pose_topic={requested} is no topic of Odometry or transforms in "
                f"{self._bag.path}, it has {topics}"
            )
        if requested is None and len(odometry) > 1:
            names = ", ".join(sorted(odometry))
            self._unused_poses = (
                f"poses are not used: choose one of {names} by pose_topic= in --source"
            )
            return None
        topic = requested or next(iter(odometry + moving), None)
        if topic is None:
            return None
        try:
            poses = self._read_poses(topic, is_odometry=topic in odometry)
        except InputError as error:
            if requested is not None:
                raise
            self._unused_poses = f"the poses of {topic} are not used: {error}"
            return None
        if requested is None:
            self._guessed.append(f"pose topic {topic}")
        self._pose_topic = topic
        return poses

    def _read_poses(self, topic: str, *, is_odometry: bool) -> RecordedPoses:
        assert self._depth_topic is not None
        lidar = self._first(self._depth_topic).header.frame_id
        if is_odometry:
            body, stamped = odometry_poses(self._bag.decoded(topic))
        else:
            body, stamped = transform_poses(self._bag.decoded(topic), self._tree.carriers(lidar))
        mount = None
        if self.calibration is None or self.calibration.body_from_lidar is None:
            mount = self._tree.between(lidar, body)
        return RecordedPoses(track_of(stamped), PoseFrame.BODY, mount)

    def _first(self, topic: str) -> Any:
        """The first message of a topic. Raises InputError if there is none."""
        for message in self._bag.decoded(topic):
            return message
        raise InputError(f"the topic {topic} of {self._bag.path} has no messages")

    @staticmethod
    def accepts(path: Path) -> bool:
        """See `Source.accepts`."""
        is_file = path.suffix in _SUFFIXES and os.path.isfile(path)
        return is_file or os.path.isfile(path / "metadata.yaml")

    # --- its frames ------------------------------------------------------------------------------

    def list_frames(self, *, limit: int | None = None) -> tuple[ListedFrame, ...]:
        """See `Source.list_frames`."""
        self._left_out.clear()
        frames = self._match(limit)
        if not frames:
            raise InputError(
                f"the topic {self._image_topic} of {self._bag.path} has no messages with a stamp"
            )
        self._owners = {
            place: frame.sequence
            for frame in frames
            for place in (frame.image, frame.depth)
            if place is not None
        }
        return frames

    def _match(self, limit: int | None) -> tuple[ListedFrame, ...]:
        """The frames, with the positions of their two messages among those of both topics."""

        def stamped() -> Iterator[tuple[Sensor, int, int]]:
            for place, message in enumerate(self._recorded()):
                sensor = Sensor.IMAGE if message.topic == self._image_topic else Sensor.DEPTH
                stamp_ns = self._bag.stamp_ns(message)
                if stamp_ns is None:
                    self._left_out[f"{sensor}: {Outcome.BAD_STAMP}"] += 1
                else:
                    yield sensor, stamp_ns or message.recorded_ns, place
            for topic, count in self._bag.lost.items():
                sensor = Sensor.IMAGE if topic == self._image_topic else Sensor.DEPTH
                self._left_out[f"{sensor}: listed in the index, but missing"] += count

        names: Counter[str] = Counter()

        def name(pair: Pair) -> str:
            stamp = str(pair.image.stamp_ns)
            names[stamp] += 1
            return stamp if names[stamp] == 1 else f"{stamp}-{names[stamp]}"  # looped recording

        return match_frames(
            stamped(),
            max_skew_ms=self._max_skew_ms,
            reuse_depth_ms=self._reuse_depth_ms,
            scan_stamp=self._scan_stamp,
            left_out=self._left_out,
            name=name,
            limit=limit,
            camera_only=self._depth_topic is None,
        )

    def _recorded(self) -> Iterator[RecordedMessage]:
        """The messages of both topics, in the same order each time."""
        topics = (self._image_topic, self._depth_topic)
        return self._bag.messages([topic for topic in topics if topic is not None])

    def read(self, frame: ListedFrame) -> Frame:
        """See `Source.read`."""
        messages = self._take(frame)
        image = self._bag.decode(messages[frame.image])
        is_compressed = self._bag.types[self._image_topic] == COMPRESSED_IMAGE
        rgb = decode_compressed_image(image) if is_compressed else decode_image(image)
        recorded = None if frame.depth is None else messages[frame.depth]
        has_map = recorded is not None and self._bag.types[recorded.topic] != POINT_CLOUD
        rgb, calibration = self._rectified(rgb, self.calibration, has_map=has_map)
        if recorded is None:
            return frame_of(frame, rgb, None, calibration)
        message, size = self._bag.decode(recorded), (rgb.shape[0], rgb.shape[1])
        if has_map:
            return frame_of(frame, rgb, decode_depth_image(message), calibration)
        assert calibration is not None  # see `_calibrate`
        times = None
        if self._poses is not None and frame.depth_stamp_ns is not None:
            times = point_times_ns(message, frame.depth_stamp_ns)
        points = decode_points(message)
        moved = project_listed(frame, calibration, points, times, self._poses, size)
        return frame_of(frame, rgb, moved, calibration)

    def _take(self, frame: ListedFrame) -> dict[int, RecordedMessage]:
        """The messages of a frame by position; messages of later frames are read ahead and kept."""

        def is_wanted(place: int) -> bool:
            return self._owners.get(place, -1) >= frame.sequence

        places = {place for place in (frame.image, frame.depth) if place is not None}
        self._kept = {place: kept for place, kept in self._kept.items() if is_wanted(place)}
        missing = places - self._kept.keys()
        if missing and min(missing) < self._next_place:
            self._next_place = 0
        if self._next_place == 0:
            self._messages = self._recorded()
        while missing:
            message = next(self._messages, None)
            if message is None:
                raise InputError(f"{self._bag.path} ends before {frame.name}: was it replaced?")
            if is_wanted(self._next_place):
                self._kept[self._next_place] = message
            missing.discard(self._next_place)
            self._next_place += 1
        taken = {place: self._kept[place] for place in places}
        for place in places:
            if self._owners[place] <= frame.sequence:  # a scan may serve later images, too
                del self._kept[place]
        return taken

    @property
    def inputs(self) -> dict[str, Any]:
        """See `Source.inputs`."""
        calibration = self._calibration_path
        return {
            "bag": str(self._bag.path),
            "image_topic": self._image_topic,
            "depth_topic": self._depth_topic,
            "info_topic": self._info_topic,
            "calibration": None if calibration is None else str(calibration),
            "max_skew_ms": self._max_skew_ms,
            "reuse_depth_ms": self._reuse_depth_ms,
            "pose_topic": self._pose_topic,
            "left_out": dict(self._left_out),
        }

    @property
    def notes(self) -> tuple[str, ...]:
        """See `Source.notes`."""
        guessed = (f"guessed: {', '.join(self._guessed)}",) if self._guessed else ()
        unused = (self._unused_poses,) if self._unused_poses else ()
        return guessed + unused + left_out_note(self._left_out)

    def close(self) -> None:
        """See `Source.close`."""
        self._bag.close()


_EYE = np.eye(4)


def _fields(info: Any) -> Mapping[str, Any]:
    """The fields of a CameraInfo; ROS 1 has them in capitals."""
    names = ("height", "width", "distortion_model", "D", "K", "P", "d", "k", "p")
    return {name.lower(): getattr(info, name) for name in names if hasattr(info, name)}
