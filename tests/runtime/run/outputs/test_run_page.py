"""ssdnet-run --report writes one page that is true, self-contained, and fits every screen."""

import json
import re
import shutil
import subprocess

import cv2
import numpy as np
import pytest

from runtime import OutputError
from runtime.drawing.report_page.page import _problems
from runtime.drawing.report_page.template import render
from runtime.run.outputs.run_page import RunPage

CHROMIUM = next(
    (
        found
        for name in ("chromium", "chromium-browser", "google-chrome")
        if (found := shutil.which(name))
    ),
    None,
)


@pytest.fixture
def page_of(tmp_path, run, read_page):
    """Run with --report and these arguments; give (click's result, page, its source)."""

    def make(*arguments):
        path = tmp_path / "deep" / "report.html"
        result = run("--report", path, *arguments)
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


def test_the_page_shows_the_run(tmp_path, page_of, stream):
    spoil(stream)
    result, page, text = page_of("--deadline-ms", 60_000)
    assert result.exit_code == 3
    assert page.after("frames") == "12"
    assert "10 ok, 2 skipped" in page.texts
    assert page.after("missed deadlines") == "0"
    assert page.after("flagged frames") == "6"
    assert page.after("no_depth") == "3 of 12"
    assert page.after("image_frozen") == "1 of 12"
    frames = json.loads((tmp_path / "out" / "report.json").read_text())["frames"]
    assert frames["health"] == {"image_frozen": 1}, "as on the page"
    assert "health: image_frozen: 1" in result.stdout
    assert page.after("skipped") == "2 of 12"
    assert "f6 has an image, but no depth map" in page.texts
    assert page.after("name") == "by-hand"
    assert len(page.after("SHA-256")) == 64
    assert page.after("answers") == "semantic, depth, boundary, depth_uncertainty"
    assert page.after("requested") == "cpu"
    for library in ("ONNX Runtime", "OpenCV", "NumPy", "Python"):
        assert re.match(r"\d+\.\d+", page.after(library))
    assert text.count("<polyline") == 3, "the line is broken twice"
    assert "deadline 60000 ms" in page.texts
    assert "red" in page.texts
    assert "background:rgb(200, 30, 30)" in text
    assert "report: " in result.stdout


def test_the_page_loads_nothing(page_of):
    _, page, text = page_of()
    assert len([link for link in page.links if link.startswith("data:image/")]) >= 3
    assert all(link.startswith("data:") for link in page.links)
    assert "default-src 'none'" in text
    assert not re.search(r"https?:|url\(|@import|<script", text)


def test_missed_deadlines_are_shown(page_of):
    result, page, text = page_of("--deadline-ms", 1e-6)
    assert result.exit_code == 4
    assert page.after("missed deadlines") == "12"
    assert page.after("late") == "12 of 12"
    assert text.count('<path class="late"') == 12


def test_a_constant_stream_shows_the_age(page_of):
    _, page, _ = page_of("--rate", 200)
    assert page.after("median age").endswith(" ms")
    assert page.after("scenario") == "constant-stream, 200 Hz"


def test_a_run_without_faults_is_shown_as_such(page_of):
    _, page, _ = page_of()
    assert "All frames were answered, none is flagged." in page.texts
    assert "missed deadlines" not in page.texts


def test_a_run_without_an_answer_has_a_page(page_of, stream):
    for path in stream[0].iterdir():
        path.write_bytes(b"")
    result, page, _ = page_of()
    assert result.exit_code == 3
    assert "No frame was answered." in page.texts
    assert page.after("skipped") == "12 of 12"


@pytest.mark.parametrize(
    ("n", "texts"), [(10, []), (11, ["1 more"]), (205, ["190 more", "and 5 more, see frames.csv"])]
)
def test_many_problems_do_not_fill_the_page(n, texts, read_page):
    problems = _problems([(f"f{index}", "skipped", "why") for index in range(n)])
    text = render("problems.html", {"problems": problems})
    page = read_page(text)
    assert [each for each in page.texts if "more" in each] == texts
    assert text.count("<tr><td>f") == min(n, 200)


def test_an_empty_shard_has_a_page(page_of):
    _, page, _ = page_of("--shard", "13/13")
    assert page.after("frames") == "0"


@pytest.mark.parametrize("name", ["<b>&x", "f\udcff3"])
def test_names_are_text(page_of, stream, name):
    for folder in stream:
        (folder / "f0.png").rename(folder / f"{name}.png")
    (stream[1] / f"{name}.png").write_bytes(b"")
    _, page, text = page_of()
    assert name.encode(errors="backslashreplace").decode() in page.texts
    assert "<b>&x" not in text


def test_after_a_signal_its_frames_are_those_that_were_written(
    page_of, tmp_path, signal_in_frame_6
):
    result, page, _ = page_of("--warmup", 0)
    assert result.exit_code == 3
    assert "interrupted" in page.texts
    assert page.after("frames") == "7"
    assert "7 ok" in page.texts
    assert len(list((tmp_path / "out/depth").iterdir())) == 7


def test_the_page_is_replaced_only_with_overwrite(tmp_path, run):
    path = tmp_path / "report.html"
    path.write_text("mine")
    result = run("--report", path)
    assert result.exit_code == 1
    assert "report.html exists" in result.stderr
    assert path.read_text() == "mine"
    assert not (tmp_path / "out").exists()
    assert run("--report", tmp_path / "report.pdf").exit_code == 2


def test_a_place_that_cannot_be_written_is_reported_before_the_run(tmp_path, run):
    (tmp_path / "file").write_text("")
    result = run("--report", tmp_path / "file" / "report.html")
    assert result.exit_code == 1
    assert "report.html" in result.stderr
    assert "choose another location" in result.stderr
    assert not (tmp_path / "out").exists()


def test_the_page_may_lie_in_the_folder_of_the_run(tmp_path, run):
    path = tmp_path / "out" / "report.html"
    assert run("--report", path).exit_code == 0
    assert path.read_text().endswith("</html>\n")
    assert run("--report", path, "--overwrite").exit_code == 0


def test_a_page_that_cannot_be_written_costs_no_other_result(tmp_path, run, monkeypatch):
    def full(*arguments):
        raise OutputError("no room")

    monkeypatch.setattr(RunPage, "render", full)
    assert run("--report", tmp_path / "report.html").exit_code == 1
    for name in ("frames.csv", "report.json"):
        assert (tmp_path / "out" / name).exists()


def screenshot(page, picture, *, width, dark=False):
    """Open a file in a browser of its own; (H, width, 3)."""
    profile = picture.with_suffix(".profile")
    command = [
        CHROMIUM,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-quic",
        "--no-first-run",
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
        "--hide-scrollbars",
        f"--user-data-dir={profile}",
        f"--blink-settings=preferredColorScheme={int(not dark)}",
        f"--window-size={width},2400",
        f"--screenshot={picture}",
        page.as_uri(),
    ]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    return cv2.imread(str(picture)).astype(int)


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed (Debian: chromium)")
def test_a_browser_shows_it_on_every_screen(page_of, stream, tmp_path):
    spoil(stream)
    page_of("--deadline-ms", 60_000)
    path = tmp_path / "deep" / "report.html"
    wide = screenshot(path, tmp_path / "wide.png", width=1200)
    dark = screenshot(path, tmp_path / "dark.png", width=1200, dark=True)
    phone = screenshot(path, tmp_path / "phone.png", width=390)
    assert wide[5, 5].tolist() == [247, 245, 244], "the page, light"
    assert dark[5, 5].tolist() == [21, 17, 15]
    assert phone.shape[1] == 390
    for picture in (wide, dark, phone):
        margin, inside = picture[:, -8:], picture[100:1200, 40:-40]
        assert (margin == picture[5, 5]).all(), "nothing runs off the screen"
        assert inside.std() > 5, "there is something on it"
    line = np.array([197, 96, 35])  # blue first
    for picture in (wide, phone):
        assert (abs(picture[:1200] - line).max(axis=-1) < 10).sum() > 100, "the chart's line"
