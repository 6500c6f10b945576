"""Recognition of the values that sensors write for "no return"."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.base.arguments import array_dtype
from runtime.base.arrays import Bools, Float32
from runtime.base.errors import InputError
from runtime.contract.contract import MAX_DEPTH_RANGE_M
from runtime.geometry.assumptions import assume

_NEAREST_M = 0.01  # nearer points are a rounded (0, 0, 0), which Ouster, Livox and SICK send
_LEAST_JUDGED, _MOST_IMPLAUSIBLE = 50, 0.25
# What marks misses, which share one range:
_EDGE = 4e-4  # their rounding as a share of the range: centimetres at 50 m
_BESIDE = 1e-2  # the part of the range beside them where returns of surfaces would lie
_LEAST_MISSES, _LEAST_MISS_SHARE = 50, 0.01  # their least number, and least share of a scan
_MISSES = 2  # how many times more they are than the returns beside them
# How far they reach from one another, and in height, as shares of the range. The range of a wall of
# that extent varies by 1e-3.
_LEAST_WIDTH, _LEVEL = 0.1, 2e-3
_WIDEST_POINT = 16  # numbers per point; a longer row belongs to an array (3, N)
_SATURATED = 65535  # 16-bit depth without a measurement
# The same value in metres if the unit is KITTI's, millimetres or centimetres.
_SATURATED_M = tuple(np.float32(_SATURATED / units) for units in (256, 1000, 100))


def to_metres(depth: NDArray[Any], units_a_metre: float) -> Float32:
    """Return a depth map in metres, float32; NaN where a 16-bit value is saturated."""
    scale = np.float32(units_a_metre)
    with np.errstate(over="ignore", invalid="ignore"):  # values beyond float32 are no measurement
        metres: Float32 = np.divide(depth, scale, dtype=np.float32, casting="same_kind")
    if depth.dtype.kind == "u":
        metres[depth == _SATURATED] = np.nan
    return metres


def drop_saturated(metres: Float32, farthest: float) -> Float32:
    """Return a depth map with NaN where it was converted from saturated 16-bit values.

    `metres` is float32 (H, W), and is returned itself if nothing changes. Values beyond `farthest`
    are not examined.
    """
    for mark in _SATURATED_M:
        if mark <= farthest and (is_mark := metres == mark).any():
            metres = np.where(is_mark, np.float32(np.nan), metres)
    return metres


def is_measured(depth: Float32) -> Bools:
    """Return where depth is measured, that is not 0, negative, NaN, Inf or the largest float."""
    return (depth > 0) & (depth < np.finfo(np.float32).max)


def check_farthest(depth: Float32) -> None:
    """Warn if many pixels of a depth map have exactly its farthest depth, as at a far plane.

    These pixels are kept, because a wall across the whole view looks the same.
    """
    measured = is_measured(depth)
    count = np.count_nonzero(measured)
    if count < _LEAST_JUDGED:
        return
    farthest = depth.max(where=measured, initial=0)
    at = np.count_nonzero(depth == farthest)
    near = np.count_nonzero((depth < farthest) & (depth > farthest * (1 - 2 * _BESIDE)))
    if at >= max(_LEAST_MISSES, 2 * _LEAST_MISS_SHARE * count) and 4 * near < at < 0.8 * count:
        assume(
            "the many pixels at the farthest depth of a map are returns",
            f"write 0 where there is none, if {farthest:g} m is the end of the sensor's range",
        )


def check_points(points: Any) -> None:
    """Raise InputError if `points` is not a scan, float32 (N, 3) or wider."""
    if (kind := array_dtype(points)) != np.float32:
        hint = "use points.astype(np.float32)"
        raise InputError(f"points must be a plain float32 array [m], got {kind}: {hint}")
    hint = ": use points.T" if is_transposed(points.shape) else ""
    if hint or points.ndim != 2 or points.shape[1] < 3:
        raise InputError(f"points must have the shape (N, 3) or wider, got {points.shape}{hint}")


def is_transposed(shape: tuple[int, ...]) -> bool:
    """Whether an array of points has the shape (3, N) or, with other columns, (4, N) and so on."""
    return len(shape) == 2 and 3 <= shape[0] < shape[1] > _WIDEST_POINT


def is_return(points: Float32, *, name: str = "a scan") -> Bools:
    """Return which points of a scan are returns, bool (N,).

    A point is no return if it is at (0, 0, 0), or a coordinate is NaN, infinite or beyond 10 km.
    Many points at one identical range at the edge of a scan are no returns either: simulators mark
    beams without a return by such points. They are recognised only if the points are in the LiDAR's
    own frame, up to the rounding of coordinates. One scan line on level ground is kept.

    Args:
        points: float32 (N, 3) or wider, x, y, z first, metres.
        name: for the error.

    Raises:
        InputError: if the array holds no points: a quarter of them is beyond 10 km, or they are
            integers that were read as floats.
    """
    extent = np.maximum.reduce([np.abs(points[:, axis]) for axis in range(3)])  # may be NaN
    returns: Bools = (extent >= _NEAREST_M) & (extent <= MAX_DEPTH_RANGE_M)
    count = int(np.count_nonzero(returns))
    if count == len(points):
        return _without_misses(points, returns, count)
    limits = np.finfo(np.float32)
    far = (extent > MAX_DEPTH_RANGE_M) & (extent < limits.max)
    wrong = np.count_nonzero(far | ((extent > 0) & (extent < limits.tiny)))
    if wrong + count >= _LEAST_JUDGED and wrong > _MOST_IMPLAUSIBLE * (wrong + count):
        raise InputError(
            f"{wrong:,} of {wrong + count:,} points of {name} are farther than 10,000 m or no "
            "normal numbers: expected float32, metres; are they of another type (float64, "
            "integers), of records with other fields, or not metres?"
        )
    return _without_misses(points, returns, count)


def _without_misses(points: Float32, returns: Bools, count: int) -> Bools:
    """Return `returns` without the points at the nearest or farthest range that mark misses.

    Surfaces are not spheres around the LiDAR, so far fewer returns lie at the very edge of the
    range than in the hundredth of the range beside it.
    """
    if count < _LEAST_JUDGED:
        return returns
    x, y, z = points[:, 0], points[:, 1], points[:, 2]
    with np.errstate(over="ignore", invalid="ignore"):
        square = x * x + y * y + z * z
    inside = square if count == len(points) else square[returns]
    least = max(_LEAST_MISSES, _LEAST_MISS_SHARE * count)
    for edge, sign in ((float(inside.max()), -1), (float(inside.min()), 1)):
        near, wide = (np.float32(edge * (1 + 2 * sign * width)) for width in (_EDGE, _BESIDE))
        compare = np.greater_equal if sign < 0 else np.less_equal
        at = np.count_nonzero(compare(inside, near))
        if at < least or at < _MISSES * (np.count_nonzero(compare(inside, wide)) - at):
            continue
        marks = returns & compare(square, near)
        # Copies of a single point are not a dome, and neither is one line on level ground.
        if not marks.any():
            continue
        width, height = np.ptp(points[marks, :3], axis=0).max(), np.ptp(z[marks])
        is_ground = height**2 < _LEVEL**2 * edge and z[marks].max() < 0
        if width**2 > _LEAST_WIDTH**2 * edge and not is_ground:
            returns = returns & ~marks
    return returns


def coordinates_of(points: Float32) -> Float32:
    """Return x, y and z of a scan, float32 (3, N), contiguous; NaN where there is no return."""
    axes = np.ascontiguousarray(points[:, :3].T)
    returns = is_return(points)
    return axes if returns.all() else np.where(returns, axes, np.float32(np.nan))
