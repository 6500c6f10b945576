"""ssdnet-run --page writes one page that is true and self-contained."""

import base64
import dataclasses
import json
import re
import shutil
import xml.etree.ElementTree as ElementTree

import cv2
import numpy as np
import pytest

from outcomes import outcome
from runtime.app.run.frame_record import OK, SKIPPED
from runtime.app.run.outputs import charts
from runtime.app.run.outputs.page import RunPage
from runtime.command.html import render_template
from runtime.engine.prediction import Latency


@pytest.fixture
def page_of(tmp_path, run, read_page):
    """Run with --page and these arguments; give (click's result, page, its source)."""

    def make(*arguments):
        path = tmp_path / "deep" / "report.html"
        result = run("--page", path, *arguments)
        text = path.read_text()
        return result, read_page(text), text

    return make


def spoil(stream):
    """Three frames without depth, one without a map, one that stands still, one damaged."""
    rgb, depth = stream
    for index in (2, 3, 4):
        cv2.imwrite(str(depth / f"f{index}.png"), np.zeros((48, 64), np.uint16))
    (depth / "f6.png").unlink()
    shutil.copy(rgb / "f8.png", rgb / "f9.png")
    (rgb / "f10.png").write_bytes(b"")


def test_the_page_shows_the_run_and_loads_nothing(tmp_path, page_of, stream):
    spoil(stream)
    result, page, text = page_of("--deadline-ms", 60_000)
    assert result.exit_code == 3
    expected = {
        "frames": "12", "missed deadlines": "0", "flagged frames": "6", "no_depth": "3 of 12",
        "image_frozen": "1 of 12", "skipped": "2 of 12", "name": "by-hand",
        "answers": "semantic, depth, boundary, depth_uncertainty", "requested": "cpu",
    }  # fmt: skip
    assert {label: page.after(label) for label in expected} == expected
    frames = json.loads((tmp_path / "out" / "report.json").read_text())["frames"]
    assert frames["health"] == {"image_frozen": 1, "lidar_empty": 3}, "as on the page"
    assert {"10 ok, 2 skipped", "f6 has an image, but no depth map", "red"} <= set(page.texts)
    assert "deadline 60000 ms" in page.texts
    for library in ("onnxruntime", "cv2", "numpy", "Python"):
        assert re.match(r"\d+\.\d+", page.after(library))
    assert text.count("<polyline") == 3, "the line is broken twice"
    assert "background:rgb(200, 30, 30)" in text
    assert "page: " in result.stdout
    assert len([link for link in page.links if link.startswith("data:image/")]) >= 3
    assert all(link.startswith("data:") for link in page.links)
    assert "default-src 'none'" in text
    assert not re.search(r"https?:|url\(|@import|<script", text)


def test_missed_deadlines_and_the_age_are_shown(page_of):
    _, page, text = page_of("--rate", 200, "--deadline-ms", 1e-6)
    expected = {"missed deadlines": "12", "late": "12 of 12", "scenario": "constant-stream, 200 Hz"}
    assert {label: page.after(label) for label in expected} == expected
    assert text.count('<path class="late"') == 12
    assert page.after("median age").endswith(" ms")


@pytest.mark.parametrize("name", ["<b>&x", "f\udcff3"])
def test_a_run_without_an_answer_has_a_page_with_names_as_text(page_of, stream, name):
    for path in stream[0].iterdir():
        path.write_bytes(b"")
    for folder in stream:
        (folder / "f0.png").rename(folder / f"{name}.png")
    result, page, text = page_of()
    assert result.exit_code == 3
    assert "No frame was answered." in page.texts
    assert page.after("skipped") == "12 of 12"
    assert name.encode(errors="backslashreplace").decode() in page.texts
    assert "<b>&x" not in text


def test_a_run_without_faults_or_without_frames_is_shown_as_such(page_of):
    _, page, _ = page_of()
    assert "All frames were answered, none is flagged." in page.texts
    assert "missed deadlines" not in page.texts
    _, page, _ = page_of("--shard", "13/13", "--overwrite")
    assert page.after("frames") == "0"


# --- charts ------------------------------------------------------------------------------------


def spans_of(outcomes):
    return charts.group_frames(outcomes, charts.Axis.of(len(outcomes), None))


def chart(outcomes, deadline_ms):
    axis = charts.Axis.of(len(outcomes), None)
    drawn = charts.latency_chart(spans_of(outcomes), axis, deadline_ms=deadline_ms)
    values = {"chart": drawn, "response": "prediction"}
    return ElementTree.fromstring(render_template("runtime.command", "chart.html", values))


def paths(page, kind):
    """(x, y, title) in percent of the paths of a kind."""
    found = [path for path in page.iter("path") if path.get("class") == kind]
    starts = [re.match(r"M([0-9.]+) ([0-9.]+)", path.get("d")).groups() for path in found]
    return [
        (float(x), float(y), path.findtext("title"))
        for (x, y), path in zip(starts, found, strict=True)
    ]


def ticks(page, side):
    """Text -> position in percent, from the left or from above."""
    return {
        span.text: float(re.search(r":([0-9.]+)%", span.get("style"))[1])
        for span in page.iter("span")
        if span.get("class") == side
    }


def test_points_stand_where_their_times_are_and_the_line_is_broken_without_an_answer():
    times = {"a": 10, "b": 20, "<c>": 60, "d": None, "e": 30}
    outcomes = [
        outcome(status=OK if time else SKIPPED, name=name, latency_ms=time, deadline_met=time != 60)
        for name, time in times.items()
    ]
    page = chart(outcomes, deadline_ms=50)
    above = ticks(page, "y")

    def top(time):
        return above["20"] + (above["40"] - above["20"]) * (time - 20) / 20

    (late,) = paths(page, "late")
    a, b, e = paths(page, "point")
    for (_, y, _), time in zip((a, b, late, e), (10, 20, 60, 30), strict=True):
        assert y == pytest.approx(top(time), abs=0.04)
    assert e[0] - late[0] == pytest.approx(2 * (b[0] - a[0]), abs=0.02), "a frame lies between"
    ((_, deadline, _),) = paths(page, "deadline")
    assert deadline == pytest.approx(top(50), abs=0.04)
    assert late[2] == "<c>: 60.0 ms"
    assert ticks(page, "x")["2"] == pytest.approx(late[0])
    assert [len(line.get("points").split()) for line in page.iter("polyline")] == [3, 1]
    (unanswered,) = [each for each in page.iter("g") if each.get("class") == "unanswered"]
    assert unanswered.find("title").text == "d: skipped"


def test_many_frames_are_drawn_by_the_slowest_of_each_span():
    outcomes = [
        outcome(latency_ms=10 + index % 7, deadline_met=index != 777) for index in range(4_000)
    ]
    page = chart(outcomes, deadline_ms=20)
    (line,) = page.iter("polyline")
    assert {point.split(",")[1] for point in line.get("points").split()} == {"20.00"}
    (late,) = paths(page, "late")
    assert "16.0 ms at most, 1 late" in late[2]
    assert not paths(page, "point")
    assert len(ElementTree.tostring(page)) < 60_000


def test_strips_show_where_a_mark_was_and_how_many_returns_were_used():
    marks = [(), ("a",), ("a", "b"), (), ("a",)]
    spans = spans_of([outcome(health=each) for each in marks])
    bars = charts.mark_strip(spans, "a")
    assert [bar[:1] for bar in bars] == [(20,), (40,), (80,)]
    assert [bar[1:] for bar in bars] == [(pytest.approx(20), 100, 1)] * 3
    assert charts.mark_strip(spans, "c") == []
    outcomes = [outcome(returns=100), outcome(status=SKIPPED), outcome(returns=50)]
    drawn = charts.returns_strip(spans_of(outcomes))
    assert [height for _, _, height, _ in drawn] == [100, 50]
    assert drawn[1][0] == pytest.approx(200 / 3)


# --- samples -----------------------------------------------------------------------------------


@pytest.fixture
def look(contract, answered):
    """Let a page see n frames, the time of frame i by `time_ms`, its marks by `marks`."""
    frame, result = answered

    def run(n, time_ms=lambda i: 1.0, marks=lambda i: ()):
        page = RunPage(contract, n)
        for index in range(n):
            latency = Latency(0, 0, 0, time_ms(index))
            timed = dataclasses.replace(result.prediction, latency=latency)
            marked = dataclasses.replace(result, prediction=timed, health=marks(index))
            page.write(dataclasses.replace(frame, name=f"f{index}"), marked)
        return page.samples()

    return run


@pytest.mark.parametrize("n", [1, 6, 7, 500])
def test_samples_are_evenly_spread(look, n):
    places = [sample.index for sample in look(n)]
    assert places[0] == 0
    assert len({*np.diff(places).tolist()}) <= 1
    assert min(n, 3) <= len(places) <= 6
    assert n - places[-1] <= max(n // 3, 1) + 1, "the end is seen, too"


def test_the_slowest_and_the_first_of_each_fault_are_kept(look, answered):
    samples = look(
        200,
        time_ms=lambda i: 50.0 if i == 101 else 1.0,
        marks=lambda i: ("image_frozen",) if i in (37, 38, 39) else (),
    )
    kept = {sample.name: sample for sample in samples}
    assert kept["f37"].marks == ("image_frozen",)
    assert not {"f38", "f39"} & kept.keys()
    assert [sample.name for sample in samples if sample.slowest] == ["f101"]
    assert [title for title, _ in samples[0].panels] == ["image with returns", "classes", "depth"]
    content = base64.b64decode(samples[0].panels[0][1].partition(",")[2])
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR_RGB).astype(int)
    assert abs(image - answered[0].rgb).mean() < 50, "noise is hard to encode"
