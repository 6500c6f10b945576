"""A camera with a LiDAR or a depth camera in a bag of ROS 1 or ROS 2 or in an MCAP file."""

import contextlib
import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from runtime.base.checks import shown
from runtime.base.errors import InputError
from runtime.geometry.assumptions import assume, collect_assumptions
from runtime.geometry.calibration import Calibration
from runtime.geometry.motion import Scan
from runtime.geometry.point_cloud import to_points
from runtime.geometry.rig import DEFAULT_RIG, Rig
from runtime.recordings.ros_answers import SensorFrames
from runtime.recordings.ros_bag import RecordedMessage, RosBag
from runtime.recordings.ros_camera import (
    CAMERA_INFO,
    GIVE,
    SAME_PX,
    calibrate,
    place_sensors,
    projection_of,
)
from runtime.recordings.ros_messages import (
    decode_compressed_image,
    decode_depth_image,
    decode_image,
    decode_points,
)
from runtime.recordings.ros_poses import (
    TransformTree,
    frame_name,
    is_fixed,
    odometry_pose,
    odometry_poses,
    point_times_s,
    transform_poses,
)
from runtime.recordings.ros_topics import COMPRESSED_IMAGE, NO_TOPIC, POINT_CLOUD, RosTopics
from runtime.recordings.source import ListedFrame, Source, track_of
from runtime.streams.frame import MATCHED, Frame, Message, Outcome, Sensor
from runtime.streams.health.sensor_times import check_clocks

ODOMETRY = "nav_msgs/msg/Odometry"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_SUFFIXES = (".bag", ".db3", ".mcap")


class BagOptions(NamedTuple):
    """The options of a `BagSource`.

    Attributes:
        image_topic: topic of Image or CompressedImage messages; None: the bag has only one.
        depth_topic: topic of PointCloud2 messages, or of Image messages in 16UC1 or mono16 [mm] or
            32FC1 [m]; "none": only the camera is used; None: the only such topic, topics that
            `role_of` doubts not counted.
        info_topic: topic of CameraInfo messages; None: the one in the namespace of the images.
        rectified: whether the images are rectified; None: the CameraInfo and the name of the topic
            decide.
        registered: whether the pixels of depth images lie on those of the images; None: they do if
            both topics have one frame, with a warning if their CameraInfo differ. Depth images that
            are not registered are moved with their CameraInfo and /tf_static or the rig's
            calibration.
        pose_topic: topic of Odometry messages, or of TFMessage messages such as /tf, whose poses
            move clouds to the time of the image; "none": clouds are not moved; None: the only
            Odometry topic, else /tf, if there is one and /tf_static connects it to the LiDAR.
    """

    image_topic: str | None = None
    depth_topic: str | None = None
    info_topic: str | None = None
    rectified: bool | None = None
    registered: bool | None = None
    pose_topic: str | None = None


class BagSource(Source):
    """Images, and the point clouds or depth images that match the time stamps in their headers.

    A message without a stamp in its header counts with the time at which it was recorded. An image
    without depth takes older depth or becomes a frame of the camera alone. Depth without an image
    is left out. Listing the frames reads the bag once.

    Args:
        path: path of the bag, as `RosBag` takes it, or an open bag, which several cameras share.
        rig: the sensors of the car; a calibration in it replaces CameraInfo and /tf_static.
        **options: see `BagOptions`.

    Raises:
        InputError: if `rosbags` is not installed, if the bag is damaged, if a topic does not exist
            or must be chosen, or if clouds have no calibration.
    """

    is_stream = True
    accepted = f"a bag ({', '.join(_SUFFIXES)}, or a folder that holds metadata.yaml)"
    options = BagOptions._fields
    rig_options = ("calibration", "max_skew_ms", "reuse_depth_ms", "scan_stamp")

    def __init__(self, path: Path | RosBag, rig: Rig = DEFAULT_RIG, **options: Any) -> None:
        given = self._given = BagOptions(**options)
        self._rig = rig
        self._of_frames: dict[str, Calibration] = {}  # for scans, by their frames
        self._bag = path if isinstance(path, RosBag) else RosBag(path)
        path = self._bag.path
        self.folders = (path if os.path.isdir(path) else Path(os.path.realpath(path)).parent,)
        self.recordings = (path,)
        try:
            topics = self._bag_topics = RosTopics(self._bag)
            self._depth_camera: Calibration | None = None  # set if depth images are projected
            with collect_assumptions(self._notes):
                self._image_topic, self._depth_topic = topics.find(
                    given.image_topic, given.depth_topic
                )
                self._has_clouds = self._depth_topic in topics.of_kind(POINT_CLOUD)
                infos, beside = topics.of_kind(CAMERA_INFO), topics.infos_beside(self._image_topic)
                self._info_topic = topics.choose("info_topic", given.info_topic, infos, beside[:1])
                self.calibration = self._calibrate()
                self._pose_topic = self._find_poses()
            # Frames need these later, when a second reading would disturb the reader of an MCAP.
            for topic in filter(None, (self._image_topic, self._depth_topic)):
                with contextlib.suppress(InputError):  # no message may be decodable
                    self._frame(topic)
            _ = self._tree
        except BaseException:
            self.close()
            raise

    @classmethod
    def open_cameras(
        cls,
        path: Path,
        rig: Rig = DEFAULT_RIG,
        *,
        image_topic: str | None = None,
        **options: Any,
    ) -> dict[str, Source]:
        """Open a source for each of the topics that are joined by "+", all over one open bag."""
        topics = (image_topic or "").split("+")
        if len(topics) == 1:
            return super().open_cameras(path, rig, image_topic=image_topic, **options)
        if "info_topic" in options or rig.calibration is not None:
            raise InputError(
                "info_topic= and --calibration are of one camera, image_topic= names "
                f"{len(topics)}: leave them out, or run each camera by itself"
            )
        names = {topic.strip("/").replace("/", "-"): topic for topic in topics}
        if len(names) < len(topics):
            raise InputError(
                f"image_topic={image_topic} names a camera twice, or two whose folders would have "
                "one name: run each camera by itself"
            )
        bag = RosBag(path)
        return {name: cls(bag, rig, image_topic=topic, **options) for name, topic in names.items()}

    def _calibrate(self) -> Calibration | None:
        """The given calibration, or the one that CameraInfo and /tf_static describe."""
        image, depth = self._image_topic, self._depth_topic
        if depth is None or not (self._has_clouds or self._is_apart(depth)):
            if (given := self._rig.read_calibration()) is not None:
                return given
            with (
                contextlib.suppress(InputError),
                collect_assumptions([]),
            ):  # here the calibration only gives the focal length
                return self._camera(image)
            return None
        try:
            frame = self._frame(depth)
            if not self._has_clouds:
                self._depth_camera = self._camera(depth)
            elif frame in self._fixed_frames or is_fixed(frame):
                what = f"{depth} lies in the frame of the LiDAR, although {frame} is fixed and "
                assume(f"{what}the LiDAR moves in it", "choose the raw scans by depth_topic=")
            given = self._rig.read_calibration(for_scans=True)
            if given is None and not frame:
                raise InputError(f"the messages of {depth} name no frame: {GIVE}")
            return self._camera(image, frame) if given is None else given
        except InputError as error:
            if self._has_clouds:
                raise
            raise InputError(
                f"{depth} is of the frame {self._frame(depth)}, not of {self._frame(image)} as the "
                "images: choose a topic of aligned depth, or state registered=true in --source if "
                f"it lies on their pixels; it cannot be projected: {error}"
            ) from error

    def _is_apart(self, depth: str) -> bool:
        """Whether the pixels of depth images do not lie on those of the images."""
        if self._given.registered is not None:
            return not self._given.registered
        frames = self._frame(depth), self._frame(self._image_topic)
        if all(frames) and frames[0] != frames[1]:
            return True
        is_proved = all(frames)
        with contextlib.suppress(InputError), collect_assumptions([]):  # there may be no CameraInfo
            ours, its = self._camera(self._image_topic), self._camera(depth)
            is_near = np.abs(ours.intrinsics - its.intrinsics).max() < SAME_PX
            is_straight = ours.lens_model is not None and its.lens_model is None
            is_proved &= bool(is_near) and not is_straight
        if not is_proved:
            remedy = "state it with registered=true or false in --source"
            assume(f"{depth} lies on the pixels of the images", remedy)
        return False

    def _camera(self, topic: str, source: str = "") -> Calibration:
        """The calibration of a topic of images or depth images. Raises InputError.

        `source` is the frame of the points to be projected; "" stands for the frame of the images.
        """
        is_image = topic == self._image_topic
        info = (
            self._info_topic if is_image else next(iter(self._bag_topics.infos_beside(topic)), None)
        )
        if info is None:
            remedy = "give info_topic= in --source, or --calibration"
            raise InputError(f"{self._bag.path} has no CameraInfo beside {topic}: {remedy}")
        stated = self._given.rectified if is_image else None
        return calibrate(self._bag, self._tree, topic, info, source, stated)

    def _frame(self, topic: str) -> str:
        """The frame of the first message of a topic."""
        if topic not in self._first_frames:
            self._first_frames[topic] = frame_name(self._bag.first(topic).header.frame_id)
        return self._first_frames[topic]

    @cached_property
    def _first_frames(self) -> dict[str, str]:
        return {}

    @cached_property
    def _fixed_frames(self) -> set[str]:
        """The frames in which an Odometry message describes the motion of the car."""
        found = set()
        for topic in self._bag_topics.of_kind(ODOMETRY):
            with contextlib.suppress(InputError):
                found.add(self._frame(topic))
        return found

    def _calibration_of(self, depth: Any) -> Calibration | None:
        """The calibration for a message of depth: not all have the frame of the first message.

        Raises InputError if /tf_static does not connect the two frames, and if the message is a
        depth image.
        """
        topic, frame = self._depth_topic or "", frame_name(depth.header.frame_id)
        first, calibration = self._frame(topic), self.calibration
        if frame == first or calibration is None or self._given.registered:
            return calibration
        if frame not in self._of_frames:
            try:
                if not self._has_clouds:
                    raise InputError("each topic of depth images must be of one camera")
                move = self._tree.between(frame, first)
            except InputError as error:
                raise InputError(
                    f"a message of {topic} is of the frame {shown(frame)}, the first of "
                    f"{shown(first)}: {error}"
                ) from error
            body = calibration.body_from_lidar
            self._of_frames[frame] = replace(
                calibration,
                extrinsics=calibration.extrinsics @ move,
                body_from_lidar=None if body is None else body @ move,
            )
        return self._of_frames[frame]

    def _require_camera(self, image: Any) -> None:
        """Raise InputError for an image whose frame is not the frame of the calibration."""
        topic, frame = self._image_topic, frame_name(image.header.frame_id)
        if self.calibration is not None and frame not in ("", self._frame(topic)):
            raise InputError(
                f"an image of {topic} is of the frame {shown(frame)}, the first of "
                f"{shown(self._frame(topic))}: each topic of images must be of one camera"
            )

    @cached_property
    def sensor_frames(self) -> SensorFrames:
        """See `Source.sensor_frames`: the frames of the bag, with its /tf_static."""
        lidar = self._frame(self._depth_topic or "") if self._has_clouds else ""
        given = self.calibration if lidar else None
        is_own = self._rig.calibration is None
        return place_sensors(self._tree, self._frame(self._image_topic), lidar, given, is_own)

    @cached_property
    def _tree(self) -> TransformTree:
        topics = (
            topic for topic in self._bag_topics.of_kind(*TRANSFORMS) if topic.endswith("tf_static")
        )
        return TransformTree(chain.from_iterable(map(self._bag.decoded, topics)))

    def _find_poses(self) -> str | None:
        """Read the poses of the car if there are clouds to be moved, and return their topic.

        Raises InputError if the requested topic cannot be used.
        """
        odometry = self._bag_topics.of_kind(ODOMETRY)
        moving = [t for t in self._bag_topics.of_kind(*TRANSFORMS) if not t.endswith("tf_static")]
        if self._given.pose_topic == NO_TOPIC or not self._has_clouds:
            return None
        topic = self._bag_topics.choose(
            "pose_topic", self._given.pose_topic, odometry + moving, odometry or moving[:1]
        )
        if topic is None:
            if odometry:
                names = ", ".join(odometry)
                self._notes.append(f"no poses: choose one of {names} by pose_topic= in --source")
            return None
        try:
            lidar = self._frame(self._depth_topic or "")
            if topic in odometry:
                body, stamped = odometry_poses(self._bag.decoded(topic, odometry_pose))
            else:
                carriers = list(self._tree.ancestors(lidar))
                body, stamped = transform_poses(self._bag.decoded(topic), carriers)
            if self.calibration is not None and self.calibration.body_from_lidar is None:
                mount = self._tree.between(lidar, body)
                self.calibration = replace(self.calibration, body_from_lidar=mount)
            self._poses = track_of(stamped)
            return topic
        except InputError as error:
            if self._given.pose_topic is not None:
                raise
            self._notes.append(f"the poses of {topic} are not used: {error}")
            return None

    @staticmethod
    def accepts(path: Path) -> bool:
        """See `Source.accepts`."""
        is_file = path.suffix in _SUFFIXES and os.path.isfile(path)
        return is_file or os.path.isfile(path / "metadata.yaml")

    def list_frames(self, *, limit: int | None = None) -> tuple[ListedFrame, ...]:
        """See `Source.list_frames`."""
        self._left_out.clear()
        names: Counter[str] = Counter()
        cameras: list[list[float]] = []
        offsets: dict[Sensor, list[int]] = {sensor: [] for sensor in MATCHED}

        def stamped() -> Iterator[tuple[Sensor, int, int]]:
            """Yield (sensor, stamp, position in `_recorded`) for images and depth."""
            for place, message in self._recorded():
                if message.topic == self._info_topic:
                    with contextlib.suppress(InputError):  # the message is damaged
                        cameras.extend(projection_of(self._bag.decode(message)))
                    continue
                sensor = Sensor.IMAGE if message.topic == self._image_topic else Sensor.DEPTH
                stamp_ns = self._bag.stamp_ns(message)
                if stamp_ns is None:
                    self._left_out[f"{sensor}: {Outcome.BAD_STAMP}"] += 1
                    continue
                if stamp_ns:
                    offsets[sensor].append(stamp_ns - message.recorded_ns)
                yield sensor, stamp_ns or message.recorded_ns, place

        def name(image: Message) -> str:
            stamp = str(image.stamp_ns)
            names[stamp] += 1
            return stamp if names[stamp] == 1 else f"{stamp}-{names[stamp]}"  # played in a loop

        frames = self._match(
            stamped(),
            max_skew_ms=self._rig.max_skew_ms,
            limit=limit,
            camera_only=self._depth_topic is None,
            name=name,
        )
        self._left_out.update(self._bag.left_out)
        given = offsets[Sensor.IMAGE], offsets[Sensor.DEPTH], self._period_ns
        names = self._image_topic, self._depth_topic or ""
        with collect_assumptions(self._notes):
            check_clocks(*given, is_scan=self._has_clouds, names=names, by="recording")
        if cameras and self._rig.calibration is None and np.ptp(cameras, axis=0).max() > SAME_PX:
            with collect_assumptions(self._notes):
                assume(f"the first CameraInfo of {self._info_topic}, others differ", GIVE)
        if not frames:
            raise InputError(
                f"the topic {self._image_topic} of {self._bag.path} has no messages with a stamp"
            )
        # Maps the position of a message to the sequence of the last frame that needs it. `_kept`
        # holds messages that were read ahead and are needed later.
        self._owners = {place: f.sequence for f in frames for place in (f.image, f.depth)}
        self._kept: dict[int, RecordedMessage] = {}
        self._messages, self._next_place = self._recorded(), 0
        return frames

    def _recorded(self) -> Iterator[tuple[int, RecordedMessage]]:
        """Yield (position, message) for the topics that are read, in the same order each time."""
        topics = (self._image_topic, self._depth_topic, self._info_topic)
        return enumerate(self._bag.messages([topic for topic in topics if topic is not None]))

    def read(self, frame: ListedFrame) -> Frame:
        """See `Source.read`."""
        self._bag.guard.check()
        with self.collecting():
            return self._read(frame)

    def _read(self, frame: ListedFrame) -> Frame:
        messages = self._take(frame)
        image = self._bag.decode(messages[frame.image])
        is_compressed = self._bag.types[self._image_topic] == COMPRESSED_IMAGE
        self._require_camera(image)
        rgb = decode_compressed_image(image) if is_compressed else decode_image(image)
        depth: NDArray[np.float32] | Scan | None = None
        calibration = self.calibration
        if frame.depth is not None:
            message = self._bag.decode(messages[frame.depth])
            calibration = self._calibration_of(message)
            depth = self._decode_depth(frame, message)
        return self.measured(frame, rgb, depth, calibration)

    def _decode_depth(self, frame: ListedFrame, message: Any) -> NDArray[np.float32] | Scan:
        """The depth of a frame: a scan if it is a cloud or from another camera, else a map."""
        if self._has_clouds:
            points, after_s = decode_points(message), None
            if self._poses is not None and frame.depth_stamp_ns is not None:
                after_s = point_times_s(message, frame.depth_stamp_ns, points)
            return Scan.of(points, after_s, frame.depth_stamp_ns or 0)
        depth = decode_depth_image(message)
        if (camera := self._depth_camera) is None:
            return depth
        camera.require_size(depth.shape)
        return Scan.of(to_points(depth, camera.intrinsics, lens=camera.lens_model).points)

    def _take(self, frame: ListedFrame) -> dict[int, RecordedMessage]:
        """The messages of a frame by position; messages of later frames are read ahead and kept."""
        places = {place for place in (frame.image, frame.depth) if place is not None}
        missing = places - self._kept.keys()
        if missing and min(missing) < self._next_place:
            self._messages, self._next_place = self._recorded(), 0
        while not places <= self._kept.keys():
            place, message = next(self._messages, (-1, None))
            if message is None:
                raise InputError(f"{self._bag.path} ends before {frame.name}: was it replaced?")
            self._next_place = place + 1
            if self._owners.get(place, -1) >= frame.sequence:
                self._kept[place] = message
        taken = {place: self._kept[place] for place in places}
        # A scan may serve later images as well.
        kept = self._kept.items()
        self._kept = {place: each for place, each in kept if self._owners[place] > frame.sequence}
        return taken

    @property
    def _topics(self) -> dict[str, str | None]:
        return {
            "image_topic": self._image_topic,
            "depth_topic": self._depth_topic,
            "info_topic": self._info_topic,
            "pose_topic": self._pose_topic,
        }

    @property
    def inputs(self) -> dict[str, Any]:
        """See `Source.inputs`."""
        given = {"bag": str(self._bag.path), **self._given._asdict(), **self._topics}
        given |= {**self._rig_facts, "reuse_depth_ms": self._rig.oldest_depth_ms}
        return given | {"left_out": dict(self._left_out)}

    @property
    def transform_frames(self) -> tuple[str, str]:
        """See `Source.transform_frames`."""
        return self._frame(self._image_topic), self._frame(self._depth_topic or self._image_topic)

    @property
    def lidar_position(self) -> NDArray[np.float64] | None:
        """See `Source.lidar_position`: as in /tf_static, without the baseline of a stereo pair."""
        if self._rig.calibration is not None or not self._has_clouds:
            return super().lidar_position
        camera, lidar = self.transform_frames
        return self._tree.between(lidar, camera)[:3, 3]

    @property
    def notes(self) -> tuple[str, ...]:
        """See `Source.notes`."""
        topics = ", ".join(f"{name}={topic}" for name, topic in self._topics.items() if topic)
        return (f"topics: {topics}", *super().notes)

    def close(self) -> None:
        """See `Source.close`."""
        self._bag.close()
