"""A frame as the checks see it: its returns, and what the model answers to the image alone.

A jump is a return with a clearly farther return beside it on the same scan line. An object ends
there, and the network sees a boundary in the image. Ranges are measured from the LiDAR.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import cv2
import numpy as np

from runtime.base.arrays import Bools, Float32, Float64, Floats, Indices, Size
from runtime.contract.degraded import IMAGE_CONSTANT, IMAGE_DOUBTS
from runtime.engine.prediction import Prediction
from runtime.geometry.lens import Lens, cache_key, pixels_of_rays, ray_bounds, to_image_plane

LEAST_JUMPS, LEAST_RETURNS = 60, 500  # with fewer in a view, nothing is computed
_MOST_JUMPS, _MOST_RETURNS = 2500, 4000  # more are subsampled
_NEAREST_M, _LEAST_Z_M = 1.0, 0.1
_LEAST_DEPTH_M = 1e-3  # smaller depths, such as 0, count as this
_STEP = 0.3  # larger steps of the log depth count as this
_ROWS = 375  # answers with twice as many rows are shrunk; the network sees no finer boundary
_MARGIN = 0.12  # of rays beside the image, about 7 degrees: trials move them into it
_LINE_RAD, _ACROSS = 0.02, 8  # how near neighbours are along a scan line; across it an eighth
_JUMP_M, _JUMP_SHARE = 0.5, 0.05  # a neighbour is farther by this, or by this share of the range
_STEPS = (1, 2, 3)  # neighbours on a line that are compared

# Changes of an image to which `View.others` returns the answer.
UPSIDE_DOWN, LEFT_HALF = "upside_down", "left_half"

Points = Float32


@dataclass(frozen=True, eq=False)
class Answer:
    """The answer to an image alone, one value for `shrink` x `shrink` pixels of the image.

    Attributes:
        boundary: float32 (H, W), probability.
        log_depth: float32 (H, W), logarithm of the depth in metres.
        doubts: reasons of `Prediction.degraded` for which the image shows little.
    """

    boundary: Float32
    log_depth: Float32
    doubts: tuple[str, ...] = ()
    _blurred: dict[float, Float32] = field(default_factory=dict)

    @classmethod
    def of(cls, prediction: Prediction) -> Self | None:
        """Make it of a prediction; None if it has no depth or is invalid."""
        boundary, depth = prediction.boundary, prediction.depth
        if depth is None or not prediction.valid or IMAGE_CONSTANT in prediction.degraded:
            return None
        if boundary is None:  # then depth alone is judged
            boundary = np.zeros_like(depth)
        step = shrink_factor(depth.shape)
        doubts = tuple(each for each in IMAGE_DOUBTS if each in prediction.degraded)
        return cls(_shrunk(boundary, step), _shrunk(log_depth(depth), step), doubts)

    @cached_property
    def evidence(self) -> tuple[float, float]:
        """Strength of the boundaries, and how well they agree with the steps of the depth.

        These are their standard deviation and a correlation. A model that sees little answers weak
        boundaries, or boundaries and depth that have nothing to do with each other.
        """
        if not self.boundary.any():
            return np.inf, np.inf
        smooth = cv2.GaussianBlur(self.log_depth, (0, 0), 1.0)
        steps = cv2.morphologyEx(smooth, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
        near = cv2.GaussianBlur(self.boundary, (0, 0), 2.0)
        both = (np.asarray(each, np.float64).ravel() for each in (near, np.minimum(steps, _STEP)))
        return float(self.boundary.std()), correlation(*both)

    def blurred(self, blur: float) -> Float32:
        """The boundary, blurred by a share of the image's height."""
        if blur not in self._blurred:
            sigma = blur * len(self.boundary)
            self._blurred[blur] = cv2.GaussianBlur(self.boundary, (0, 0), sigma)  # type: ignore[assignment]
        return self._blurred[blur]


@dataclass(frozen=True, eq=False)
class View:
    """The returns of a frame and the answer to its image alone.

    Attributes:
        answer: the answer to the image alone.
        points: float32 (N, 3) or wider, metres, LiDAR frame, at the time of the image; the returns
            of a depth map are in the camera's frame.
        intrinsics, extrinsics, lens: as in `Calibration`; the given ones, or those of a reading.
        size: (height, width) of the image.
        is_map: whether the returns are those of a depth map.
        name: name of the frame.
        beside: scans of other times, by the words for their time.
        others: returns the answer to a changed image of the frame, `UPSIDE_DOWN` or
            `LEFT_HALF`; None if there is none.
        depth_scale: units per metre with which a depth map was read; None if it was in metres.
        focal_px: focal length that the model used; None if it used none.
    """

    answer: Answer
    points: Points
    intrinsics: Float64
    extrinsics: Float64
    lens: Lens | None
    size: Size
    is_map: bool = False
    name: str = ""
    beside: Mapping[str, Points] = field(default_factory=dict)
    others: Callable[[str], Answer | None] = lambda change: None
    depth_scale: float | None = None
    focal_px: float | None = None

    @cached_property
    def structure(self) -> tuple[Points, Points]:
        """Samples of the returns near the image and of the jumps among them.

        float32 (N, 3), metres, in the axes of the camera and from the origin of the LiDAR.
        """
        turned = self.points[:, :3] @ self.extrinsics[:3, :3].T.astype(np.float32)
        nearest_m = 0 if self.is_map else _NEAREST_M
        camera = self.intrinsics, self.lens, self.size
        turned = turned[is_near(turned + self.extrinsics[:3, 3], *camera, nearest_m=nearest_m)]
        return _sample(turned, _MOST_RETURNS), _sample(turned[find_jumps(turned)], _MOST_JUMPS)

    @property
    def has_structure(self) -> bool:
        """Whether there are enough returns and jumps to compute with."""
        returns, jumps = self.structure
        return len(jumps) >= LEAST_JUMPS and len(returns) >= LEAST_RETURNS

    def near(self, *, turn: Float64 | None = None, **changes: Any) -> Self:
        """The view with a small change of the calibration; returns and jumps are not chosen again.

        Args:
            turn: float64 (3, 3), by which the returns turn about the LiDAR's origin.
            **changes: new attributes.
        """
        changed, structure = replace(self, **changes), self.structure
        if turn is not None:
            extrinsics = changed.extrinsics.copy()
            extrinsics[:3, :3] = turn @ extrinsics[:3, :3]
            changed = replace(changed, extrinsics=extrinsics)
            back = turn.T.astype(np.float32)
            structure = structure[0] @ back, structure[1] @ back
        changed.__dict__["structure"] = structure
        return changed

    def pixels(
        self, points: Points, turn: Float64 | None = None
    ) -> tuple[Indices, Indices, Float32]:
        """Row and column in the answer, and depth [m], of points like those of `structure`."""
        place = self.extrinsics[:3, 3].astype(np.float32)
        turned = (points if turn is None else points @ turn.T.astype(np.float32)) + place
        turned = turned[turned[:, 2] > _LEAST_Z_M]
        z = turned[:, 2]
        rays = turned[:, 0] / z, turned[:, 1] / z
        places = pixels_of_rays(*rays, self.lens, self.intrinsics, self.size)
        height, width = self.answer.boundary.shape
        step = shrink_factor(self.size)
        column, row = (np.rint((each + 0.5) / step - 0.5).astype(np.intp) for each in places)
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        return row[inside], column[inside], z[inside]


def is_near(
    points: Floats,
    intrinsics: Float64,
    lens: Lens | None,
    size: Size,
    *,
    nearest_m: float = _NEAREST_M,
) -> Bools:
    """Return which points (N, 3) of the camera's frame are in an image or a little beside it."""
    if lens is not None:
        left, right, top, bottom, _ = map(float, ray_bounds(lens, cache_key(intrinsics), size))
    else:
        corners = np.array([0, size[1]]), np.array([0, size[0]])
        (left, right), (top, bottom) = to_image_plane(intrinsics, *corners)
    x, y, z = points.astype(np.float32, copy=False).T
    near = (z > nearest_m) & (x > (left - _MARGIN) * z) & (x < (right + _MARGIN) * z)
    return np.asarray(near & (y > (top - _MARGIN) * z) & (y < (bottom + _MARGIN) * z))


def log_depth(depth: Float32) -> Float32:
    """Logarithm of a predicted or measured depth in metres, float32 of the same shape."""
    return np.asarray(np.log(np.maximum(depth, np.float32(_LEAST_DEPTH_M))))


def correlation(first: Floats, second: Floats) -> float:
    """Pearson's correlation; 0 if an array is constant."""
    first, second = (each - each.mean() for each in (first.astype(float), second.astype(float)))
    spread = float(np.sqrt((first @ first) * (second @ second)))
    return float(first @ second) / spread if spread > 1e-6 else 0.0


def shrink_factor(size: tuple[int, ...]) -> int:
    """Factor by which the answers to an image of this (height, width) are shrunk."""
    return max(1, size[0] // _ROWS)


def find_jumps(points: Points) -> Bools:
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


def _sample(points: Points, most: int) -> Points:
    return points[:: len(points) // most + 1]


def _shrunk(answer: Float32, step: int) -> Float32:
    """Means of step x step pixels; an incomplete last row or column is left out."""
    height, width = answer.shape[0] // step, answer.shape[1] // step
    whole = answer[: height * step, : width * step]
    return cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)  # type: ignore[return-value]
