"""The calibration of a camera in a bag: what its CameraInfo, frames and /tf_static prove.

Some fields of CameraInfo are used in two ways. What the bag does not prove is assumed and said.
"""

import re
from collections.abc import Iterable, Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from runtime.assumptions import assume
from runtime.errors import InputError
from runtime.io.calibration import Calibration, lens_of
from runtime.io.image_header import image_size
from runtime.rigid import read_rotation
from runtime.sources.ros_poses import TransformTree, frame_name

#: Of which camera of a stereo pair the frame of the second one's images is.
StereoFrame = Literal["first", "own"]
STEREO_FRAMES: tuple[StereoFrame, ...] = ("first", "own")
#: Words, between / and _, of the names of topics of images that are, or are not, rectified.
_RECTIFIED, _RAW = {"rect", "rectified"}, {"raw", "unrectified", "distorted"}
_OFF_CENTRE = 0.05  # of the image's sides; a principal point beyond it is of images of another size
_SHIFT_M, _TURN = 1e-3, 2e-3  # same place; same axes, radians: a pixel at 500 px
_SHIFT_SHARE, _PAIR_TURN = 0.1, 0.1  # of the baseline, and of the axes of a pair: before R
_STATE = "give --calibration"


def calibrate(
    infos: Iterable[Any],
    image: Any,
    topic: str,
    info_topic: str,
    source: str | None,
    tree: TransformTree,
    *,
    others: Iterable[Any] = (),
    rectified: bool | None = None,
    stereo_frame: StereoFrame | None = None,
) -> Calibration:
    """Return the calibration of a camera for the points of a sensor.

    Args:
        infos: the CameraInfo of the images; the first that is set counts.
        image: the first of the images.
        topic: of the images.
        info_topic: of the CameraInfo.
        source: frame of the points; None = that of the images.
        tree: of /tf_static.
        others: a CameraInfo of each camera of the bag.
        rectified: whether the images are; None = by the CameraInfo and the name of the topic.
        stereo_frame: None = by the frames of the other cameras.

    Raises:
        InputError: if no CameraInfo is set, if it is invalid, or if /tf_static lacks a frame.
    """
    set_infos = (each for each in infos if any(map(np.any, map(fields_of(each).get, "kp"))))
    if (info := next(set_infos, None)) is None:  # drivers send zeros before they are calibrated
        raise InputError(f"{info_topic} has no CameraInfo with K or P: {_STATE}")
    frame, stated = (frame_name(each.header.frame_id) for each in (image, info))
    frame = frame or stated
    extrinsics = tree.between(source or frame, frame)
    if stated and not (stated == frame or _is_at(tree, stated, frame, (0, 0, 0))):
        assume(f"{frame} is the frame of the images, not {stated} of their CameraInfo", _STATE)
    try:
        fields = _without_crop(fields_of(info), image)
        if rectified is None:
            rectified = is_rectified(fields, topic)
        if np.any(fields["r"]):
            turn = read_rotation("R", np.reshape(fields["r"], (3, 3)))
            if np.abs(turn - np.eye(3)).max() > _TURN:
                kind = "rectified" if rectified else "raw"
                assume(f"{frame} is the frame of the {kind} images, so R is not used", _STATE)
        projection = np.reshape(fields["p"], (3, 4))
        if rectified and projection[:, 3].any() and projection[0, 0]:
            shift = np.linalg.solve(projection[:, :3], projection[:, 3])
            if (stereo_frame or _stereo_frame(frame, shift, tree, others)) == "own":
                fields["p"] = projection * (1, 1, 1, 0)
        return Calibration.from_camera_info(fields, extrinsics, rectified=rectified)
    except InputError as error:
        raise InputError(f"the CameraInfo of {info_topic}: {error}; or {_STATE}") from error


def check_stereo_frame(text: str) -> StereoFrame:
    """Return which camera's frame a text names. Raises ValueError."""
    return STEREO_FRAMES[STEREO_FRAMES.index(text)]


def fields_of(info: Any) -> dict[str, Any]:
    """Return the fields of a CameraInfo; ROS 1 has matrices in capitals."""
    names = ("height", "width", "distortion_model", "binning_x", "binning_y", *"DKRPdkrp")
    fields = {name.lower(): getattr(info, name) for name in names if hasattr(info, name)}
    sides = ("x_offset", "y_offset", "height", "width")
    return fields | {"roi": {name: getattr(info.roi, name) for name in sides}}


def is_rectified(fields: Mapping[str, Any], topic: str) -> bool:
    """Whether P describes the images of a topic, and not K and D, as far as it matters."""
    words = set(re.split("[/_]", topic.lower()))
    camera, projection = np.reshape(fields["k"], (3, 3)), np.reshape(fields["p"], (3, 4))[:, :3]
    if words & _RECTIFIED or not camera.any():
        return True
    if not projection.any():
        return False
    lens = lens_of(fields["distortion_model"], fields["d"])
    if lens is None and np.allclose(camera, projection, rtol=1e-3):
        return True
    state = "state it with rectified=true or false in --source"
    sides = np.array([fields["width"] or np.inf, fields["height"] or np.inf])
    off, straight_off = (abs(each[:2, 2] / sides - 0.5).max() for each in (camera, projection))
    if off > _OFF_CENTRE and straight_off < off / 2:  # as in bags of kitti2bag
        assume(f"{topic} is rectified, because K is of images of another size than P", state)
        return True
    if not words & _RAW:
        assume(f"{topic} is not rectified, because its name does not have the word rect", state)
    return False


def _stereo_frame(
    frame: str, shift: NDArray[np.float64], tree: TransformTree, others: Iterable[Any]
) -> StereoFrame:
    """Whose frame the images of the second camera of a stereo pair have.

    shift: of the second camera by P, metres.
    """
    for other in others:
        column = np.reshape(fields_of(other)["p"], (3, 4))[:, 3]
        if frame_name(other.header.frame_id) == frame and not column.any():
            return "first"
    if any(_is_at(tree, each, frame, shift) for each in tree.frames if each != frame):
        return "own"
    assume(
        f"{frame} is the frame of the first camera of a stereo pair, {np.linalg.norm(shift):.3g} m "
        "beside the images by P",
        f"state it with stereo_frame={' or '.join(STEREO_FRAMES)} in --source",
    )
    return "first"


def _is_at(tree: TransformTree, source: str, target: str, shift: Any) -> bool:
    """Whether one frame is another one that is moved by `shift` [m] along the same axes."""
    try:
        matrix = tree.between(source, target)
    except InputError:  # not connected
        return False
    length = float(np.linalg.norm(shift))
    moved = np.linalg.norm(matrix[:3, 3] - shift)
    turned = np.abs(matrix[:3, :3] - np.eye(3)).max()
    near_m = _SHIFT_M + _SHIFT_SHARE * length
    return bool(moved < near_m and turned < (_PAIR_TURN if length else _TURN))


def _without_crop(fields: dict[str, Any], image: Any) -> dict[str, Any]:
    """The fields, without binning and ROI where images have the whole size all the same."""
    size = getattr(image, "height", 0), getattr(image, "width", 0)
    if not all(size):
        size = image_size(bytes(memoryview(image.data))) or size
    whole, roi = (fields["height"], fields["width"]), fields["roi"]
    is_cut = any(roi.values()) and (roi["height"], roi["width"]) != whole
    if size != whole or not (is_cut or max(fields["binning_x"], fields["binning_y"]) > 1):
        return fields
    assume("K and P are of the images as they are, without binning and ROI", _STATE)
    return fields | {"binning_x": 0, "binning_y": 0, "roi": {}}
