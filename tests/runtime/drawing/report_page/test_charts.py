"""What a chart shows is where it belongs; all of it is well-formed."""

import re
import xml.etree.ElementTree as ElementTree

import pytest

from outcomes import outcome
from runtime.drawing.report_page.charts import (
    MOST_SPANS,
    latency_chart,
    mark_strip,
    range_strip,
    returns_strip,
)
from runtime.drawing.report_page.template import render
from runtime.drawing.report_page.timeline import Timeline
from runtime.sync.frame_outcome import OK, SKIPPED
from runtime.sync.latency import latency_statistics


def timeline_of(*outcomes):
    timeline = Timeline()
    for each in outcomes:
        timeline.add(each)
    return timeline


def chart(timeline, deadline_ms=None):
    drawn = latency_chart(timeline.spans(MOST_SPANS), deadline_ms=deadline_ms)
    values = {"chart": drawn, "response": "prediction"}
    return ElementTree.fromstring(render("chart.html", values))


def paths(page, kind):
    """(x, y, title) of the paths of a kind, as if the chart had 1000 x 300 units."""
    found = [path for path in page.iter("path") if path.get("class") == kind]
    starts = [re.match(r"M([0-9.]+) ([0-9.]+)", path.get("d")).groups() for path in found]
    return [
        (10 * float(x), 3 * float(y), path.findtext("title"))
        for (x, y), path in zip(starts, found, strict=True)
    ]


def ticks(page, side):
    """Text -> position in percent, from the left or from below."""
    places = {
        span.text: float(re.search(r":([0-9.]+)%", span.get("style"))[1])
        for span in page.iter("span")
        if span.get("class") == side
    }
    return places if side == "x" else {text: 100 - top for text, top in places.items()}


TIMES = (10, 20, 60, None, 30)


@pytest.fixture
def timeline():
    """Five frames: the third late, the fourth skipped."""
    names = ("a", "b", "<c>", "d", "e")
    return timeline_of(
        *(
            outcome(
                status=SKIPPED if time is None else OK,
                name=name,
                latency_ms=time,
                deadline_met=time != 60,
            )
            for name, time in zip(names, TIMES, strict=True)
        )
    )


def test_points_stand_where_their_times_are(timeline):
    page = chart(timeline, deadline_ms=50)
    left = ticks(page, "y")

    def height(time):
        percent = left["20"] + (left["40"] - left["20"]) * (time - 20) / 20
        return 300 * (1 - percent / 100)

    (late,) = paths(page, "late")
    points = [*paths(page, "point")[:2], late, paths(page, "point")[2]]
    times = [time for time in TIMES if time is not None]
    for (_, y, _), time in zip(points, times, strict=True):
        assert y == pytest.approx(height(time), abs=0.11)
    xs = [x for x, _, _ in points]
    assert xs == sorted(xs)
    assert xs[3] - xs[2] == pytest.approx(2 * (xs[1] - xs[0]), abs=0.2), "a frame lies between"
    ((_, deadline, _),) = paths(page, "deadline")
    assert deadline == pytest.approx(height(50), abs=0.11)
    assert late[2] == "<c>: 60.0 ms"
    below = ticks(page, "x")
    assert below["2"] == pytest.approx(xs[2] / 10)


def test_the_line_is_broken_where_no_answer_is(timeline):
    page = chart(timeline)
    assert [len(line.get("points").split()) for line in page.iter("polyline")] == [3, 1]
    (drop,) = [group for group in page.iter("g") if group.get("class") == "drop"]
    assert drop.find("title").text == "d: skipped"


def test_one_slow_frame_makes_the_axis_logarithmic():
    times = [10.0] * 20 + [5000.0]
    page = chart(timeline_of(*(outcome(latency_ms=time) for time in times)))
    assert "ms, logarithmic" in [span.text for span in page.iter("span")]
    heights = [y for _, y, _ in paths(page, "point")]
    assert heights[0] - heights[-1] > 100
    assert heights[-1] >= 0


def test_many_frames_are_a_band_and_every_late_span_is_marked():
    outcomes = (
        outcome(latency_ms=10 + index % 7, deadline_met=index != 7_777) for index in range(20_000)
    )
    page = chart(timeline_of(*outcomes), deadline_ms=20)
    assert len(list(page.iter("polygon"))) == 1
    (late,) = paths(page, "late")
    assert "1 late" in late[2]
    assert not paths(page, "point")
    assert len(ElementTree.tostring(page)) < 60_000


@pytest.mark.parametrize("frames", [1, 2, 300, 5000])
def test_everything_lies_within_the_picture(frames):
    timeline = timeline_of(*(outcome(latency_ms=1 + i % 9) for i in range(frames)))
    page = chart(timeline, deadline_ms=3)
    for kind in ("point", "late", "grid", "deadline"):
        for x, y, _ in paths(page, kind):
            assert 0 <= x <= 1000
            assert 0 <= y <= 300
    for element in (*page.iter("polyline"), *page.iter("polygon")):
        for point in element.get("points").split():
            x, y = map(float, point.split(","))
            assert 0 <= x <= 100
            assert 0 <= y <= 100
    for side in "xy":
        assert all(0 <= percent <= 100 for percent in ticks(page, side).values())


def test_without_an_answer_there_is_no_chart():
    timeline = timeline_of(outcome(status=SKIPPED))
    assert latency_chart(timeline.spans(), deadline_ms=1) == {}


def rectangles(bars):
    """(x, width, height) of the bars of a strip, as if it had 1000 x 100 units."""
    page = ElementTree.fromstring(render("strip.html", {"bars": bars}))
    found = [[float(r.get(name)) for name in ("x", "width", "height")] for r in page.iter("rect")]
    return [(10 * x, 10 * width, height) for x, width, height in found]


def test_a_strip_shows_where_a_mark_was():
    marks = [(), ("a",), ("a", "b"), (), ("a",)]
    spans = timeline_of(*(outcome(health=each) for each in marks)).spans()
    assert rectangles(mark_strip(spans, "a")) == [(200, 400, 100), (800, 200, 100)]
    assert rectangles(mark_strip(spans, "b")) == [(400, 200, 100)]
    assert rectangles(mark_strip(spans, "c")) == []


def test_a_strip_shows_the_returns():
    outcomes = (
        outcome(latency_ms=1, returns=100),
        outcome(status=SKIPPED),
        outcome(latency_ms=1, returns=50),
    )
    spans = timeline_of(*outcomes).spans()
    drawn = rectangles(returns_strip(spans))
    assert [height for _, _, height in drawn] == [100, 50]
    assert drawn[1][0] == pytest.approx(666.67)
    none = timeline_of(outcome(latency_ms=1, returns=0))
    assert rectangles(returns_strip(none.spans()))[0][2] == 0


def test_a_strip_shows_the_median_and_the_most():
    drawn = rectangles(range_strip(latency_statistics([1, 2, 10]), 20))
    assert [width for _, width, _ in drawn] == [500, 100]
