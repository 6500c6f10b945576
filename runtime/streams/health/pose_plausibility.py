"""Whether poses describe the motion of the scans that they move.

There are two tests. Scans: successive scans of objects that stand still must fit each other better
if both are moved to one time. Tracks: a car drives along one of its own axes, even in a turn. Poses
are reported if they fail a test that another reading of them clearly passes: quaternions with w
first, the inverse, or another unit of length. They are also reported if scans that they move fit
far worse than scans that are not moved. A constant shift in time, such as that between the start
and the middle of a scan, changes neither test, and is not found.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from runtime.base.errors import InputError
from runtime.geometry.motion import compensate_points
from runtime.geometry.poses import NoPoseError, PoseTrack, rotations
from runtime.geometry.returns import is_return
from runtime.streams.frame import Frame
from runtime.streams.messages import Scan

_POINTS = 6000  # points of a scan that are compared
_CELL_RAD = np.radians(0.5)  # two returns within a cell have the same direction
_LEAST_SHARED = 300  # least number of returns with a shared direction
_APART_M, _APART_NS = 2.0, 500_000_000  # motion or time between two scans that are compared
_KNOWN, _ENOUGH = 3, 12  # comparisons before a verdict, and before no more are made
# Ratios of medians of |log range ratio|. In drive 0009 of KITTI, with scans 3 m apart, the median
# is 0.010 with the right poses, 0.018 to 0.048 without moving, and 0.056 to 0.074 with the inverse.
_BETTER, _FAR_WORSE, _SAME = 0.7, 3.0, 1.1
_MOST_POSES = 2000  # poses of a live stream that are kept
_STEPS, _LEAST_TRAVEL_M = 30, 2.0
_TURNED_RAD, _ALIKE = np.radians(3.0), 1 / 3  # spread of the direction of travel

Reading = Callable[[PoseTrack], PoseTrack]


def _scaled(factor: float) -> Reading:
    return lambda track: replace(track, positions=track.positions * factor)


def _w_first(track: PoseTrack) -> PoseTrack:
    return replace(track, quaternions=np.roll(track.quaternions, -1, axis=1))


def _inverse(track: PoseTrack) -> PoseTrack:
    turned = rotations(track.quaternions).transpose(0, 2, 1)
    positions = -(turned @ track.positions[:, :, None])[:, :, 0]
    return replace(track, quaternions=track.quaternions * (1, -1, -1, -1), positions=positions)


# Other readings of poses, in words, and the functions that read poses so.
READINGS: dict[str, Reading] = {
    "as their inverse": _inverse,
    "with w as the first number of the quaternions": _w_first,
    "with lengths in kilometres": _scaled(1000),
    "with lengths in centimetres": _scaled(0.01),
    "with lengths in millimetres": _scaled(0.001),
}


class PosePlausibility:
    """Compares successive scans of a stream, moved by its poses and not moved."""

    def __init__(self) -> None:
        self._before: Frame | None = None
        # Logarithms of the errors of each reading; "" stands for the poses as they are.
        self._errors: list[dict[str, float]] = []
        self._track: PoseTrack | None = None  # poses of all frames so far

    def add(self, frame: Frame) -> bool:
        """Add a frame, and return whether `finding` may have changed.

        A frame without poses or a scan of its own is ignored, and so is each frame after enough
        frames were compared.
        """
        scan = frame.own_depth
        if len(self._errors) >= _ENOUGH or frame.poses is None:
            return False
        if not isinstance(scan, Scan) or scan.times is None:
            return False
        last = self._track
        if last is None or last.stamps_ns is not frame.poses.stamps_ns:  # else a whole recording
            self._track = frame.poses if last is None else _joined(last, frame.poses)
        if self._before is None:
            self._before = frame
            return True
        assert self._track is not None
        track = replace(self._track, mount=frame.poses.mount)
        if (errors := _compare(self._before, frame, track)) is not None:
            self._errors.append(errors)
            self._before = frame
        return True

    def finding(self) -> str | None:
        """Return why the poses cannot be right, and the likely cause; None: nothing was found."""
        return self._by_scans() or self._by_track()

    def _by_scans(self) -> str | None:
        if len(self._errors) < _KNOWN:
            return None
        error = {
            name: float(np.median([e[name] for e in self._errors])) for name in self._errors[0]
        }
        moved, still = error.pop(""), error.pop("still")
        # On a straight road some readings give the same result; the first of them counts.
        best = next(name for name in error if error[name] <= _SAME * min(error.values()))
        figures = f"{moved:.1%} of the range apart, not moved {still:.1%}"
        if error[best] < _BETTER * min(moved, still):
            return (
                f"successive scans, moved by the poses, are {figures}, and {error[best]:.1%} "
                f"where the poses are read {best}: check their format"
            )
        if moved > _FAR_WORSE * still:
            return (
                f"successive scans, moved by the poses, are {figures}: the poses may be of another "
                "drive, clock or frame"
            )
        return None

    def _by_track(self) -> str | None:
        if self._track is None or (spread := _spread(self._track)) is None or spread < _TURNED_RAD:
            return None
        spreads = {name: _spread(READINGS[name](self._track)) for name in [*READINGS][:2]}
        known = {name: each for name, each in spreads.items() if each is not None}
        best = min(known, key=lambda name: known[name], default=None)
        if best is None or known[best] > min(_ALIKE * spread, _TURNED_RAD):
            return None
        return (
            f"by the poses the car drives along an axis of its own that turns by "
            f"{np.degrees(spread):.0f} degrees, and by {np.degrees(known[best]):.1f} where the "
            f"poses are read {best}: check their format"
        )


def _joined(first: PoseTrack, second: PoseTrack) -> PoseTrack:
    """Both tracks as one, without duplicates; at most `_MOST_POSES` poses are kept."""
    new = ~np.isin(second.stamps_ns, first.stamps_ns)
    stamps = np.concatenate([first.stamps_ns, second.stamps_ns[new]])
    order = np.argsort(stamps, kind="stable")[-_MOST_POSES:]
    names = ("quaternions", "positions", "jumped")
    arrays = {
        name: np.concatenate([getattr(first, name), getattr(second, name)[new]])[order]
        for name in names
    }
    return replace(second, stamps_ns=stamps[order], **arrays)


def _compare(before: Frame, frame: Frame, track: PoseTrack) -> dict[str, float] | None:
    """Return the error of each reading; None if the scans are too near or cannot be compared.

    Poses of another unit seem to jump all the time, so jumps are ignored; a few do not change a
    median.
    """
    track = replace(track, jumped=np.zeros_like(track.jumped))
    from_ns, to = before.image.time_ns, frame.image.time_ns
    scans = [_sampled(each.scan) for each in (before, frame) if each.scan is not None]
    try:
        pair = track.at(np.array([from_ns, to], np.int64))
        if np.linalg.norm(pair[1, :3, 3] - pair[0, :3, 3]) < _APART_M and to - from_ns < _APART_NS:
            return None
        errors = {"": _error(*(compensate_points(*scan, track, to) for scan in scans))}
        errors["still"] = _error(scans[0][0], scans[1][0])
    except (NoPoseError, InputError):
        return None
    if errors["still"] is None:
        return None
    for name, reading in READINGS.items():
        try:
            errors[name] = _error(*(compensate_points(*scan, reading(track), to) for scan in scans))
        except InputError:
            errors[name] = None
    return {name: 1.0 if each is None else each for name, each in errors.items()}


def _sampled(scan: Scan) -> tuple[NDArray[np.float32], NDArray[np.int64] | int]:
    step = len(scan.points) // _POINTS + 1
    times = scan.times
    assert times is not None
    return scan.points[::step, :3], times if isinstance(times, int) else times[::step]


def _error(first: NDArray[np.float32], second: NDArray[np.float32]) -> float | None:
    """Return the median of |log(range / range)| over shared directions; None if too few."""
    keys, ranges = zip(
        *(_directions(each[is_return(each)]) for each in (first, second)), strict=True
    )
    unique, place = np.unique(keys[1], return_index=True)
    at = np.clip(np.searchsorted(unique, keys[0]), 0, len(unique) - 1) if len(unique) else []
    shared = unique[at] == keys[0] if len(unique) else np.zeros(0, bool)
    if np.count_nonzero(shared) < _LEAST_SHARED:
        return None
    ratio = ranges[0][shared] / ranges[1][place[np.asarray(at)[shared]]]
    return float(np.median(np.abs(np.log(ratio))))


def _directions(points: NDArray[np.float32]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The cell of each return's direction, and its range."""
    x, y, z = points.T.astype(np.float64)
    ranges = np.sqrt(x * x + y * y + z * z)
    turn = np.rint(np.arctan2(y, x) / _CELL_RAD).astype(np.int64)
    height = np.rint(np.arcsin(np.clip(z / ranges, -1, 1)) / _CELL_RAD).astype(np.int64)
    return turn * 10_000 + height, ranges


def _spread(track: PoseTrack) -> float | None:
    """RMS deviation of the direction of travel in the moving frame [rad]; None if unknown."""
    moved = np.linalg.norm(np.diff(track.positions, axis=0), axis=1)
    way = np.concatenate([[0.0], np.cumsum(moved)])
    if len(way) < 3 or way[-1] < _LEAST_TRAVEL_M:
        return None
    at = np.unique(np.searchsorted(way, np.linspace(0, way[-1], _STEPS)).clip(max=len(way) - 1))
    steps = np.diff(track.positions[at], axis=0)
    inside = (rotations(track.quaternions[at[:-1]]).transpose(0, 2, 1) @ steps[:, :, None])[:, :, 0]
    inside /= np.maximum(np.linalg.norm(inside, axis=1, keepdims=True), 1e-9)
    mean = inside.mean(axis=0)
    return float(np.arccos(np.clip(np.linalg.norm(mean), 0, 1)))
