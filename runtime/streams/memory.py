"""Earlier returns, moved by poses into the present frame, where the present scan allows them.

An earlier return is used where its depth lies between those of the present returns around it, but
not at edges of the depth and not near traffic. A car that drove on thus leaves no trail, what is
hidden now does not shine through, and nothing is added where the present scan measures nothing.
"""

from collections import deque
from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.base.arguments import check_number
from runtime.base.errors import InputError
from runtime.engine.prediction import Prediction
from runtime.engine.preprocess import check_sparse_depth
from runtime.geometry.calibration import Calibration
from runtime.geometry.lens import cache_key, rays, to_image_plane
from runtime.geometry.poses import PoseBuffer
from runtime.geometry.projection import find_pixels
from runtime.geometry.returns import is_measured
from runtime.geometry.rig import LONGEST_MEMORY_S
from runtime.geometry.rigid import nearest_rigid

DEFAULT_MEMORY_S = 2.0
# A scan is remembered if the camera moved this far since the last one, and used from there on. A
# standing car thus adds nothing. Otherwise returns that a check holds out would come back.
_LEAST_WAY_M = 0.3
_SCANS, _POINTS = 10, 10_000  # most scans, and most returns of each
_TOLERANCE = 1.03  # of the depths between which a remembered return must lie
_CELL = 4  # columns of a cell of the gate, which compares with this cell and one on each side
_LINE_ROWS = 1  # rows above and below a return that belong to its scan line
_MOST_GAPS = 4.0  # a scan line bounds what is at most so many gaps between lines from it
# A remembered return is dropped if one within so many pixels has less than this share of its depth,
# since it may be hidden, or if it has less than that share of another's, since returns on the near
# side of an edge alone would move it.
_EDGE_COLUMNS, _HIDDEN_SHARE, _EDGE_SHARE = 2, 0.9, 0.5
_EDGE_ROWS = (2, 8)  # half the rows between two lines, within these
# None is added where traffic of the last scan is or may have come since: so many metres nearer to
# the camera, columns as a share of the focal length, and a gap between lines beside it.
_NEARER_M, _TRAFFIC_COLUMNS = (0, 0.75, 1.5), 1 / 45
# What the figures of poses are, see `_Guard`.
_LEAST_BESIDE, _LEAST_FRAMES, _FRAMES = 20, 3, 5
_MOST_APART, _MOST_REJECTED = 0.01, 0.5
_PAUSE_S = 5.0

# Names of the classes of what may move.
_MAY_MOVE = {"car", "van", "truck", "bus", "train", "tram", "motorcycle", "bicycle", "caravan"}
_MAY_MOVE |= {"pedestrian", "person", "rider", "cyclist", "bicyclist", "motorcyclist", "trailer"}

Depth = NDArray[np.float32]


class Remembered(NamedTuple):
    """What a memory adds to a frame.

    Attributes:
        returns: float32 (H, W), metres along the optical axis, 0 = none: earlier returns where the
            frame has none of its own.
        returned: number of these returns.
        rejected_share: share of the earlier returns that the present ones around them contradict;
            None if there are none.
        off: why nothing is added although there are earlier returns; "" = nothing is wrong.
    """

    returns: Depth
    returned: int = 0
    rejected_share: float | None = None
    off: str = ""


class _Scan(NamedTuple):
    """The returns of a frame.

    Attributes:
        points: float32 (3, N), metres, in the frame of its camera.
        pixel: row * W + column of each, (N,).
        pose: float64 (4, 4), of the camera.
        stamp_ns: time of the image.
    """

    points: Depth
    pixel: NDArray[np.int64]
    pose: NDArray[np.float64]
    stamp_ns: int

    def only(self, mask: NDArray[np.bool_]) -> "_Scan":
        points = np.ascontiguousarray(self.points[:, mask])
        return self._replace(points=points, pixel=self.pixel[mask])


class ScanMemory:
    """Remembers the returns of the last frames of one camera. Not thread-safe.

    ```python
    memory = ScanMemory()
    for rgb, sparse_depth, pose, stamp_ns in frames:  # in the order of time
        earlier = memory.recall(sparse_depth, pose, stamp_ns, calibration).returns
        prediction = predictor.predict(rgb, np.where(earlier > 0, earlier, sparse_depth))
        memory.answered(prediction)  # so that traffic leaves no trail
    ```

    Whatever does not continue the frames before empties the memory and is counted in `cleared`: a
    stamp that is not later or comes after a gap longer than the memory, a jump of the poses,
    another calibration or size.

    Args:
        seconds: how long a return is remembered.

    Attributes:
        cleared: why the memory was emptied -> how often.

    Raises:
        InputError: if `seconds` is out of range.
    """

    def __init__(self, seconds: float = DEFAULT_MEMORY_S) -> None:
        check_number("seconds", seconds, 0.01, LONGEST_MEMORY_S, error=InputError)
        self._longest_ns = round(seconds * 1e9)
        self._scans: deque[_Scan] = deque(maxlen=_SCANS)
        self._poses = PoseBuffer(capacity=4)  # judges whether a pose continues the motion
        self._sensor: tuple[Any, ...] | None = None
        self._last_ns: int | None = None
        self._guard = _Guard()
        # The returns of the last frame, and those of them on which its answer shows traffic.
        self._last: _Scan | None = None
        self._traffic: _Scan | None = None
        self.cleared: dict[str, int] = {}

    def clear(self, reason: str) -> None:
        """Forget everything; the reason is counted if there was something to forget."""
        if self._scans:
            self.cleared[reason] = self.cleared.get(reason, 0) + 1
        self._scans.clear()
        self._poses, self._sensor, self._last_ns = PoseBuffer(capacity=4), None, None
        self._last = self._traffic = None
        self._guard = _Guard()

    def recall(
        self,
        sparse_depth: Depth,
        pose: NDArray[np.floating[Any]],
        stamp_ns: int,
        calibration: Calibration,
    ) -> Remembered:
        """Return the earlier returns for a frame, and remember its own.

        Args:
            sparse_depth: float32 (H, W), metres along the optical axis, 0 = no return.
            pose: float (4, 4), rigid, from the LiDAR's frame at the time of the image to a frame
                that is fixed over seconds, which may be far from its origin.
            stamp_ns: time of the image in nanoseconds.
            calibration: calibration of the camera.

        Raises:
            InputError: if an array has another type or shape, or the pose is not rigid. The memory
                is then as it was.
        """
        present = check_sparse_depth(sparse_depth, size=np.shape(sparse_depth)[:2])
        calibration.require_size(present.shape)
        present = np.where(is_measured(present), present, np.float32(0))
        camera = nearest_rigid("pose", pose) @ _inverse(calibration.extrinsics)
        self._follow(camera, stamp_ns, calibration, present.shape)
        ways_m = [float(np.linalg.norm(scan.pose[:3, 3] - camera[:3, 3])) for scan in self._scans]
        moved = [s for s, way_m in zip(self._scans, ways_m, strict=True) if way_m >= _LEAST_WAY_M]
        found = self._remembered(moved, present, camera, stamp_ns, calibration)
        self._last, self._traffic = _Scan(*_unproject(present, calibration), camera, stamp_ns), None
        if len(moved) == len(ways_m):  # this frame is far enough from all of them
            self._scans.append(self._last)
        return found

    def answered(self, prediction: Prediction) -> None:
        """Forget returns of the last frame where its answer shows traffic, and add none there."""
        if prediction.semantic is None or self._last is None:
            return
        names = [name.lower() in _MAY_MOVE for name in prediction.class_names]
        moves = np.array(names + [False] * 256)[prediction.semantic.take(self._last.pixel)]
        self._traffic = self._last.only(moves)
        if self._scans and self._scans[-1] is self._last:
            self._scans[-1] = self._last.only(~moves)

    def _follow(
        self, camera: NDArray[np.float64], stamp_ns: int, calibration: Calibration, size: Any
    ) -> None:
        """Forget what is too old, and everything if the frame does not continue those before."""
        numbers = cache_key(calibration.intrinsics), cache_key(calibration.extrinsics)
        sensor = (size, *numbers, calibration.lens_model)
        if self._last_ns is not None and stamp_ns <= self._last_ns:
            self.clear("stamps do not rise")
        elif self._last_ns is not None and stamp_ns - self._last_ns > self._longest_ns:
            self.clear("a gap longer than the memory")
        elif self._sensor not in (None, sensor):
            self.clear("another calibration or size")
        self._poses.add(camera, stamp_ns)
        if self._poses.between(stamp_ns, stamp_ns).jumped[-1]:
            self.clear("the poses jump")
            self._poses.add(camera, stamp_ns)
        self._last_ns, self._sensor = stamp_ns, sensor
        while self._scans and stamp_ns - self._scans[0].stamp_ns > self._longest_ns:
            self._scans.popleft()

    def _remembered(
        self,
        scans: list[_Scan],
        present: Depth,
        camera: NDArray[np.float64],
        stamp_ns: int,
        calibration: Calibration,
    ) -> Remembered:
        returns = np.zeros_like(present)
        if not scans or self._guard.pauses(stamp_ns):
            return Remembered(returns, off=self._guard.off)
        first = max(int(np.argmax(present.any(axis=1))) - _LINE_ROWS, 0)
        view, cut = present[first:], first * present.shape[1]  # nothing bounds what lies above

        def seen(scan: _Scan, nearer_m: float = 0) -> tuple[NDArray[np.int64], Depth]:
            """Pixels in the view and depths."""
            move, lens = relative(scan.pose, camera), calibration.lens_model
            move[2, 3] -= nearer_m
            places = find_pixels(
                scan.points, calibration.intrinsics, move, present.shape, lens=lens
            )
            below = np.flatnonzero(places.pixel >= cut)
            return places.pixel.take(below) - cut, places.depth.take(below)

        pixel, depth = map(np.concatenate, zip(*map(seen, scans), strict=True))
        own, lines = view.reshape(-1).take(pixel), ScanLines.of(view)
        beside = np.flatnonzero(own > 0)
        apart = np.abs(np.log(depth.take(beside) / own.take(beside)))
        is_free = own <= 0
        if self._traffic is not None:
            clear: NDArray[Any] = np.ones(view.shape, np.uint8)
            for nearer_m in _NEARER_M:
                clear.reshape(-1)[seen(self._traffic, nearer_m)[0]] = 0
            columns = round(_TRAFFIC_COLUMNS * calibration.focal_length_px)
            clear = cv2.erode(clear, _window(round(lines.gap), columns))
            is_free &= clear.reshape(-1).take(pixel) > 0
        free = np.flatnonzero(is_free)
        pixel, depth = pixel.take(free), depth.take(free)
        bounded, between = lines.bounds(pixel, depth)
        allowed = np.flatnonzero(bounded & between)
        count = np.count_nonzero(bounded)
        rejected = 1 - len(allowed) / count if count else None
        if not self._guard.add(apart, rejected, stamp_ns):
            return Remembered(returns, rejected_share=rejected, off=self._guard.off)
        pixel, nearest = pixel.take(allowed), np.where(view > 0, view, np.float32(np.inf))
        _keep_least(nearest, pixel, depth.take(allowed))
        off_edges = pixel[~_is_edge(nearest, pixel, lines.gap)]
        returns[first:].reshape(-1)[off_edges] = nearest.reshape(-1).take(off_edges)
        return Remembered(returns, int(np.count_nonzero(returns)), rejected)


def _is_edge(nearest: Depth, pixel: NDArray[np.int64], gap: float) -> NDArray[np.bool_]:
    """Whether a return around each pixel is much nearer or farther; infinite = no return."""
    window = _window(int(np.clip(round(gap / 2), *_EDGE_ROWS)), _EDGE_COLUMNS)
    depth = nearest.reshape(-1).take(pixel)
    least = cv2.erode(nearest, window).reshape(-1).take(pixel)
    returns = np.where(nearest < np.inf, nearest, np.float32(0))
    greatest = cv2.dilate(returns, window).reshape(-1).take(pixel)
    return np.asarray((least < _HIDDEN_SHARE * depth) | (depth < _EDGE_SHARE * greatest))


def _window(rows: int, columns: int) -> NDArray[np.uint8]:
    """A window of so many pixels on each side of its middle."""
    return np.ones((2 * rows + 1, 2 * columns + 1), np.uint8)


class ScanLines(NamedTuple):
    """The scan lines of a depth map at each row and cell of columns, arrays (H, cells).

    Rows that have returns in the three cells of columns around a pixel form scan lines; rows beside
    each other are one line.

    Attributes:
        nearest: depth of the nearest return of the line at the cell; infinite = no line.
        farthest: depth of the farthest return; 0 = no line.
        above: a row of the next line above the cell's own line; -1 = none.
        below: a row of the next line below; H = none.
        gap: rows between two lines, the median of the picture.
        width: columns of the picture.
    """

    nearest: Depth
    farthest: Depth
    above: NDArray[np.int16]
    below: NDArray[np.int16]
    gap: float
    width: int

    @classmethod
    def of(cls, present: Depth) -> "ScanLines":
        """Find the lines of `present`, float32 (H, W), metres, 0 = no return."""
        height, width = present.shape
        cells = -(-width // _CELL)
        pixel = np.flatnonzero(present > 0)
        row, column = np.divmod(pixel, width)
        at, depth = row * cells + column // _CELL, present.reshape(-1).take(pixel)
        nearest = np.full((height, cells), np.inf, np.float32)
        farthest = np.zeros((height, cells), np.float32)
        _keep_least(nearest, at, depth)
        _keep_least(farthest, at, -depth)
        kernel = np.ones((2 * _LINE_ROWS + 1, 3), np.uint8)
        nearest = np.asarray(cv2.erode(nearest, kernel), np.float32)
        farthest = -np.asarray(cv2.erode(farthest, kernel), np.float32)
        has = farthest > 0
        rows = np.arange(height, dtype=np.int16)[:, None]
        above = np.maximum.accumulate(np.where(has, rows, np.int16(-1)), axis=0)
        below = np.minimum.accumulate(np.where(has, rows, np.int16(height))[::-1], axis=0)[::-1]
        seen = ~has & (above >= 0) & (below < height)
        gap = float(np.median((below - above)[seen])) if seen.any() else 1.0
        # Rows of a line have the next lines of the rows where it starts and ends.
        above = np.maximum.accumulate(np.where(has, np.int16(-1), above), axis=0)
        below = np.minimum.accumulate(np.where(has, np.int16(height), below)[::-1], axis=0)[::-1]
        return cls(nearest, farthest, above, below, gap, width)

    def bounds(
        self, pixel: NDArray[np.int64], depth: Depth
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return where present returns bound a depth, and where it lies between them, bool (N,).

        The pixel's own line, the next one above and the next one below bound its depth, if its own
        line or both others are there.

        Args:
            pixel: row * W + column of each depth.
            depth: float32 (N,), metres.
        """
        row, column = np.divmod(pixel, self.width)
        height, cells = self.nearest.shape
        cell = column // _CELL
        at = row * cells + cell
        above, below = (each.take(at).astype(np.int64) for each in (self.above, self.below))
        most = _MOST_GAPS * self.gap
        has_above = (above >= 0) & (row - above <= most)
        has_below = (below < height) & (below - row <= most)
        least, greatest = self.nearest.take(at), self.farthest.take(at)
        is_on_line = greatest > 0
        for there, line in ((has_above, above), (has_below, below)):
            bound = np.where(there, line * cells + cell, at)
            least = np.minimum(least, self.nearest.take(bound))
            greatest = np.maximum(greatest, self.farthest.take(bound))
        is_between = (depth * _TOLERANCE > least) & (depth < greatest * _TOLERANCE)
        return is_on_line | (has_above & has_below), np.asarray(is_between)


def _keep_least(array: Depth, at: NDArray[np.int64], values: Depth) -> None:
    """Write the least of the values of each place, unless the array has a lower one there."""
    flat = array.reshape(-1)
    while len(lower := np.flatnonzero(values < flat.take(at))):  # rarely more than 5 times
        at, values = at.take(lower), values.take(lower)
        flat[at] = values


class _Guard:
    """Switches a memory off while its returns do not fit the present ones, as with wrong poses.

    The figures are medians over the last frames, since a single pose may be wrong, as the first of
    an odometry: the median of |log ratio| of remembered and present returns on the same pixel, and
    the share of remembered returns that is rejected.
    """

    def __init__(self) -> None:
        self.off = ""
        self._off_until_ns = 0
        self._apart: deque[float] = deque(maxlen=_FRAMES)
        self._rejected: deque[float] = deque(maxlen=_FRAMES)

    def pauses(self, stamp_ns: int) -> bool:
        return bool(self.off) and stamp_ns < self._off_until_ns

    def add(self, apart: Depth, rejected: float | None, stamp_ns: int) -> bool:
        """Add the figures of a frame; return whether the memory may be used for it."""
        if self.off:  # tried again, from the figures from here on
            self.off = ""
            self._apart.clear()
            self._rejected.clear()
        if len(apart) >= _LEAST_BESIDE:
            self._apart.append(float(np.median(apart)))
        if rejected is not None:
            self._rejected.append(rejected)
        middle_apart, middle_rejected = map(_middle, (self._apart, self._rejected))
        if middle_apart > _MOST_APART:
            self.off = f"earlier returns are {100 * middle_apart:.1f} % off the present ones"
        elif middle_rejected > _MOST_REJECTED:
            self.off = (
                f"the present scan contradicts {100 * middle_rejected:.0f} % of earlier returns"
            )
        self._off_until_ns = stamp_ns + round(_PAUSE_S * 1e9)
        return not self.off


def _middle(figures: Sequence[float]) -> float:
    """The median; 0 of too few figures."""
    return float(np.median(figures)) if len(figures) >= _LEAST_FRAMES else 0.0


def _unproject(present: Depth, calibration: Calibration) -> tuple[Depth, NDArray[np.int64]]:
    """The returns of a depth map as the points and pixels of a `_Scan`, from pixel centres."""
    pixel = np.flatnonzero(present > 0)
    pixel = pixel[:: -(-len(pixel) // _POINTS) or 1]
    row, column = np.divmod(pixel, present.shape[1])
    depth, lens = present.reshape(-1).take(pixel), calibration.lens_model
    if lens is None:
        x, y = to_image_plane(calibration.intrinsics, column, row)
    else:
        size = present.shape[0], present.shape[1]
        x, y = rays(lens, cache_key(calibration.intrinsics), size)[row, column].T
    points = np.stack([x * depth, y * depth, depth])  # NaN beyond the lens
    return points.astype(np.float32), pixel


def _inverse(rigid: NDArray[np.float64]) -> NDArray[np.float64]:
    inverse = np.eye(4)
    inverse[:3, :3] = rigid[:3, :3].T
    inverse[:3, 3] = -rigid[:3, :3].T @ rigid[:3, 3]
    return inverse


def relative(pose: NDArray[np.float64], to: NDArray[np.float64]) -> NDArray[np.float64]:
    """From a frame to another, both (4, 4) to a fixed one that may be far from its origin."""
    matrix = np.eye(4)
    matrix[:3, :3] = to[:3, :3].T @ pose[:3, :3]
    matrix[:3, 3] = to[:3, :3].T @ (pose[:3, 3] - to[:3, 3])
    return matrix
