"""What a chart shows is where it belongs; all of it is well-formed."""

import xml.etree.ElementTree as ElementTree

import pytest

from runtime.drawing.report_page.charts import (
    latency_chart,
    mark_strip,
    range_strip,
    returns_strip,
    spans_across,
)
from runtime.drawing.report_page.timeline import Moment, Timeline
from runtime.sync.latency import latency_statistics


def timeline_of(*moments):
    timeline = Timeline()
    for moment in moments:
        timeline.add(moment)
    return timeline


def chart(timeline, deadline_ms=None, width=640):
    text = latency_chart(
        timeline.spans(spans_across(width)),
        width=width,
        height=270,
        deadline_ms=deadline_ms,
        title="prediction",
    )
    return ElementTree.fromstring(text)


def circles(svg, kind):
    return [c for c in svg.iter("circle") if c.get("class") == kind]


TIMES = (10, 20, 60, None, 30)


@pytest.fixture
def timeline():
    """Five frames: the third late, the fourth skipped."""
    marks = {60: ("late",), None: ("skipped",)}
    names = ("a", "b", "<c>", "d", "e")
    moments = (
        Moment(name, response_ms=time, marks=marks.get(time, ()))
        for name, time in zip(names, TIMES, strict=True)
    )
    return timeline_of(*moments)


def test_points_stand_where_their_times_are(timeline):
    svg = chart(timeline, deadline_ms=50)
    texts = {t.text: t for t in svg.iter("text")}
    twenty, forty = (float(texts[text].get("y")) - 4 for text in ("20", "40"))

    def height(time):
        return twenty - (twenty - forty) * (time - 20) / 20

    (late,) = circles(svg, "late")
    points = [*circles(svg, "point")[:2], late, circles(svg, "point")[2]]
    times = [time for time in TIMES if time is not None]
    for point, time in zip(points, times, strict=True):
        assert float(point.get("cy")) == pytest.approx(height(time), abs=0.11)
    xs = [float(point.get("cx")) for point in points]
    assert xs == sorted(xs)
    assert xs[3] - xs[2] == pytest.approx(2 * (xs[1] - xs[0]), abs=0.2), "a frame lies between"
    (deadline,) = [line for line in svg.iter("line") if line.get("class") == "deadline"]
    assert float(deadline.get("y1")) == pytest.approx(height(50), abs=0.11)
    assert late.find("title").text == "<c>: 60.0 ms"


def test_the_line_is_broken_where_no_answer_is(timeline):
    svg = chart(timeline)
    assert [len(line.get("points").split()) for line in svg.iter("polyline")] == [3, 1]
    (drop,) = [group for group in svg.iter("g") if group.get("class") == "drop"]
    assert drop.find("title").text == "d: skipped"


def test_one_slow_frame_makes_the_axis_logarithmic():
    times = [10.0] * 20 + [5000.0]
    svg = chart(timeline_of(*(Moment("x", response_ms=time) for time in times)))
    assert "ms, logarithmic" in [text.text for text in svg.iter("text")]
    heights = [float(point.get("cy")) for point in circles(svg, "point")]
    assert heights[0] - heights[-1] > 100
    assert heights[-1] >= 20


def test_many_frames_are_a_band_and_every_late_span_is_marked():
    moments = (
        Moment("x", response_ms=10 + index % 7, marks=("late",) if index == 77_777 else ())
        for index in range(100_000)
    )
    svg = chart(timeline_of(*moments), deadline_ms=20)
    assert len(list(svg.iter("polygon"))) == 1
    (late,) = circles(svg, "late")
    assert "1 late" in late.find("title").text
    assert not circles(svg, "point")
    assert len(ElementTree.tostring(svg)) < 60_000


@pytest.mark.parametrize("width", [380, 640, 1040])
@pytest.mark.parametrize("frames", [1, 2, 300, 5000])
def test_everything_lies_within_the_picture(width, frames):
    timeline = timeline_of(*(Moment("x", response_ms=1 + i % 9) for i in range(frames)))
    svg = chart(timeline, deadline_ms=3, width=width)
    for element in svg.iter():
        for name in ("x", "x1", "x2", "cx"):
            assert 0 <= float(element.get(name, 0)) <= width
        for name in ("y", "y1", "y2", "cy"):
            assert 0 <= float(element.get(name, 0)) <= 270


def test_without_an_answer_there_is_no_chart():
    timeline = timeline_of(Moment("x", marks=("skipped",)))
    assert latency_chart(timeline.spans(), width=640, height=270, deadline_ms=1, title="x") == ""


def rectangles(text):
    return [
        tuple(float(r.get(name)) for name in ("x", "width", "height"))
        for r in ElementTree.fromstring(text).iter("rect")
    ]


def test_a_strip_shows_where_a_mark_was():
    marks = [(), ("a",), ("a", "b"), (), ("a",)]
    spans = timeline_of(*(Moment("x", marks=each) for each in marks)).spans()
    assert rectangles(mark_strip(spans, "a")) == [(200, 400, 10), (800, 200, 10)]
    assert rectangles(mark_strip(spans, "b")) == [(400, 200, 10)]
    assert rectangles(mark_strip(spans, "c")) == []


def test_a_strip_shows_the_returns():
    spans = timeline_of(*(Moment("x", returns=each) for each in (100, None, 50))).spans()
    drawn = rectangles(returns_strip(spans))
    assert [height for _, _, height in drawn] == [40, 20]
    assert drawn[1][0] == pytest.approx(666.67)
    assert rectangles(returns_strip(timeline_of(Moment("x", returns=0)).spans()))[0][2] == 0


def test_a_strip_shows_the_median_and_the_most():
    drawn = rectangles(range_strip(latency_statistics([1, 2, 10]), 20))
    assert [width for _, width, _ in drawn] == [500, 100]
