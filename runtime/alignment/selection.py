"""Choice of the frames that are compared: spread over a recording, with structure preferred."""

from collections.abc import Iterator, Sequence

import numpy as np

from runtime.alignment.view import Neighbours, Points, compensated_points, find_structure
from runtime.base.errors import InputError
from runtime.recordings.listing import ListedFrame
from runtime.recordings.source import Source
from runtime.streams.frame import Frame

_CANDIDATES = 2  # frames that are read for each chosen one


def choose_frames(source: Source, count: int) -> Iterator[tuple[Frame, Neighbours]]:
    """Yield frames that are spread over a recording, and the scans beside their own.

    Each frame is the best of several in its part of the recording.

    Args:
        source: a recording with scans and a calibration.
        count: number of frames.

    Raises:
        InputError: if the recording has no scans, or no calibration.
    """
    listed = [each for each in source.list_frames() if each.complete and each.depth is not None]
    if not listed:
        raise InputError(
            "the recording has no scans: give --points with --calibration, or a bag or drive with "
            "point clouds"
        )
    parts = np.array_split(np.arange(len(listed)), min(count, len(listed)))
    for part in parts:
        places = part[np.linspace(0, len(part) - 1, min(_CANDIDATES, len(part))).astype(int)]
        read = ((int(place), _read(source, listed, int(place))) for place in places)
        candidates = [(place, *each) for place, each in read if each is not None]
        if candidates:
            place, frame, _ = max(candidates, key=lambda each: _structure(*each[1:]))
            beside = (_read(source, listed, place + step) for step in (-1, 1))
            before, after = (None if each is None else each[1] for each in beside)
            yield frame, (before, after)


def _read(source: Source, listed: Sequence[ListedFrame], place: int) -> tuple[Frame, Points] | None:
    """Return the frame and its points; None if it cannot be read."""
    if not 0 <= place < len(listed):
        return None
    try:
        frame = source.read(listed[place])
    except InputError:  # the frame is damaged; others can be used
        return None
    if (points := compensated_points(frame)) is None or frame.calibration is None:
        raise InputError(
            "the recording has depth maps, or no calibration: a calibration is checked with raw "
            "scans, --points with --calibration, or a bag or drive with point clouds"
        )
    return frame, points


def _structure(frame: Frame, points: Points) -> float:
    """Return how much structure a frame has: its jumps, times the spread of the log ranges."""
    assert frame.calibration is not None  # checked when the frame was read
    returns, jumps = find_structure(points, frame.calibration, frame.size)
    spread = np.log(np.linalg.norm(returns, axis=1)).std() if len(returns) else 0.0
    return len(jumps) * float(spread)
