"""A camera with a LiDAR or a depth camera in a bag of ROS 1 or ROS 2 or in an MCAP file."""

import contextlib
import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.base.errors import InputError
from runtime.checks.sensor_times import clocks_apart_s, report_clocks
from runtime.geometry.assumptions import assume
from runtime.geometry.odometry import ODOMETRY as FROM_SCANS
from runtime.geometry.odometry import Odometry
from runtime.geometry.point_cloud import depth_to_cloud
from runtime.geometry.poses import PoseFrame
from runtime.geometry.rig import DEFAULT_RIG, Rig
from runtime.recordings.bag_messages import BagMessages
from runtime.recordings.bag_sensors import ODOMETRY, TRANSFORMS, BagOptions, BagSensors
from runtime.recordings.listing import ListedFrame
from runtime.recordings.ros_answers import SensorFrames
from runtime.recordings.ros_bag import RosBag
from runtime.recordings.ros_camera import GIVE, SAME_PX, projection_of
from runtime.recordings.ros_messages import (
    decode_compressed_image,
    decode_depth_image,
    decode_image,
    decode_points,
)
from runtime.recordings.ros_poses import (
    odometry_pose,
    odometry_poses,
    point_times_s,
    transform_poses,
)
from runtime.recordings.ros_topics import COMPRESSED_IMAGE, NO_TOPIC, choose_topic
from runtime.recordings.source import Source, pose_track
from runtime.streams.frame import Frame
from runtime.streams.messages import MATCHED, Outcome, Place, Scan, Sensor

_SUFFIXES = (".bag", ".db3", ".mcap")


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
        self._bag = path if isinstance(path, RosBag) else RosBag(path)
        path = self._bag.path
        self.folders = (path if os.path.isdir(path) else Path(os.path.realpath(path)).parent,)
        self.recordings = (path,)
        try:
            with self.collecting():
                self._sensors = BagSensors(self._bag, given, rig)
                self._image_topic, self._depth_topic = self._sensors.topics
                self.calibration = self._sensors.read_calibration()
                self._pose_topic = self._find_poses()
            self._sensors.read_frames()
            read = *self._sensors.topics, self._sensors.info_topic
            self._messages = BagMessages(self._bag, [each for each in read if each is not None])
        except BaseException:
            self._bag.close()
            raise

    @classmethod
    def open_cameras(
        cls, path: Path, rig: Rig = DEFAULT_RIG, *, image_topic: str | None = None, **options: Any
    ) -> dict[str, Source]:
        """Open a source for each of the topics that are joined by "+", all over one open bag."""
        topics = (image_topic or "").split("+")
        if len(topics) == 1:
            return super().open_cameras(path, rig, image_topic=image_topic, **options)
        if "info_topic" in options or rig.calibration is not None:
            raise InputError(
                "`info_topic=` and `calibration=` describe one camera, but `image_topic=` names "
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

    @cached_property
    def sensor_frames(self) -> SensorFrames:
        """See `Source.sensor_frames`: the frames of the bag, with its /tf_static."""
        return self._sensors.place(self.calibration)

    def _find_poses(self) -> str | None:
        """Read the poses of the car if there are clouds to be moved, and return their topic.

        Raises InputError if the requested topic cannot be used.
        """
        bag, requested = self._bag, self._given.pose_topic
        odometry = bag.of_kind(ODOMETRY)
        moving = [t for t in bag.of_kind(*TRANSFORMS) if not t.endswith("tf_static")]
        if requested == NO_TOPIC or not self._sensors.has_clouds:
            return None
        if requested == FROM_SCANS:
            Odometry()  # raises if its package is missing
            self._pose_frame = PoseFrame.LIDAR
            self._note("poses by odometry: those of the bag, if any, are not used")
            return requested
        fitting, guesses = odometry + moving, odometry or moving[:1]
        topic = choose_topic(bag, "pose_topic", requested, fitting, guesses)
        if topic is None:
            if odometry:
                names = ", ".join(odometry)
                self._note(f"no poses: choose one of {names} by `pose_topic=`")
            return None
        try:
            lidar = self._sensors.frame(self._depth_topic or "")
            if topic in odometry:
                body, stamped = odometry_poses(bag.decoded(topic, odometry_pose))
            else:
                carriers = list(self._sensors.tree.ancestors(lidar))
                body, stamped = transform_poses(bag.decoded(topic), carriers)
            if self.calibration is not None and self.calibration.body_from_lidar is None:
                mount = self._sensors.tree.between(lidar, body)
                self.calibration = replace(self.calibration, body_from_lidar=mount)
            self._poses = pose_track(stamped)
            return topic
        except InputError as error:
            if requested is not None:
                raise
            self._note(f"the poses of {topic} are not used: {error}")
            return None

    @staticmethod
    def accepts(path: Path) -> bool:
        """See `Source.accepts`."""
        is_file = path.suffix.lower() in _SUFFIXES and os.path.isfile(path)
        return is_file or os.path.isfile(path / "metadata.yaml")

    def list_frames(self, *, limit: int | None = None) -> tuple[ListedFrame, ...]:
        """See `Source.list_frames`."""
        self.left_out.clear()
        cameras: list[list[float]] = []
        offsets: dict[Sensor, list[int]] = {sensor: [] for sensor in MATCHED}
        unstamped: Counter[str] = Counter()

        def stamped() -> Iterator[Place]:
            """Yield the position among the messages of each image and depth."""
            for place, message in self._messages:
                if message.topic == self._sensors.info_topic:
                    with contextlib.suppress(InputError):  # the message is damaged
                        cameras.extend(projection_of(self._bag.decode(message)))
                    continue
                sensor = Sensor.IMAGE if message.topic == self._image_topic else Sensor.DEPTH
                stamp_ns = self._bag.stamp_ns(message)
                if stamp_ns is None:
                    self.left_out[f"{sensor}: {Outcome.BAD_STAMP}"] += 1
                    continue
                if stamp_ns:
                    offsets[sensor].append(stamp_ns - message.recorded_ns)
                else:
                    unstamped[message.topic] += 1
                yield Place(sensor, place, stamp_ns or message.recorded_ns)

        frames = self._match(stamped(), limit=limit, camera_only=self._depth_topic is None)
        if self._pose_topic == FROM_SCANS:
            self._poses = pose_track(self._poses_of_scans())
        self.left_out.update(self._bag.left_out)
        clocks = offsets[Sensor.IMAGE], offsets[Sensor.DEPTH], self._period_ns
        ahead_s = clocks_apart_s(*clocks, is_scan=self._sensors.has_clouds)
        # The first stamp of a simulator is 0.
        topics = [topic for topic, count in unstamped.items() if count > 1]
        is_own = cameras and self._rig.calibration is None
        with self.collecting():
            if topics and self._depth_topic is not None:
                assume(
                    f"the times at which messages of {', '.join(topics)} were recorded, since "
                    "their headers have no stamps",
                    "let the driver stamp them, since depth is moved by the delay of recording",
                )
            report_clocks(ahead_s, self._image_topic, self._depth_topic or "", by="recording")
            if is_own and np.ptp(cameras, axis=0).max() > SAME_PX:
                assume(f"the first CameraInfo of {self._sensors.info_topic}, others differ", GIVE)
        if not frames:
            raise InputError(
                f"the topic {self._image_topic} of {self._bag.path} has no messages with a stamp"
            )
        self._messages.expect(frames)
        return frames

    def _poses_of_scans(self) -> Iterator[tuple[int, NDArray[np.float64]]]:
        """Yield the poses of the LiDAR in the middle of each of its scans."""
        odometry = Odometry()
        for message in self._bag.messages([self._depth_topic or ""]):
            with contextlib.suppress(InputError):  # reported when the frame is read
                if (stamp_ns := self._bag.stamp_ns(message)) is not None:
                    pose = odometry.add(decode_points(self._bag.decode(message)))
                    yield (stamp_ns or message.recorded_ns) + self._to_middle_ns, pose

    def read(self, frame: ListedFrame) -> Frame:
        """See `Source.read`."""
        self._bag.guard.check()
        recorded, recorded_depth = self._messages.take(frame)
        image = self._bag.decode(recorded)
        is_compressed = self._bag.types[self._image_topic] == COMPRESSED_IMAGE
        depth, calibration = None, self.calibration
        with self.collecting():
            if calibration is not None:
                self._sensors.require_camera(image)
            rgb = decode_compressed_image(image) if is_compressed else decode_image(image)
            if recorded_depth is not None:
                message = self._bag.decode(recorded_depth)
                calibration = self._sensors.calibration_of(message, calibration)
                depth = self._decode_depth(frame, message)
            return self.measured(frame, rgb, depth, calibration)

    def _decode_depth(self, frame: ListedFrame, message: Any) -> NDArray[np.float32] | Scan:
        """The depth of a frame: a scan if it is a cloud or from another camera, else a map."""
        if self._sensors.has_clouds:
            points, after_s = decode_points(message), None
            if self._poses is not None and frame.depth_stamp_ns is not None:
                after_s = point_times_s(message, frame.depth_stamp_ns, points)
            return Scan.of(points, after_s, frame.depth_stamp_ns)
        depth = decode_depth_image(message)
        if (camera := self._sensors.depth_camera) is None:
            return depth
        camera.require_size(depth.shape)
        return Scan.of(depth_to_cloud(depth, camera.intrinsics, lens=camera.lens_model).points)

    @property
    def _topics(self) -> dict[str, str | None]:
        return {
            "image_topic": self._image_topic,
            "depth_topic": self._depth_topic,
            "info_topic": self._sensors.info_topic,
            "pose_topic": self._pose_topic,
        }

    @property
    def inputs(self) -> dict[str, Any]:
        """See `Source.inputs`."""
        facts = {"bag": str(self._bag.path), **self._given._asdict(), **self._topics}
        facts |= {**self._rig_facts, "reuse_depth_ms": self._rig.max_depth_age_ms}
        return facts | {"left_out": dict(self.left_out)}

    @property
    def lidar_place(self) -> tuple[str, str, NDArray[np.float64] | None]:
        """See `Source.lidar_place`: as in /tf_static, without the baseline of a stereo pair."""
        topics = self._image_topic, self._depth_topic or self._image_topic
        camera, lidar = map(self._sensors.frame, topics)
        if self._rig.calibration is not None or not self._sensors.has_clouds:
            return camera, lidar, super().lidar_place[2]
        return camera, lidar, self._sensors.tree.between(lidar, camera)[:3, 3]

    @property
    def notes(self) -> tuple[str, ...]:
        """See `Source.notes`."""
        topics = ", ".join(f"{name}={topic}" for name, topic in self._topics.items() if topic)
        return (f"topics: {topics}", *super().notes)

    def close(self) -> None:
        """See `Source.close`."""
        self._messages.close()
        self._bag.close()
