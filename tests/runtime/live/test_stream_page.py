"""The page of a stream, made of its statistics and counts."""

import pytest

from runtime import OutputError, Predictor, PushStream
from runtime.live.stream_page import StreamPage

N = 9


@pytest.fixture
def streamed(model_file, make_frame):
    """(page, stream) after N frames, one without depth, one frozen, and one depth map alone."""
    with Predictor(model_file(), threads=1) as predictor:
        page = StreamPage(predictor)
        with PushStream(
            predictor, mode="replay", deadline_ms=1e-3, reuse_depth_ms=0, on_result=page.add
        ) as stream:
            for index in range(N):
                rgb, depth = make_frame(seed=index - (index == 5))
                stream.push_image(rgb, 0.1 * index)
                if index != 3:
                    stream.push_depth(depth, 0.1 * index)
            stream.push_depth(depth, 9.0)
        yield page, stream


def test_the_page_shows_the_stream(tmp_path, streamed, read_page):
    page, stream = streamed
    path = tmp_path / "deep" / "report.html"
    page.write(str(path), stream)
    text = path.read_text()
    read = read_page(text)
    assert "Stream of by-hand" in read.texts
    assert read.after("frames") == str(N)
    assert read.after("missed deadlines") == str(N)
    assert read.after("late") == f"{N} of {N}"
    assert read.after("no_depth") == f"1 of {N}"
    assert read.after("image_frozen") == f"1 of {N}"
    assert read.after("images") == f"{N} pushed; {N} answered"
    assert read.after("depth maps") == f"{N} pushed; {N - 1} answered; 1 unmatched (no_image 1)"
    assert (read.after("poses"), read.after("answered with an older scan")) == ("none", "0")
    assert read.after("state").split(", ") == [stream.state.level, *stream.state.reasons]
    assert text.count('<path class="late"') == N
    assert text.count("<figure>") >= 3
    for stage, figures in stream.statistics.stages.items():
        assert (figures is None) == (stage not in read.texts)
    assert all(link.startswith("data:") for link in read.links)


def test_it_may_be_written_repeatedly_and_while_the_stream_runs(
    tmp_path, model_file, make_frame, read_page
):
    path = tmp_path / "report.html"
    with Predictor(model_file(), threads=1) as predictor:
        page = StreamPage(predictor)
        with PushStream(predictor, mode="replay", max_wait_ms=0, on_result=page.add) as stream:
            page.write(path, stream)
            assert read_page(path.read_text()).after("frames") == "0"
            stream.push_image(make_frame()[0], 0.0)
        page.write(path, stream)
    assert read_page(path.read_text()).after("frames") == "1"


def test_a_path_that_cannot_be_written_is_an_output_error(tmp_path, streamed):
    page, stream = streamed
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot write"):
        page.write(tmp_path / "file" / "a.html", stream)


def test_age_and_source_of_the_returns_are_shown(tmp_path, model_file, make_frame, read_page):
    path = tmp_path / "report.html"
    with Predictor(model_file(), threads=1) as predictor:
        page = StreamPage(predictor)
        with PushStream(predictor, mode="replay", on_result=page.add) as stream:
            for index in range(4):
                rgb, depth = make_frame(seed=index)
                stream.push_image(rgb, 0.05 * index)
                if index % 2 == 0:
                    stream.push_depth(depth, 0.05 * index)
        page.write(path, stream)
    read = read_page(path.read_text())
    assert read.after("answered with an older scan") == "2"
    assert read.after("depth_reused") == "2 of 4"
    assert "depth age" in read.texts
