"""What a bag says of a camera and its LiDAR or depth camera: their frames and calibration."""

import contextlib
import os
from dataclasses import replace
from functools import cached_property
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from runtime.base.arguments import shown
from runtime.base.errors import InputError
from runtime.geometry.assumptions import assume, collect_assumptions
from runtime.geometry.calibration import Calibration
from runtime.geometry.rig import Rig
from runtime.recordings.ros_answers import FixedTransform, SensorFrames
from runtime.recordings.ros_bag import RosBag
from runtime.recordings.ros_camera import CAMERA_INFO, GIVE, SAME_PX, read_camera_calibration
from runtime.recordings.ros_poses import TransformTree, frame_name, is_world_frame
from runtime.recordings.ros_topics import POINT_CLOUD, choose_topic, find_topics, infos_beside

ODOMETRY = "nav_msgs/msg/Odometry"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")


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
            move clouds to the time of the image; "none": clouds are not moved; "odometry": they are
            found from the clouds, see `Odometry`; None: the only Odometry topic, else /tf, if there
            is one and /tf_static connects it to the LiDAR.
    """

    image_topic: str | None = None
    depth_topic: str | None = None
    info_topic: str | None = None
    rectified: bool | None = None
    registered: bool | None = None
    pose_topic: str | None = None


class BagSensors:
    """The frames and the calibration of a camera and its depth.

    Args:
        bag: the bag.
        given: the options of the source.
        rig: the sensors of the car; its calibration replaces that of the bag.

    Attributes:
        topics: topics of the images and of the depth; None: the camera alone.
        info_topic: topic of the camera's CameraInfo; None: there is none.
        has_clouds: whether the depth comes as point clouds.
        depth_camera: calibration of the depth images if they are projected, else None.
        tree: the transforms of /tf_static.
    """

    def __init__(self, bag: RosBag, given: BagOptions, rig: Rig) -> None:
        self._bag, self._rig = bag, rig
        self.topics = image, depth = find_topics(bag, given.image_topic, given.depth_topic)
        self._image_topic, self._depth_topic = image, depth
        self._rectified, self._registered = given.rectified, given.registered
        self.has_clouds = depth in bag.of_kind(POINT_CLOUD)
        infos, beside = bag.of_kind(CAMERA_INFO), infos_beside(bag, image)
        self.info_topic = choose_topic(bag, "info_topic", given.info_topic, infos, beside[:1])
        self.depth_camera: Calibration | None = None
        self.tree = self._read_tree()
        self._first_frames: dict[str, str] = {}  # of each topic
        self._of_frames: dict[str, Calibration] = {}  # for scans, by their frames

    def read_calibration(self) -> Calibration | None:
        """The given calibration, or the one that CameraInfo and /tf_static describe."""
        image, depth = self._image_topic, self._depth_topic
        if depth is None or not (self.has_clouds or self._is_apart(depth)):
            if (given := self._rig.read_calibration()) is not None:
                return given
            # Here the calibration only gives the focal length.
            with contextlib.suppress(InputError), collect_assumptions([]):
                return self.camera(image)
            return None
        try:
            frame = self.frame(depth)
            if not self.has_clouds:
                self.depth_camera = self.camera(depth)
            elif frame in self._fixed_frames or is_world_frame(frame):
                what = f"{depth} lies in the frame of the LiDAR, although {frame} is fixed and "
                assume(f"{what}the LiDAR moves in it", "choose the raw scans by depth_topic=")
            given = self._rig.read_calibration(for_scans=True)
            if given is None and not frame:
                raise InputError(f"the messages of {depth} name no frame: {GIVE}")
            return self.camera(image, frame) if given is None else given
        except InputError as error:
            if self.has_clouds:
                raise
            raise InputError(
                f"{depth} is of the frame {self.frame(depth)}, not of {self.frame(image)} as the "
                "images: choose a topic of aligned depth, or state `registered=True` if "
                f"it lies on their pixels; it cannot be projected: {error}"
            ) from error

    def camera(self, topic: str, source: str = "") -> Calibration:
        """The calibration of a topic of images or depth images. Raises InputError.

        `source` is the frame of the points to be projected; "" stands for the frame of the images.
        """
        is_image = topic == self._image_topic
        info = self.info_topic if is_image else next(iter(infos_beside(self._bag, topic)), None)
        if info is None:
            remedy = "give `info_topic=` or `calibration=`"
            raise InputError(f"{self._bag.path} has no CameraInfo beside {topic}: {remedy}")
        stated = self._rectified if is_image else None
        return read_camera_calibration(self._bag, self.tree, topic, info, source, stated)

    def frame(self, topic: str) -> str:
        """The frame of the first message of a topic."""
        if topic not in self._first_frames:
            self._first_frames[topic] = frame_name(self._bag.first(topic).header.frame_id)
        return self._first_frames[topic]

    def place(self, calibration: Calibration | None) -> SensorFrames:
        """Return the frames of the sensors, with the transforms of /tf_static."""
        camera = self.frame(self._image_topic) or "camera"
        lidar = self.frame(self._depth_topic or "") if self.has_clouds else ""
        transforms = tuple(self.tree.valid())
        if calibration is None or not lidar:
            return SensorFrames(camera, transforms, "/tf_static" if transforms else "")
        if not transforms:
            return SensorFrames.of(calibration, camera, lidar)
        if self._rig.calibration is None:
            # P of the second camera of a stereo pair holds the baseline to the first one's frame.
            with collect_assumptions([]):  # already reported with the calibration
                offset = self.tree.between(lidar, camera) @ np.linalg.inv(calibration.extrinsics)
            if not np.allclose(offset, np.eye(4), atol=1e-6):
                beside = f"{camera}_ssdnet"
                transforms += (FixedTransform.of(camera, beside, offset),)
                camera = beside
        return SensorFrames(camera, transforms, "/tf_static")

    def read_frames(self) -> None:
        """Read the frames of both topics: later it would disturb the reader of an MCAP file."""
        for topic in filter(None, (self._image_topic, self._depth_topic)):
            with contextlib.suppress(InputError):  # no message may be decodable
                self.frame(topic)

    def _is_apart(self, depth: str) -> bool:
        """Whether the pixels of depth images do not lie on those of the images."""
        if self._registered is not None:
            return not self._registered
        frames = self.frame(depth), self.frame(self._image_topic)
        if all(frames) and frames[0] != frames[1]:
            return True
        is_proved = all(frames)
        with contextlib.suppress(InputError), collect_assumptions([]):  # there may be no CameraInfo
            ours, its = self.camera(self._image_topic), self.camera(depth)
            is_near = np.abs(ours.intrinsics - its.intrinsics).max() < SAME_PX
            is_straight = ours.lens_model is not None and its.lens_model is None
            is_proved &= bool(is_near) and not is_straight
        if not is_proved:
            remedy = "state it with `registered=True` or False"
            assume(f"{depth} lies on the pixels of the images", remedy)
        return False

    def calibration_of(self, depth: Any, calibration: Calibration | None) -> Calibration | None:
        """The calibration for a message of depth: not all have the frame of the first message.

        Raises InputError if /tf_static does not connect the two frames, and if the message is a
        depth image.
        """
        topic, frame = self._depth_topic or "", frame_name(depth.header.frame_id)
        first = self.frame(topic)
        if frame == first or calibration is None or self._registered:
            return calibration
        if frame not in self._of_frames:
            try:
                if not self.has_clouds:
                    raise InputError("each topic of depth images must be of one camera")
                move = self.tree.between(frame, first)
            except InputError as error:
                raise InputError(
                    f"a message of {topic} is of the frame {shown(frame)}, the first of "
                    f"{shown(first)}: {error}"
                ) from error
            body, extrinsics = calibration.body_from_lidar, calibration.extrinsics @ move
            body = None if body is None else body @ move
            moved = replace(calibration, extrinsics=extrinsics, body_from_lidar=body)
            self._of_frames[frame] = moved
        return self._of_frames[frame]

    def require_camera(self, image: Any) -> None:
        """Raise InputError for an image whose frame is not the frame of the calibration."""
        topic, frame = self._image_topic, frame_name(image.header.frame_id)
        if frame not in ("", self.frame(topic)):
            raise InputError(
                f"an image of {topic} is of the frame {shown(frame)}, the first of "
                f"{shown(self.frame(topic))}: each topic of images must be of one camera"
            )

    @cached_property
    def _fixed_frames(self) -> set[str]:
        """The frames in which an Odometry message describes the motion of the car."""
        frames = set()
        for topic in self._bag.of_kind(ODOMETRY):
            with contextlib.suppress(InputError):
                frames.add(self.frame(topic))
        return frames

    def _read_tree(self) -> TransformTree:
        """The transforms of /tf_static."""
        topics = (t for t in self._bag.of_kind(*TRANSFORMS) if t.endswith("tf_static"))
        messages, folder = (
            chain.from_iterable(map(self._bag.decoded, topics)),
            self._bag.path.parent,
        )
        if os.path.isfile(folder / "metadata.yaml"):
            first = f"give the whole bag {folder}, whose first file has it, or `calibration=`"
            return TransformTree(messages, first)
        return TransformTree(messages)
