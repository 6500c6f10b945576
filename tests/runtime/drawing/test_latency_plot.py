import math

import numpy as np
import pytest

from runtime.drawing.latency_plot import draw_bars, draw_latency


@pytest.mark.parametrize("latencies", [[5.0], [5.0, 7.0] * 500, [0.0, 0.0]])
def test_the_picture_shows_late_frames_in_red(latencies):
    numbered = dict(enumerate(latencies))

    def red_points(deadline_ms):
        picture = draw_latency(numbered, deadline_ms=deadline_ms).astype(int)
        return int(((picture[..., 2] > 200) & (picture[..., :2].max(axis=2) < 60)).sum())

    assert draw_latency(numbered).shape[2] == 3
    assert red_points(None) == 0
    in_time = red_points(math.ceil(max(latencies)) + 1.0)
    if max(latencies) > 1:
        assert red_points(1.0) > in_time, "late points are drawn red on top of the line"


def test_the_picture_leaves_room_for_frames_without_latency():
    """Frames 0..9 and 90..99 of a hundred: nothing is drawn in the middle but the line."""
    late = dict.fromkeys([*range(10), *range(90, 100)], 9.0)
    picture = draw_latency(late, deadline_ms=1.0).astype(int)
    red = (picture[..., 2] > 200) & (picture[..., :2].max(axis=2) < 60)
    points = red.any(axis=0) & (red.sum(axis=0) > 2)  # wider than the deadline's line
    columns = np.flatnonzero(points[60:944])  # between the margins
    left, right = 884 * 0.15, 884 * 0.85
    assert (columns < left).any()
    assert (columns > right).any()
    title = columns > 944 - 60 - 180  # the deadline's text stands on the right
    assert not ((columns > left) & (columns < right) & ~title).any()


def test_bars_end_at_the_median_and_lines_at_the_most():
    picture = draw_bars([("one", (5.0, 10.0, 20.0)), ("two", (20.0, 20.0, 20.0))]).astype(int)
    blue = (picture[..., 0] > 150) & (picture[..., 2] < 60)
    bars = np.flatnonzero(blue.sum(axis=1) > 50)
    first, second = np.split(bars, np.flatnonzero(np.diff(bars) > 1) + 1)
    ends = [np.flatnonzero(blue[rows[1]])[-1] - 60 for rows in (first, second)]
    assert ends[0] == pytest.approx(ends[1] / 2, abs=1)
    line = np.flatnonzero((picture[first[len(first) // 2]] < 60).all(axis=1))
    assert line[-1] - 60 == pytest.approx(ends[1], abs=1)
    assert line[0] - 60 == pytest.approx(ends[0] / 2, abs=1)
