"""The calibration of a camera in a bag, as its CameraInfo, frames and /tf_static prove it.

Some fields of CameraInfo are used in two ways. What the bag does not prove is assumed, and the
assumption is reported.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from runtime.base.errors import InputError
from runtime.geometry.assumptions import assume
from runtime.geometry.calibration import Calibration
from runtime.geometry.lens import Lens
from runtime.geometry.rigid import nearest_rotation
from runtime.recordings.images import image_size
from runtime.recordings.ros_bag import RosBag
from runtime.recordings.ros_poses import TransformTree, frame_name

CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
# Words (between / and _) in the names of topics whose images are, or are not, rectified.
_RECTIFIED, _RAW = {"rect", "rectified"}, {"raw", "unrectified", "distorted"}
# If the principal point is farther from the middle, in shares of the sides, the CameraInfo is for
# images of another size.
_OFF_CENTRE = 0.05
# Two frames are the same up to this distance and this turn [rad], which is a pixel at 500 px.
_SHIFT_M, _TURN = 1e-3, 2e-3
# Two cameras are a stereo pair up to this error, in shares of the baseline, and this turn [rad].
# /tf_static does not contain the turn to the rectified axes.
_SHIFT_SHARE, _PAIR_TURN = 0.1, 0.1
SAME_PX = 1.0  # largest difference between equal focal lengths or principal points
GIVE = "give `calibration=`"


def read_camera_calibration(
    bag: RosBag, tree: TransformTree, topic: str, beside: str, source: str, rectified: bool | None
) -> Calibration:
    """Return the calibration of a camera for the points of a sensor.

    Args:
        bag: the bag that holds both.
        tree: the transforms of /tf_static.
        topic: topic of the images.
        beside: topic of their CameraInfo; the first message that is set counts.
        source: frame of the points; "" stands for the frame of the images.
        rectified: whether the images are rectified; None: the CameraInfo and the name of the topic
            decide.

    Raises:
        InputError: if no CameraInfo is set, if it is invalid, or if /tf_static lacks a frame.
    """
    image = bag.first(topic)
    info = next(filter(projection_of, bag.decoded(beside)), None)
    if info is None:
        raise InputError(f"{beside} has no CameraInfo with K or P: {GIVE}")
    fields = _fields(info)
    stated = frame_name(info.header.frame_id)
    frame = frame_name(image.header.frame_id) or stated
    extrinsics = tree.between(source or frame, frame)
    if stated and stated != frame and not _is_at(tree, stated, frame, (0, 0, 0)):
        assume(f"{frame} is the frame of the images, not {stated} of their CameraInfo", GIVE)
    size = getattr(image, "height", 0), getattr(image, "width", 0)
    if not all(size):
        size = image_size(bytes(memoryview(image.data))) or size
    try:
        if rectified is None:
            rectified = is_rectified(fields, topic)
        if np.any(fields["r"]):
            turn = nearest_rotation("R", np.reshape(fields["r"], (3, 3)))
            if np.abs(turn - np.eye(3)).max() > _TURN:
                kind = "rectified" if rectified else "raw"
                assume(f"{frame} is the frame of the {kind} images, so R is not used", GIVE)
        calibration = Calibration.from_camera_info(
            fields, extrinsics, rectified=rectified, size=size if all(size) else None
        )
    except InputError as error:
        raise InputError(f"the CameraInfo of {beside}: {error}; or {GIVE}") from error
    shift = calibration.extrinsics[:3, 3] - extrinsics[:3, 3]  # from P of a pair's second camera
    if np.abs(shift).max() > _SHIFT_M and _has_own_frame(bag, tree, frame, shift):
        return replace(calibration, extrinsics=extrinsics)
    return calibration


def projection_of(info: Any) -> list[list[float]]:
    """[The 21 numbers of K and P]; [] if a driver that knew neither wrote 0, 1 or NaN."""
    k, p = (_fields(info)[name] for name in "kp")
    return [[*k, *p]] if k[0] > 1 or p[0] > 1 else []


def is_rectified(fields: Mapping[str, Any], topic: str) -> bool:
    """Whether P describes the images of a topic; otherwise K and D describe them."""
    words = set(re.split("[/_]", topic.lower()))
    camera, projection = np.reshape(fields["k"], (3, 3)), np.reshape(fields["p"], (3, 4))[:, :3]
    if words & _RECTIFIED or not (camera.any() and projection.any()):
        return bool(words & _RECTIFIED or projection.any())
    lens = Lens.of_ros(fields["distortion_model"], fields["d"])
    if lens is None and np.allclose(camera, projection, rtol=1e-3):
        return True
    state = "state it with `rectified=True` or False"
    sides = np.array([fields["width"] or np.inf, fields["height"] or np.inf])
    off, straight_off = (abs(each[:2, 2] / sides - 0.5).max() for each in (camera, projection))
    if off > _OFF_CENTRE and straight_off < off / 2:  # as in bags written by kitti2bag
        assume(f"{topic} is rectified, because K is of images of another size than P", state)
        return True
    if not words & _RAW:
        assume(f"{topic} is not rectified, because its name does not have the word rect", state)
    return False


def _has_own_frame(bag: RosBag, tree: TransformTree, frame: str, shift: Any) -> bool:
    """Whether `frame` belongs to the second camera; by ROS's convention it is the first one's."""
    if any(_is_at(tree, each, frame, shift) for each in tree.frames if each != frame):
        return True
    for topic in bag.of_kind(CAMERA_INFO):
        for info in bag.decoded(topic):
            p = _fields(info)["p"]
            if frame_name(info.header.frame_id) == frame and p[0] and not any(p[3::4]):
                return False  # it is the first camera's frame
            break
    beside = f"{np.linalg.norm(shift):.3g} m beside"
    assume(f"{frame} is the frame of a stereo pair's first camera, {beside} the images", GIVE)
    return False


def _is_at(tree: TransformTree, source: str, target: str, shift: Any) -> bool:
    """Whether `target` has the axes of `source` and its points are shifted by `shift` [m]."""
    try:
        matrix = tree.between(source, target)
    except InputError:  # the frames are not connected
        return False
    length = np.linalg.norm(shift)
    is_near = np.linalg.norm(matrix[:3, 3] - shift) < _SHIFT_M + _SHIFT_SHARE * length
    turned = np.abs(matrix[:3, :3] - np.eye(3)).max()
    return bool(is_near and turned < (_PAIR_TURN if length else _TURN))


def _fields(info: Any) -> dict[str, Any]:
    """The fields of a CameraInfo; the names of its matrices are capitals in ROS 1."""
    names = ("height", "width", "distortion_model", "binning_x", "binning_y", *"DKRPdkrp")
    fields = {name.lower(): getattr(info, name) for name in names if hasattr(info, name)}
    sides = ("x_offset", "y_offset", "height", "width")
    return fields | {"roi": {name: getattr(info.roi, name) for name in sides}}
