"""A camera and a LiDAR or depth camera in a bag of ROS 1 or ROS 2 or an MCAP file."""

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

from runtime.base.errors import InputError
from runtime.geometry.assumptions import assume, collect_assumptions
from runtime.geometry.calibration import Calibration
from runtime.geometry.motion import Scan
from runtime.geometry.point_cloud import to_points
from runtime.geometry.rig import DEFAULT_RIG, Rig
from runtime.recordings.ros_bag import RecordedMessage, RosBag
from runtime.recordings.ros_camera import CAMERA_INFO, GIVE, SAME_PX, calibrate, projection_of
from runtime.recordings.ros_messages import (
    DEPTHS,
    decode_compressed_image,
    decode_depth_image,
    decode_image,
    decode_points,
)
from runtime.recordings.ros_poses import (
    TransformTree,
    frame_name,
    odometry_pose,
    odometry_poses,
    point_times_s,
    transform_poses,
)
from runtime.recordings.source import ListedFrame, Source, left_out_note, track_of
from runtime.streams.frame import Frame, Message, Outcome, Sensor

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
ODOMETRY = "nav_msgs/msg/Odometry"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
#: Value of depth_topic for the camera alone, and of pose_topic for scans that are not moved.
NO_TOPIC = "none"


_SUFFIXES = (".bag", ".db3", ".mcap")


class BagOptions(NamedTuple):
    """The options of a `BagSource`.

    Attributes:
        image_topic: of Image or CompressedImage; None: the only one.
        depth_topic: of PointCloud2, or of Image in 16UC1 [mm] or 32FC1 [m] of the image's size;
            "none": the camera alone; None: the only one.
        info_topic: of CameraInfo; None: the one beside the images.
        rectified: whether the images are; None: by their CameraInfo and the name of their topic.
        registered: whether depth images lie on the pixels of the images; None: if both are of one
            frame, with a warning if their CameraInfo differ. Others are moved by their CameraInfo
            and /tf_static or the rig's calibration.
        pose_topic: of Odometry, or of TFMessage such as /tf, by which clouds are moved to the time
            of the image; "none": they are not; None: the only Odometry, else /tf, if there are any
            and /tf_static connects them to the LiDAR.
    """

    image_topic: str | None = None
    depth_topic: str | None = None
    info_topic: str | None = None
    rectified: bool | None = None
    registered: bool | None = None
    pose_topic: str | None = None


class BagSource(Source):
    """Images and, matched by the time stamps in their headers, point clouds or depth images.

    A header without a stamp counts with the time at which it was recorded. An image without depth
    takes an older one, or is a frame of the camera alone; depth without an image is left out.
    Listing reads the bag once.

    Args:
        path: as `RosBag`, or an open one, which sources of other cameras read, too.
        rig: its calibration, if there is one, takes the place of CameraInfo and /tf_static.
        **options: see `BagOptions`.

    Raises:
        InputError: if `rosbags` is not installed, the bag is damaged, a topic does not exist or
            must be chosen, or clouds have no calibration.
    """

    accepted = f"a bag ({', '.join(_SUFFIXES)}, or a folder that holds metadata.yaml)"
    options = BagOptions._fields
    rig_options = ("calibration", "max_skew_ms", "reuse_depth_ms", "scan_stamp")

    def __init__(self, path: Path | RosBag, rig: Rig = DEFAULT_RIG, **options: Any) -> None:
        self._given, self._rig = BagOptions(**options), rig
        self._bag = path if isinstance(path, RosBag) else RosBag(path)
        path = self._bag.path
        self.folders = (path if os.path.isdir(path) else Path(os.path.realpath(path)).parent,)
        self.recordings = (path,)
        try:
            self._image_topic, self._depth_topic = self._find_topics()
            self._has_clouds = self._depth_topic in self._of_kind(POINT_CLOUD)
            infos, beside = self._of_kind(CAMERA_INFO), self._infos_beside(self._image_topic)
            self._info_topic = self._choose("info_topic", infos, beside[:1])
            self._depth_camera: Calibration | None = None  # if depth images are projected
            with collect_assumptions(self._notes):
                self.calibration = self._calibrate()
                self._pose_topic = self._find_poses()
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
        """Open a source for each of the topics that are joined by +, over one open bag."""
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

    def _of_kind(self, *kinds: str) -> list[str]:
        return sorted(topic for topic, kind in self._bag.types.items() if kind in kinds)

    def _find_topics(self) -> tuple[str, str | None]:
        """The topics of images and of depth, as requested or guessed."""
        images, depths = self._of_kind(COMPRESSED_IMAGE), self._of_kind(POINT_CLOUD)
        images = [topic for topic in images if not topic.endswith("/compressedDepth")]
        for topic in self._of_kind(IMAGE):
            with contextlib.suppress(InputError):  # if no message can be decoded
                encoding = self._bag.first(topic).encoding
                (depths if encoding in DEPTHS else images).append(topic)
        twice = {f"{topic}/compressed" for topic in images}  # compressed copies of the same images
        single = [topic for topic in images if topic not in twice]
        image = self._choose("image_topic", images, single)
        if image is None:
            raise self._undecided("images", single, "image_topic=TOPIC, or TOPIC+TOPIC for several")
        if self._given.depth_topic == NO_TOPIC:
            return image, None
        depth = self._choose("depth_topic", depths, depths)
        if depth is None:
            ways = f"depth_topic=TOPIC, or depth_topic={NO_TOPIC} for the camera alone"
            raise self._undecided("point clouds or depth images", depths, ways)
        return image, depth

    def _choose(self, option: str, fitting: list[str], guesses: list[str]) -> str | None:
        """The requested topic, or the only guess; None without one. Raises InputError."""
        requested: str | None = getattr(self._given, option)
        if requested is None:
            return guesses[0] if len(guesses) == 1 else None
        if requested not in fitting:
            raise InputError(
                f"{option}={requested} is not a topic of its kind in {self._bag.path}, which has "
                f"{', '.join(fitting) or 'none'}"
            )
        return requested

    def _undecided(self, what: str, found: list[str], ways: str) -> InputError:
        bag, path = self._bag, self._bag.path
        topics = ", ".join(f"{topic} ({kind})" for topic, kind in sorted(bag.types.items()))
        return InputError(
            f"{path} has {len(found) or 'no'} topics of {what}, give --source bag:{path},{ways}. "
            f"It has the topics {'; '.join([topics or '(none)', *left_out_note(bag.left_out)])}"
        )

    def _infos_beside(self, topic: str) -> list[str]:
        """The topics of CameraInfo in the namespaces of a topic of images, the innermost first."""
        parts, infos = topic.split("/"), self._of_kind(CAMERA_INFO)
        names = ("/".join([*parts[:end], "camera_info"]) for end in reversed(range(len(parts))))
        return [name for name in names if name in infos]

    def _calibrate(self) -> Calibration | None:
        """The given calibration, or that of CameraInfo and /tf_static."""
        image, depth = self._image_topic, self._depth_topic
        if depth is None or not (self._has_clouds or self._is_apart(depth)):
            if (given := self._rig.read_calibration()) is not None:
                return given
            with (
                contextlib.suppress(InputError),
                collect_assumptions([]),
            ):  # only for the focal length
                return self._camera(image)
            return None
        try:
            if not self._has_clouds:
                self._depth_camera = self._camera(depth)
            given = self._rig.read_calibration(for_scans=True)
            return self._camera(image, self._frame(depth)) if given is None else given
        except InputError as error:
            if self._has_clouds:
                raise
            raise InputError(
                f"{depth} is of the frame {self._frame(depth)}, not of {self._frame(image)} as the "
                "images: choose a topic of aligned depth, or state registered=true in --source if "
                f"it lies on their pixels. It cannot be projected: {error}"
            ) from error

    def _is_apart(self, depth: str) -> bool:
        """Whether depth images do not lie on the pixels of the images."""
        if self._given.registered is not None:
            return not self._given.registered
        frames = self._frame(depth), self._frame(self._image_topic)
        if all(frames) and frames[0] != frames[1]:
            return True
        is_proved = all(frames)
        with contextlib.suppress(InputError), collect_assumptions([]):  # without CameraInfo
            ours, its = self._camera(self._image_topic), self._camera(depth)
            is_near = np.abs(ours.intrinsics - its.intrinsics).max() < SAME_PX
            is_straight = ours.lens_model is not None and its.lens_model is None
            is_proved &= bool(is_near) and not is_straight
        if not is_proved:
            remedy = "state it with registered=true or false in --source"
            assume(f"{depth} lies on the pixels of the images", remedy)
        return False

    def _camera(self, topic: str, source: str = "") -> Calibration:
        """The calibration of a topic of images or depth images.

        source: frame of the points to be projected; "" = that of the images. Raises InputError.
        """
        is_image = topic == self._image_topic
        info = self._info_topic if is_image else next(iter(self._infos_beside(topic)), None)
        if info is None:
            remedy = "give info_topic= in --source, or --calibration"
            raise InputError(f"{self._bag.path} has no CameraInfo beside {topic}: {remedy}")
        stated = self._given.rectified if is_image else None
        return calibrate(self._bag, self._tree, topic, info, source, stated)

    def _frame(self, topic: str) -> str:
        """The frame of the first message of a topic."""
        return frame_name(self._bag.first(topic).header.frame_id)

    @cached_property
    def _tree(self) -> TransformTree:
        topics = (topic for topic in self._of_kind(*TRANSFORMS) if topic.endswith("tf_static"))
        return TransformTree(chain.from_iterable(map(self._bag.decoded, topics)))

    def _find_poses(self) -> str | None:
        """Read the poses of the car if there are clouds to be moved, and return their topic.

        Raises InputError if the requested topic cannot be used.
        """
        odometry = self._of_kind(ODOMETRY)
        moving = [t for t in self._of_kind(*TRANSFORMS) if not t.endswith("tf_static")]
        if self._given.pose_topic == NO_TOPIC or not self._has_clouds:
            return None
        topic = self._choose("pose_topic", odometry + moving, odometry or moving[:1])
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

        def stamped() -> Iterator[tuple[Sensor, int, int]]:
            """Yield (sensor, stamp, position in `_recorded`) of images and depth."""
            for place, message in self._recorded():
                if message.topic == self._info_topic:
                    with contextlib.suppress(InputError):  # damaged
                        cameras.extend(projection_of(self._bag.decode(message)))
                    continue
                sensor = Sensor.IMAGE if message.topic == self._image_topic else Sensor.DEPTH
                stamp_ns = self._bag.stamp_ns(message)
                if stamp_ns is None:
                    self._left_out[f"{sensor}: {Outcome.BAD_STAMP}"] += 1
                else:
                    yield sensor, stamp_ns or message.recorded_ns, place

        def name(image: Message) -> str:
            stamp = str(image.stamp_ns)
            names[stamp] += 1
            return stamp if names[stamp] == 1 else f"{stamp}-{names[stamp]}"  # looped recording

        frames = self._match(
            stamped(),
            max_skew_ms=self._rig.max_skew_ms,
            limit=limit,
            camera_only=self._depth_topic is None,
            name=name,
        )
        self._left_out.update(self._bag.left_out)
        if cameras and self._rig.calibration is None and np.ptp(cameras, axis=0).max() > SAME_PX:
            with collect_assumptions(self._notes):
                assume(f"the first CameraInfo of {self._info_topic}, others differ", GIVE)
        if not frames:
            raise InputError(
                f"the topic {self._image_topic} of {self._bag.path} has no messages with a stamp"
            )
        # Position of a message -> sequence of the last frame that needs it. `_kept` holds what was
        # read ahead and is needed later.
        self._owners = {place: f.sequence for f in frames for place in (f.image, f.depth)}
        self._kept: dict[int, RecordedMessage] = {}
        self._messages, self._next_place = self._recorded(), 0
        return frames

    def _recorded(self) -> Iterator[tuple[int, RecordedMessage]]:
        """Yield (position, message) of the topics that are read, in the same order each time."""
        topics = (self._image_topic, self._depth_topic, self._info_topic)
        return enumerate(self._bag.messages([topic for topic in topics if topic is not None]))

    def read(self, frame: ListedFrame) -> Frame:
        """See `Source.read`."""
        messages = self._take(frame)
        image = self._bag.decode(messages[frame.image])
        is_compressed = self._bag.types[self._image_topic] == COMPRESSED_IMAGE
        rgb = decode_compressed_image(image) if is_compressed else decode_image(image)
        depth: NDArray[np.float32] | Scan | None = None
        if frame.depth is not None:
            depth = self._decode_depth(frame, self._bag.decode(messages[frame.depth]))
        return self.measured(frame, rgb, depth, self.calibration)

    def _decode_depth(self, frame: ListedFrame, message: Any) -> NDArray[np.float32] | Scan:
        """The depth map of a frame; as a scan if it is a cloud, or of another camera."""
        if self._has_clouds:
            points, after_s = decode_points(message), None
            if self._poses is not None and frame.depth_stamp_ns is not None:
                with collect_assumptions(self._notes):
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
        # A scan may serve later images, too.
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
    def notes(self) -> tuple[str, ...]:
        """See `Source.notes`."""
        topics = ", ".join(f"{name}={topic}" for name, topic in self._topics.items() if topic)
        return (f"topics: {topics}", *super().notes)

    def close(self) -> None:
        """See `Source.close`."""
        self._bag.close()
