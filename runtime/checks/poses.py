"""Whether poses describe the motion of the scans that they move.

There are two tests. Scans: successive scans of objects that stand still must fit each other better
if both are moved to one time. Tracks: a car drives along one of its own axes, even in a turn. Poses
are reported if they fail a test that another reading of them clearly passes: quaternions with w
first, the inverse, or another unit of length. They are also reported if scans that they move fit
far worse than scans that are not moved. A constant shift in time, such as that between the start
and the middle of a scan, changes neither test, and is not found.
"""

import contextlib
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from runtime.base.arrays import Float32, Float64, Int64
from runtime.base.errors import InputError
from runtime.checks.finding import Finding, Severity
from runtime.checks.judge import choose
from runtime.contract.degraded import IMPLAUSIBLE_POSES
from runtime.geometry.motion import compensate_points
from runtime.geometry.poses import PoseTrack, rotations
from runtime.geometry.returns import is_return

_POINTS = 6000  # points of a scan that are compared
_CELL_RAD = np.radians(0.5)  # two returns within a cell have the same direction
_LEAST_SHARED = 300  # least number of returns with a shared direction
_APART_M, _APART_NS = 2.0, 500_000_000  # motion or time between two scans that are compared
_KNOWN, _ENOUGH = 3, 12  # comparisons before a verdict, and before no more are made
# Ratios of medians of |log range ratio|. In drive 0009 of KITTI, with scans 3 m apart, the median
# is 0.010 with the right poses, 0.018 to 0.048 without moving, and 0.056 to 0.074 with the inverse.
# A simulated drive over flat ground has 0.001 without moving, so far apart has a floor.
_BETTER, _FAR_WORSE, _SAME = math.log(1 / 0.7), 3.0, math.log(1.1)
_FAR_APART = 0.03
_MOST_POSES = 2000  # poses of a live stream that are kept
_STEPS, _LEAST_TRAVEL_M = 30, 2.0
_TURNED_RAD, _ALIKE = np.radians(3.0), 1 / 3  # spread of the direction of travel

_Sample = tuple[Float32, Int64 | int]  # points and their times
_STILL, OTHER_POSES = "still", "other_poses"
_IN_UNIT = "read with lengths in {}: check their format"


class PosedScan(NamedTuple):
    """A scan for the comparison: points, their times, and the time of its image."""

    points: Float32
    times: Int64 | int
    image_ns: int


@dataclass(frozen=True)
class PoseReading:
    """What poses may mean instead: in words, and as a function of them."""

    says: str
    apply: Callable[[PoseTrack], PoseTrack]


def _scaled(factor: float) -> Callable[[PoseTrack], PoseTrack]:
    return lambda track: replace(track, positions=track.positions * factor)


def _w_first(track: PoseTrack) -> PoseTrack:
    return replace(track, quaternions=np.roll(track.quaternions, -1, axis=1))


def _inverse(track: PoseTrack) -> PoseTrack:
    turned = rotations(track.quaternions).transpose(0, 2, 1)
    positions = -(turned @ track.positions[:, :, None])[:, :, 0]
    return replace(track, quaternions=track.quaternions * (1, -1, -1, -1), positions=positions)


# The table of other readings of poses.
POSES = {
    "inverse_poses": PoseReading("read as their inverse: check their format", _inverse),
    "w_first": PoseReading(
        "read with w as the first number of the quaternions: check their format", _w_first
    ),
    "poses_in_kilometres": PoseReading(_IN_UNIT.format("kilometres"), _scaled(1000)),
    "poses_in_centimetres": PoseReading(_IN_UNIT.format("centimetres"), _scaled(0.01)),
    "poses_in_millimetres": PoseReading(_IN_UNIT.format("millimetres"), _scaled(0.001)),
}


class PoseJudge:
    """Compares successive scans of a stream, moved by its poses and not moved."""

    def __init__(self) -> None:
        self._before: PosedScan | None = None
        # Log errors of each pair of scans: as the poses are (""), not moved, and by reading.
        self._errors: list[dict[str, float]] = []
        self._track: PoseTrack | None = None  # poses of all frames so far

    def add(self, scan: PosedScan, poses: PoseTrack) -> bool:
        """Add a scan, and return whether `finding` may have changed.

        Scans are ignored after enough of them were compared.
        """
        if len(self._errors) >= _ENOUGH:
            return False
        last = self._track
        if last is None or last.stamps_ns is not poses.stamps_ns:  # else a whole recording
            self._track = poses if last is None else _joined(last, poses)
        if self._before is not None and self._track is not None:
            track = replace(self._track, mount=poses.mount)
            if (errors := _compare(self._before, scan, track)) is None:
                return True
            self._errors.append({name: float(np.log(each)) for name, each in errors.items()})
        self._before = scan
        return True

    def finding(self) -> Finding | None:
        """Return why the poses cannot be right, and the likely cause; None: nothing was found."""
        return self._by_scans() or self._by_track()

    def _by_scans(self) -> Finding | None:
        if len(self._errors) < _KNOWN:
            return None
        errors = {name: np.array([e[name] for e in self._errors]) for name in self._errors[0]}
        medians = {name: float(np.exp(np.median(each))) for name, each in errors.items()}
        moved, still = medians[""], medians[_STILL]
        figures = {"range apart as given": moved, "not moved": still}
        given = np.minimum(errors.pop(""), errors.pop(_STILL))
        gains = {(name, ""): given - each for name, each in errors.items()}
        if (choice := choose(gains, dict.fromkeys(errors, _BETTER), _SAME)) is not None:
            (name, _), *_ = choice.readings
            says = f"successive scans, moved by the poses, fit where they are {POSES[name].says}"
            return _fault(name, says, {**figures, "so": medians[name]})
        if moved > max(_FAR_WORSE * still, _FAR_APART):
            says = (
                "successive scans, moved by the poses, are far apart: the poses may be of another "
            )
            return _fault(OTHER_POSES, says + "drive, clock or frame", figures)
        return None

    def _by_track(self) -> Finding | None:
        if self._track is None or (spread := _spread(self._track)) is None or spread < _TURNED_RAD:
            return None
        spreads = {name: _spread(POSES[name].apply(self._track)) for name in [*POSES][:2]}
        known = {name: each for name, each in spreads.items() if each is not None}
        best = min(known, key=lambda name: known[name], default=None)
        if best is None or known[best] > min(_ALIKE * spread, _TURNED_RAD):
            return None
        says = "by the poses the car drives along an axis of its own that turns; it does not where "
        degrees = {"degrees": float(np.degrees(spread)), "so": float(np.degrees(known[best]))}
        return _fault(best, f"{says}they are {POSES[best].says}", degrees)


def _fault(name: str, says: str, evidence: dict[str, float]) -> Finding:
    return Finding(name, says, Severity.FAULT, evidence, IMPLAUSIBLE_POSES)


def _joined(first: PoseTrack, second: PoseTrack) -> PoseTrack:
    """Both tracks as one, without duplicates; at most `_MOST_POSES` poses are kept."""
    names = ("stamps_ns", "quaternions", "positions", "jumped")
    both = {n: np.concatenate([getattr(first, n), getattr(second, n)]) for n in names}
    _, order = np.unique(both["stamps_ns"], return_index=True)
    return replace(second, **{name: each[order[-_MOST_POSES:]] for name, each in both.items()})


def _compare(first: PosedScan, second: PosedScan, track: PoseTrack) -> dict[str, float] | None:
    """Return the error of each reading; None if the scans are too near or cannot be compared.

    Poses of another unit seem to jump all the time, so jumps are ignored; a few do not change a
    median.
    """
    track = replace(track, jumped=np.zeros_like(track.jumped))
    to, scans = second.image_ns, [_sampled(each) for each in (first, second)]
    try:
        pair = track.at(np.array([first.image_ns, to], np.int64))
        apart_m = np.linalg.norm(pair[1, :3, 3] - pair[0, :3, 3])
        if apart_m < _APART_M and to - first.image_ns < _APART_NS:
            return None
        errors = {"": _moved_error(scans, track, to), _STILL: _error(scans[0][0], scans[1][0])}
    except InputError:  # also without a pose
        return None
    if errors[_STILL] is None:
        return None
    for name, reading in POSES.items():
        errors[name] = None
        with contextlib.suppress(InputError):
            errors[name] = _moved_error(scans, reading.apply(track), to)
    return {name: 1.0 if each is None else max(each, 1e-6) for name, each in errors.items()}


def _moved_error(scans: Iterable[_Sample], track: PoseTrack, to: int) -> float | None:
    return _error(*(compensate_points(*scan, track, to) for scan in scans))


def _sampled(scan: PosedScan) -> _Sample:
    step, times = len(scan.points) // _POINTS + 1, scan.times
    return scan.points[::step, :3], times if isinstance(times, int) else times[::step]


def _error(first: Float32, second: Float32) -> float | None:
    """Return the median of |log(range / range)| over shared directions; None if too few."""
    keys, ranges = zip(
        *(_directions(each[is_return(each)]) for each in (first, second)), strict=True
    )
    unique, place = np.unique(keys[1], return_index=True)
    if not len(unique):
        return None
    at = np.searchsorted(unique, keys[0]).clip(max=len(unique) - 1)
    shared = unique[at] == keys[0]
    if np.count_nonzero(shared) < _LEAST_SHARED:
        return None
    ratio = ranges[0][shared] / ranges[1][place[at[shared]]]
    return float(np.median(np.abs(np.log(ratio))))


def _directions(points: Float32) -> tuple[Int64, Float64]:
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
