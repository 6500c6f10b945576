"""The view of a frame, by which the checks judge."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from runtime.base.errors import SSDNetError
from runtime.checks.view import LEFT_HALF, UPSIDE_DOWN, Answer, Points, View
from runtime.engine.prediction import Prediction
from runtime.geometry.calibration import Calibration
from runtime.geometry.lens import cache_key, rays, to_image_plane
from runtime.geometry.motion import compensate_points
from runtime.geometry.poses import NoPoseError
from runtime.geometry.returns import is_measured
from runtime.streams.frame import Frame
from runtime.streams.messages import Image

_MOST_OF_MAP = 50_000  # returns of a denser depth map are subsampled
_FARTHEST_M = 1e6  # in any unit

# Answers a frame with the given returns (H, W) instead of its own; all 0: from the image alone.
Predict = Callable[[Frame, NDArray[np.float32]], Prediction]


def view_of(
    frame: Frame,
    camera_only: Prediction,
    *,
    predict: Predict | None = None,
    beside: Mapping[str, Points] | None = None,
    depth_scale: float | None = None,
    focal_px: float | None = None,
) -> View | None:
    """Return the view of a frame.

    Args:
        frame: a frame with depth.
        camera_only: prediction from its image without any return.
        predict: answers changed images; None: there are no such answers.
        beside: see `View`.
        depth_scale: see `View`.
        focal_px: see `View`.

    Returns:
        The view; None if there is no depth, or if the prediction lacks a head or is invalid.
    """
    answer, points = Answer.of(camera_only), compensated_points(frame)
    if answer is None or frame.depth is None:
        return None
    calibration, size = frame.calibration, frame.size
    if calibration is None:  # a depth map: its rays matter for few readings
        focal, (height, width) = focal_px or size[1], size
        matrix = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
        calibration = Calibration(matrix, np.eye(4), size)
    if points is None:
        points = _points_of_map(frame.sparse_depth, calibration)
    return View(
        answer,
        points,
        calibration.intrinsics,
        np.eye(4) if frame.scan is None else calibration.extrinsics,
        calibration.lens_model,
        size,
        is_map=frame.scan is None,
        name=frame.name,
        beside=beside or {},
        others=lambda change: None if predict is None else _answer_to(change, frame, predict),
        depth_scale=depth_scale,
        focal_px=focal_px,
    )


def compensated_points(frame: Frame) -> Points | None:
    """The points of the frame's scan, moved to the time of its image if there are poses."""
    if (scan := frame.scan) is None:
        return None
    if frame.poses is None or scan.times is None:
        return scan.points
    try:
        return compensate_points(scan.points, scan.times, frame.poses, frame.image.time_ns)
    except NoPoseError:
        return scan.points


def _points_of_map(sparse_depth: NDArray[np.float32], calibration: Calibration) -> Points:
    """The returns of a depth map, float32 (N, 3), in the camera's frame."""
    row, column = np.nonzero(is_measured(sparse_depth) & (sparse_depth < _FARTHEST_M))
    row, column = (each[:: len(row) // _MOST_OF_MAP + 1] for each in (row, column))
    z, key = sparse_depth[row, column], cache_key(calibration.intrinsics)
    if (lens := calibration.lens_model) is None:
        x, y = to_image_plane(calibration.intrinsics, column, row)
    else:
        x, y = rays(lens, key, sparse_depth.shape)[row, column].T
    points = np.column_stack([x * z, y * z, z]).astype(np.float32)
    return points[np.isfinite(points).all(axis=1)]


def _answer_to(change: str, frame: Frame, predict: Predict) -> Answer | None:
    """The answer to a changed image, in the pixels of the frame's image."""
    height, width = frame.size
    way = {UPSIDE_DOWN: np.s_[::-1, ::-1], LEFT_HALF: np.s_[:, : width // 2]}[change]
    if change == LEFT_HALF and width < 2 * height:
        return None
    rgb = np.ascontiguousarray(frame.rgb[way])
    calibration = frame.calibration and replace(frame.calibration, size=None)
    changed = Frame(Image(rgb=rgb, stamp_ns=frame.image.stamp_ns), calibration=calibration)
    try:
        answer = Answer.of(predict(changed, np.zeros(rgb.shape[:2], np.float32)))
    except SSDNetError:  # the image as it is was answered, which is enough
        return None
    if answer is None or change == LEFT_HALF:
        return answer
    return Answer(answer.boundary[way], answer.log_depth[way])
