"""Faults that the stamps of two sensors show: a silent sensor, or two different clocks."""

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np

from runtime.base.arrays import Int64
from runtime.base.stamp import NS_PER_MS
from runtime.geometry.assumptions import assume

# A sensor is silent after so long without a message, but not before `_PERIODS` of its periods.
SILENT_NS = 500 * NS_PER_MS
_PERIODS = 3.0
_LEAST_OFFSETS = 3  # least number of messages of each sensor in a part of the recording
_PARTS = 4
_LIVE = 30  # messages of each sensor that are compared in a live stream


def find_silences(
    stamps_ns: Int64 | Sequence[int], first_ns: int, last_ns: int
) -> list[tuple[int, int]]:
    """Return the times in which a sensor sent nothing, as (from, to) [ns].

    Args:
        stamps_ns: stamps of its messages, in any order.
        first_ns: start of the recording, over all sensors.
        last_ns: end of the recording, over all sensors.
    """
    stamps = np.unique(np.asarray(stamps_ns, np.int64))
    if not stamps.size:
        return []
    intervals = np.diff(stamps)
    # Up to a quarter of the intervals may be gaps themselves.
    period_ns = float(np.percentile(intervals, 75, method="lower")) if intervals.size else 0.0
    longest_ns = max(SILENT_NS, _PERIODS * period_ns)
    edges = np.concatenate([[min(first_ns, stamps[0])], stamps, [max(last_ns, stamps[-1])]])
    return [
        (int(edges[at]), int(edges[at + 1])) for at in np.flatnonzero(np.diff(edges) > longest_ns)
    ]


def clocks_apart_s(
    image_ns: Sequence[int],
    depth_ns: Sequence[int],
    period_ns: float,
    *,
    is_scan: bool,
    parts: int = _PARTS,
) -> float | None:
    """Return by how many seconds the clock of the depth is ahead of that of the images.

    A clock that is set or drifts during the recording differs in one of its parts.

    Args:
        image_ns: stamp - time of recording of each image [ns], in the order of time.
        depth_ns: the same for the depth.
        period_ns: period of the depth.
        is_scan: whether the depth comes from scans. A scan is recorded when it ends, so up to a
            period after a stamp that marks its start.
        parts: largest number of parts.

    Returns:
        Seconds of the largest difference, or None if it is at most half a period, which drivers
        may take.
    """
    parts = min(parts, min(len(image_ns), len(depth_ns)) // _LEAST_OFFSETS)
    if not parts:
        return None
    pairs = zip(np.array_split(image_ns, parts), np.array_split(depth_ns, parts), strict=True)
    ahead_ns = [float(np.median(depth) - np.median(image)) for image, depth in pairs]
    middle_ns = -period_ns / 2 if is_scan else 0.0
    worst_ns = max(ahead_ns, key=lambda ns: abs(ns - middle_ns))
    return worst_ns / 1e9 if abs(worst_ns - middle_ns) > period_ns / 2 - middle_ns else None


def report_clocks(
    ahead_s: float | None, image: str = "the images", depth: str = "the depth", by: str = "arrival"
) -> bool:
    """Report the assumption of one clock, and return whether `clocks_apart_s` contradicts it.

    Args:
        ahead_s: the result of `clocks_apart_s`.
        image: name of the images.
        depth: name of the depth.
        by: what the stamps were compared with.
    """
    if ahead_s is None:
        return False
    assume(
        "the stamps of both sensors are of one clock",
        f"by the time of {by} that of {depth} is {abs(ahead_s):.3g} s "
        f"{'ahead of' if ahead_s > 0 else 'behind'} that of {image}; synchronise the clocks, or "
        "correct the stamps",
    )
    return True


class LiveClocks:
    """Compares the clocks of a live stream by the arrival of its messages, until they differ.

    The last 30 messages of each sensor are compared as one part, because a few may arrive late
    together.
    """

    def __init__(self) -> None:
        self._image_ns, self._depth_ns = (deque[int](maxlen=_LIVE) for _ in range(2))
        self._is_reported = False

    def add(self, ahead_ns: int, period_ns: float, *, is_image: bool, is_scan: bool) -> None:
        """Add a message; `ahead_ns` is its stamp - its arrival."""
        (self._image_ns if is_image else self._depth_ns).append(ahead_ns)
        clocks = self._image_ns, self._depth_ns, period_ns
        if is_image or self._is_reported or min(map(len, clocks[:2])) < _LIVE:
            return
        self._is_reported = report_clocks(clocks_apart_s(*clocks, is_scan=is_scan, parts=1))
        self._depth_ns.clear()


def period_ns_of(stamps_ns: Any, default_ns: float) -> float:
    """Return the median interval of stamps in any order."""
    intervals = np.diff(np.unique(np.asarray(stamps_ns, np.int64)))
    return float(np.median(intervals)) if intervals.size else default_ns
