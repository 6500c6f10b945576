"""Pictures of latencies: over the frames of a run, and of several models."""

import math
from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.drawing.axis import Axis, frame_ticks

_HEIGHT, _WIDTH = 320, 960
_LEFT, _RIGHT, _TOP, _BOTTOM = 60, 16, 30, 40  # margins in pixels
_FONT, _FONT_SCALE = cv2.FONT_HERSHEY_SIMPLEX, 0.45
_INK, _GRID, _LINE, _LATE = (40, 40, 40), (225, 225, 225), (180, 110, 30), (40, 40, 220)
_FRAME_TICKS = 10  # at most
_BAR = 44  # rows of a bar and its label


def draw_latency(
    latencies_ms: Mapping[int, float], *, deadline_ms: float | None = None
) -> NDArray[np.uint8]:
    """Draw latencies over the frames; the deadline and late frames are red.

    Args:
        latencies_ms: number of the frame -> latency; at least one.
        deadline_ms: None = there is none.

    Returns:
        uint8 (H, W, 3), BGR.
    """
    picture = np.full((_HEIGHT, _WIDTH, 3), 255, dtype=np.uint8)
    times_ms = sorted(latencies_ms.values())
    median_ms = times_ms[len(times_ms) // 2]
    axis = Axis(times_ms[0], median_ms, max(times_ms[-1], 1e-3), deadline_ms)
    last = max(*latencies_ms, 1)

    def x_of(frame: float) -> int:
        return round(_LEFT + frame / last * (_WIDTH - _LEFT - _RIGHT))

    def y_of(latency_ms: float) -> int:
        return round(_HEIGHT - _BOTTOM - axis.place(latency_ms) * (_HEIGHT - _TOP - _BOTTOM))

    for value_ms in axis.ticks:
        cv2.line(picture, (_LEFT, y_of(value_ms)), (_WIDTH - _RIGHT, y_of(value_ms)), _GRID)
        _text(picture, f"{value_ms:g}", (8, y_of(value_ms) + 5))
    for frame in frame_ticks(last, _FRAME_TICKS):
        _text(picture, str(frame), (x_of(frame) - 10, _HEIGHT - _BOTTOM + 18))
    _text(picture, f"prediction [{axis.unit}]", (8, 18))
    _text(picture, "frame", (_WIDTH // 2, _HEIGHT - 6))

    points = [(x_of(frame), y_of(time_ms)) for frame, time_ms in latencies_ms.items()]
    cv2.polylines(picture, [np.array(points, dtype=np.int32)], False, _LINE, 1, cv2.LINE_AA)
    for point, time_ms in zip(points, latencies_ms.values(), strict=True):
        late = deadline_ms is not None and time_ms > deadline_ms
        cv2.circle(picture, point, 3 if late else 2, _LATE if late else _LINE, cv2.FILLED)
    if deadline_ms is not None:
        y = y_of(deadline_ms)
        cv2.line(picture, (_LEFT, y), (_WIDTH - _RIGHT, y), _LATE)
        _text(picture, f"deadline {deadline_ms:g} ms", (_WIDTH - 170, y - 5), _LATE)
    return picture


def draw_bars(bars: Sequence[tuple[str, tuple[float, float, float]]]) -> NDArray[np.uint8]:
    """Draw a bar to the median of each label, with a line from the least to the most.

    Args:
        bars: label, and least, median and most latency [ms]; at least one.

    Returns:
        uint8 (H, W, 3), BGR.
    """
    height = _TOP + _BAR * len(bars) + _BOTTOM
    picture = np.full((height, _WIDTH, 3), 255, dtype=np.uint8)
    axis = Axis(0.0, math.inf, max(1e-3, *(most for _, (_, _, most) in bars)), None)

    def x_of(latency_ms: float) -> int:
        return round(_LEFT + axis.place(latency_ms) * (_WIDTH - _LEFT - _RIGHT))

    for value_ms in axis.ticks:
        cv2.line(picture, (x_of(value_ms), _TOP), (x_of(value_ms), height - _BOTTOM), _GRID)
        _text(picture, f"{value_ms:g}", (x_of(value_ms) - 8, height - _BOTTOM + 18))
    _text(picture, "median latency, least to most [ms]", (_LEFT, 18))
    for number, (label, (least, median, most)) in enumerate(bars):
        y = _TOP + _BAR * number + _BAR // 2
        cv2.rectangle(picture, (_LEFT, y), (x_of(median), y + 14), _LINE, cv2.FILLED)
        cv2.line(picture, (x_of(least), y + 7), (x_of(most), y + 7), _INK)
        _text(picture, f"{label}: {median:.1f}", (_LEFT, y - 4))
    return picture


def _text(
    picture: NDArray[np.uint8],
    text: str,
    at: tuple[int, int],
    color: tuple[int, int, int] = _INK,
) -> None:
    cv2.putText(picture, text, at, _FONT, _FONT_SCALE, color, 1, cv2.LINE_AA)
