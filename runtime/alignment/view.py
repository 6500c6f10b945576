"""A frame as the check of a calibration sees it: returns, jumps of the scan, camera-only answers.

A jump is a return with a clearly farther return beside it on the same scan line. An object ends
there, and the network sees a boundary in the image. Ranges are measured from the LiDAR.
"""

from dataclasses import dataclass, field, replace
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.checks.log_depth import log_depth
from runtime.contract.degraded import IMAGE_CONSTANT
from runtime.engine.prediction import Prediction
from runtime.geometry.assumptions import collect_assumptions
from runtime.geometry.calibration import Calibration
from runtime.geometry.lens import cache_key, ray_bounds, to_image_plane
from runtime.geometry.motion import compensate_points
from runtime.geometry.poses import NoPoseError
from runtime.streams.frame import Frame

LEAST_JUMPS, LEAST_RETURNS = 60, 500  # with fewer in a view, nothing is computed
_MOST_JUMPS, _MOST_RETURNS = 2500, 4000  # more are subsampled
_NEAREST_M = 1.0
_ROWS = 375  # answers with twice as many rows are shrunk; the network sees no finer boundary
_MARGIN = 0.12  # of rays beside the image, about 7 degrees: trials move them into it
_LINE_RAD, _ACROSS = 0.02, 8  # how near neighbours are along a scan line; across it an eighth
_JUMP_M, _JUMP_SHARE = 0.5, 0.05  # a neighbour is farther by this, or by this share of the range
_STEPS = (1, 2, 3)  # neighbours on a line that are compared

Points = NDArray[np.float32]
#: The points of the scan before and of the one after; None if there is no such scan.
Neighbours = tuple[Points | None, Points | None]


@dataclass(frozen=True, eq=False)
class View:
    """The returns of a frame near its image, and what the network sees in the image alone.

    Attributes:
        name: name of the frame.
        points: float32 (N, 3) or wider, metres, LiDAR frame, at the time of the image.
        returns: a sample of the returns, float32 (N, 3), metres, axes of the camera, origin of the
            LiDAR.
        jumps: a sample of the returns that are jumps, like `returns`.
        calibration: the given calibration.
        size: (height, width) of the image.
        boundary: float32 (H, W), probability; one value for each `shrink` x `shrink` pixels of the
            image.
        log_depth: float32 (H, W), logarithm of the depth in metres.
        neighbours: the scans beside that of the frame.
    """

    name: str
    points: Points
    returns: Points
    jumps: Points
    calibration: Calibration
    size: tuple[int, int]
    boundary: NDArray[np.float32]
    log_depth: NDArray[np.float32]
    neighbours: Neighbours = (None, None)
    _blurred: dict[float, NDArray[np.float32]] = field(default_factory=dict)

    @property
    def shrink(self) -> int:
        """Side, in pixels of the image, of the square that one value of `boundary` covers."""
        return shrink_factor(self.size)

    @property
    def has_structure(self) -> bool:
        """Whether there are enough returns and jumps to compute with."""
        return len(self.jumps) >= LEAST_JUMPS and len(self.returns) >= LEAST_RETURNS

    def with_scan(self, points: Points) -> Self:
        """The view with another scan, float32 (N, 3) or wider."""
        returns, jumps = find_structure(points, self.calibration, self.size)
        return replace(self, points=points, returns=returns, jumps=jumps)

    def with_extrinsics(self, extrinsics: NDArray[np.float64]) -> Self:
        """The view with other extrinsics, float64 (4, 4), of which nothing is reported."""
        with collect_assumptions([]):
            calibration = replace(self.calibration, extrinsics=extrinsics)
        return replace(self, calibration=calibration).with_scan(self.points)

    def blurred_boundary(self, blur: float) -> NDArray[np.float32]:
        """The boundary, blurred by a share of the image's height."""
        if blur not in self._blurred:
            sigma = blur * len(self.boundary)
            self._blurred[blur] = cv2.GaussianBlur(self.boundary, (0, 0), sigma)  # type: ignore[assignment]
        return self._blurred[blur]


def view_of(
    frame: Frame, camera_only: Prediction, neighbours: Neighbours = (None, None)
) -> View | None:
    """Return the view of a frame.

    Args:
        frame: a frame with a scan and a calibration.
        camera_only: prediction from its image without any return.
        neighbours: the scans beside that of the frame.

    Returns:
        The view; None if there is no scan, or if the prediction lacks depth or boundary or is
        invalid.
    """
    calibration, boundary, depth = frame.calibration, camera_only.boundary, camera_only.depth
    if calibration is None or boundary is None or depth is None:
        return None
    if not camera_only.valid or IMAGE_CONSTANT in camera_only.degraded:
        return None
    if (points := compensated_points(frame)) is None:
        return None
    returns, jumps = find_structure(points, calibration, frame.size)
    answers = boundary, log_depth(depth)
    edges, depths = (_shrunk(each, shrink_factor(frame.size)) for each in answers)
    return View(
        frame.name, points, returns, jumps, calibration, frame.size, edges, depths, neighbours
    )


def shrink_factor(size: tuple[int, int]) -> int:
    """Factor by which the answers to an image of this size are shrunk."""
    return max(1, size[0] // _ROWS)


def find_structure(
    points: Points, calibration: Calibration, size: tuple[int, int]
) -> tuple[Points, Points]:
    """Return samples of the returns near an image and of the jumps, see `View`."""
    turned = points[:, :3] @ calibration.extrinsics[:3, :3].T.astype(np.float32)
    x, y, z = (turned + calibration.extrinsics[:3, 3].astype(np.float32)).T
    left, right, top, bottom = _image_bounds(calibration, size)
    near = (z > _NEAREST_M) & (x > (left - _MARGIN) * z) & (x < (right + _MARGIN) * z)
    near &= (y > (top - _MARGIN) * z) & (y < (bottom + _MARGIN) * z)
    turned = turned[near]
    jumps = turned[find_jumps(turned)]
    return _sample(turned, _MOST_RETURNS), _sample(jumps, _MOST_JUMPS)


def find_jumps(points: Points) -> NDArray[np.bool_]:
    """Return where a neighbour on the same scan line is clearly farther, bool (N,).

    `points` are float32 (N, 3), x to the right, y down, as seen from the LiDAR, in any order.
    """
    x, y, z = points.astype(np.float64).T
    across, up = np.arctan2(x, z), np.arctan2(y, np.hypot(x, z)) * _ACROSS
    ranges = np.linalg.norm(points, axis=1)
    farther = np.zeros_like(ranges)
    # There are two sets of bands, the second moved by half a band, so that near points share a band
    # in one of them.
    for shift in (0.0, 0.5):
        band = np.floor(up / (2 * _LINE_RAD) + shift)
        order = np.lexsort((across, band))
        for step in _STEPS:
            first, second = order[:-step], order[step:]
            apart = np.hypot(across[second] - across[first], up[second] - up[first])
            ahead = np.where(apart < _LINE_RAD, ranges[second] - ranges[first], 0)
            farther[first] = np.maximum(farther[first], ahead)
            farther[second] = np.maximum(farther[second], -ahead)
    return np.asarray(farther > np.maximum(_JUMP_M, _JUMP_SHARE * ranges))


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


def _image_bounds(calibration: Calibration, size: tuple[int, int]) -> tuple[float, ...]:
    """The left, right, top and bottom ray of an image."""
    if (lens := calibration.lens_model) is not None:
        return tuple(map(float, ray_bounds(lens, cache_key(calibration.intrinsics), size)[:4]))
    height, width = size
    x, y = to_image_plane(calibration.intrinsics, np.array([0, width]), np.array([0, height]))
    return float(x[0]), float(x[1]), float(y[0]), float(y[1])


def _sample(points: Points, most: int) -> Points:
    return points[:: len(points) // most + 1]


def _shrunk(answer: NDArray[np.float32], step: int) -> NDArray[np.float32]:
    """Means of step x step pixels; an incomplete last row or column is left out."""
    height, width = answer.shape[0] // step, answer.shape[1] // step
    whole = answer[: height * step, : width * step]
    return cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)  # type: ignore[return-value]
