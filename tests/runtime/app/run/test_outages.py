"""When a sensor was out: in seconds, in the report, on the page, and for --fail-on."""

import pytest

from outcomes import outcome
from runtime.app.run.outages import Timeline, find_outages
from runtime.app.run.outputs.charts import Axis, group_frames, latency_chart, mark_strip
from runtime.streams.messages import Sensor

S = 10**9
START = 1_790_000_000 * S


def at(*seconds):
    return [START + round(each * S) for each in seconds]


def tenths(first, last, step=1):
    return [each / 10 for each in range(first, last, step)]


def records_at(seconds, depths=None, health=lambda number: ()):
    depths = depths or [None] * len(seconds)
    return [
        outcome(number, image_stamp=ns, depth_stamp=depth, health=health(number), latency_ms=5.0)
        for number, (ns, depth) in enumerate(zip(at(*seconds), depths, strict=True))
    ]


def texts(records, stamps, *, whole=True):
    timeline = Timeline.of(records, stamps)
    return [each.text for each in find_outages(records, stamps, timeline, whole=whole)]


def test_a_camera_that_stops_before_the_lidar_is_silent_until_the_end():
    images, scans = at(*tenths(0, 82)), at(*tenths(0, 101))
    stamps = {Sensor.IMAGE: images, Sensor.DEPTH: scans}
    records = records_at(tenths(0, 82))
    assert texts(records, stamps) == ["camera silent 8.1 to 10.0 s"]
    assert texts(records, stamps, whole=False) == [], "the run ended there"


def test_a_lidar_that_starts_late_and_pauses_is_silent():
    images, scans = at(*tenths(0, 100)), at(*tenths(20, 50), *tenths(60, 100))
    stamps = {Sensor.IMAGE: images, Sensor.DEPTH: scans}
    expected = ["LiDAR silent 0.0 to 2.0 s", "LiDAR silent 4.9 to 6.0 s"]
    assert texts(records_at(tenths(0, 100)), stamps) == expected
    assert texts(records_at(tenths(0, 100)), {}) == [], "a camera alone"


@pytest.mark.parametrize("seconds", [
    tenths(0, 40, 20), [0, 0.1, 0.2, 0.5, 0.6, 0.7], [0, 1.2, 1.9, 3.4, 4.0, 5.3],
    [5, 6, 0, 1], [0, 0.1, 1e5, 1e5 + 0.1],
])  # fmt: skip
def test_slow_irregular_and_reset_cameras_are_not_silent(seconds):
    assert texts(records_at(seconds), {Sensor.IMAGE: at(*seconds)}) == []


def test_empty_and_repeated_scans_are_counted():
    def health(number):
        return ("lidar_empty",) if 5 <= number < 8 else ("lidar_frozen",) if number >= 12 else ()

    records = records_at(tenths(0, 20), at(*tenths(0, 20)), health)
    expected = ["LiDAR empty 0.5 to 0.7 s, 3 scans", "LiDAR repeats itself 1.0 to 1.9 s, 10 scans"]
    assert texts(records, {}) == expected
    untimed = [outcome(number, health=health(number)) for number in range(20)]
    expected = ["LiDAR empty 3 scans, from 5 on", "LiDAR repeats itself 10 scans, from 10 on"]
    assert texts(untimed, {}) == expected


def test_a_chart_has_seconds_and_leaves_gaps_open():
    seconds = [*tenths(0, 10), *tenths(30, 40)]
    records = records_at(seconds, health=lambda number: ("image_black",) if number == 9 else ())
    axis = Axis.of(len(records), Timeline.of(records, {}).times_s)
    spans = group_frames(records, axis)
    chart = latency_chart(spans, axis, deadline_ms=None)
    assert chart["unit"] == "s"
    assert [place for _, place in chart["along"]] == pytest.approx([0, 1, 2, 3, 4])
    assert len(chart["lines"]) == 2, "no line across the gap"
    assert chart["points"][9][3].startswith("0.90 s: ")
    ((left, width, _, _),) = mark_strip(spans, "image_black")
    assert (left, width) == pytest.approx((100 * 0.9 / 4, 100 * 0.1 / 4))
    axis = Axis.of(20, None)
    chart = latency_chart(group_frames(records, axis), axis, deadline_ms=None)
    assert chart["unit"] == "frame"
