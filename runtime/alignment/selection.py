"""Choice of the frames that are compared: spread over a recording, with structure preferred."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from runtime.base.errors import InputError
from runtime.checks.view import Points, find_jumps, is_near
from runtime.recordings.listing import ListedFrame
from runtime.recordings.source import Source
from runtime.streams.frame import Frame
from runtime.streams.frame_view import compensated_points

_CANDIDATES = 2  # frames that are read for each chosen one
_MOST_BESIDE, _MOST_APART_S = 5, 0.55  # scans before and after each, and their time from it


def choose_frames(source: Source, count: int) -> Iterator[tuple[Frame, Mapping[str, Points]]]:
    """Yield frames that are spread over a recording, and the scans beside their own.

    Each frame is the best of several in its part of the recording. Scans are those within half a
    second by their stamps, or of the frame before and after, by the words for their time.

    Args:
        source: a recording with scans and a calibration.
        count: number of frames.

    Raises:
        InputError: if the recording has no scans, or no calibration.
    """
    listed = [each for each in source.list_frames() if each.complete and each.depth is not None]
    if not listed:
        raise InputError(
            "the recording has no scans: give `points=` with `calibration=`, or a bag or drive "
            "with point clouds"
        )
    parts = np.array_split(np.arange(len(listed)), min(count, len(listed)))
    for part in parts:
        places = part[np.linspace(0, len(part) - 1, min(_CANDIDATES, len(part))).astype(int)]
        read = ((int(place), _read(source, listed, int(place))) for place in places)
        candidates = [(place, *each) for place, each in read if each is not None]
        if candidates:
            place, frame, _ = max(candidates, key=lambda each: _structure(*each[1:]))
            yield frame, _beside(source, listed, place)


def _beside(source: Source, listed: Sequence[ListedFrame], place: int) -> dict[str, Points]:
    """The scans of other times near a frame's image, as seen with its calibration."""
    found, own_ns = {}, listed[place].image_stamp_ns
    for step in (*range(-_MOST_BESIDE, 0), *range(1, _MOST_BESIDE + 1)):
        if not 0 <= place + step < len(listed):
            continue
        ns = listed[place + step].image_stamp_ns
        way = "before" if step < 0 else "after"
        when = f"the frame {way}"
        if own_ns is not None and ns is not None:
            apart_s = abs(ns - own_ns) / 1e9
            when = f"{apart_s:.1f} s {way}" if 0 < apart_s <= _MOST_APART_S else ""
        elif abs(step) > 1:
            when = ""
        if when and (read := _read(source, listed, place + step)) is not None:
            found[when] = read[1]
    return found


def _read(source: Source, listed: Sequence[ListedFrame], place: int) -> tuple[Frame, Points] | None:
    """Return the frame and its points near the image; None if it cannot be read."""
    try:
        frame = source.read(listed[place])
    except InputError:  # the frame is damaged; others can be used
        return None
    if (points := compensated_points(frame)) is None or frame.calibration is None:
        raise InputError(
            "the recording has depth maps, or no calibration: a calibration is checked with raw "
            "scans, `points=` with `calibration=`, or a bag or drive with point clouds"
        )
    calibration = frame.calibration
    in_camera = points[:, :3] @ calibration.extrinsics[:3, :3].T + calibration.extrinsics[:3, 3]
    camera = calibration.intrinsics, calibration.lens_model, frame.size
    return frame, points[is_near(in_camera, *camera)]


def _structure(frame: Frame, points: Points) -> float:
    """Return how much structure a frame has: its jumps, times the spread of the log ranges."""
    assert frame.calibration is not None  # checked when the frame was read
    turned = points[:, :3] @ frame.calibration.extrinsics[:3, :3].T
    jumps = find_jumps(turned.astype(np.float32))
    spread = np.log(np.linalg.norm(turned, axis=1)).std() if len(turned) else 0.0
    return int(np.count_nonzero(jumps)) * float(spread)
