"""A run of a stream: order, overlap, bad frames, full disks and Ctrl-C."""

import os
import sys
import threading
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import runtime.app.run.pipeline
import runtime.recordings.images
from runtime import OutputError, Predictor
from runtime.app.run.options import RunOptions
from runtime.app.run.pipeline import FrameReader, Outputs, StreamRun
from runtime.recordings.folders import FolderSource
from runtime.streams.answerer import Answerer
from runtime.streams.stream_checks import StreamChecks


@pytest.fixture
def predictor(model_file):
    with Predictor(model_file(), threads=1) as predictor:
        yield predictor


def run(
    predictor, folders, *, read=None, write=None,
    on_record=lambda record: None, stop=lambda: False, **options,
):  # fmt: skip
    source = FolderSource(folders[0], depth=folders[1])
    reader = FrameReader(SimpleNamespace(read=read or source.read))
    answerer = Answerer(predictor, StreamChecks(check_depth=False))
    outputs = Outputs([SimpleNamespace(write=write)] if write else [])
    given = RunOptions(demo=True, **options)
    stream = StreamRun(answerer, reader, given, outputs, on_record, stop)
    return stream.run(source.list_frames())


def test_every_frame_is_predicted_and_written_in_order(predictor, make_stream, make_frame):
    written, seen, folders = [], [], make_stream(12)
    result = run(
        predictor,
        folders,
        write=lambda frame, result: written.append((frame.name, frame.rgb, result.prediction)),
        on_record=lambda record: seen.append(record.name),
    )
    names = [f"f{index}" for index in range(12)]
    assert [record.name for record in result.records] == names
    assert (seen, result.interrupted) == (names, False)
    for index, (name, rgb, prediction) in enumerate(written):
        _, expected_depth = make_frame(seed=index)
        assert name == names[index]
        assert np.array_equal(rgb[..., ::-1], cv2.imread(str(folders[0] / f"{name}.png")))
        expected = np.rint(expected_depth * 256) / 256 + 1.5
        np.testing.assert_allclose(prediction.depth, expected, rtol=1e-6)
    for record in result.records:
        assert (record.status, record.prediction.frame_size) == ("ok", (48, 64))
        assert record.times_ms["read"] > 0
        assert "write" in record.times_ms
        latency = record.prediction.latency
        assert record.times_ms["latency"] == latency.total_ms >= latency.inference_ms > 0
        assert record.prediction.heads == {}, "arrays are not kept"


def test_reading_and_writing_overlap_with_inference(predictor, make_stream, monkeypatch):
    """While frame 2 is predicted, frame 3 is read and frame 1 is being written."""
    folders = make_stream(6)
    read_of = [threading.Event() for _ in range(6)]
    predicted_of = [threading.Event() for _ in range(6)]
    met: list[str] = []
    predict = predictor.predict
    count = iter(range(6))

    def read_and_tell(listed):
        frame = FolderSource(folders[0], depth=folders[1]).read(listed)
        read_of[int(listed.name[1:])].set()
        return frame

    def predict_when_others_work(rgb, depth, **options):
        index = next(count)
        if index < 5 and read_of[index + 1].wait(5):
            met.append(f"read {index + 1}")
        prediction = predict(rgb, depth, **options)
        predicted_of[index].set()
        return prediction

    def write(frame, result):
        # Ends only when the next frame was predicted: without overlap it would wait in vain.
        index = int(frame.name[1:])
        if index < 5 and predicted_of[index + 1].wait(5):
            met.append(f"written {index}")

    monkeypatch.setattr(predictor, "predict", predict_when_others_work)
    run(predictor, folders, read=read_and_tell, write=write)
    expected = [f"read {i}" for i in range(1, 6)] + [f"written {i}" for i in range(5)]
    assert sorted(met) == sorted(expected)


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere threads have no niceness")
def test_reading_and_writing_have_a_lower_priority_than_inference(predictor, make_stream):
    before = os.nice(0)
    during = []
    run(predictor, make_stream(1), write=lambda *_: during.append(os.nice(0)))
    assert during == [min(before + 10, 19)]
    assert os.nice(0) == before, "inference was slowed down as well"


# --- frames that go wrong ----------------------------------------------------------------------


def test_an_answer_with_nan_is_flagged_and_not_written(predictor, make_stream):
    folders = make_stream(3)
    picture = cv2.imread(str(folders[0] / "f1.png"))
    picture[5, 5] = 0
    cv2.imwrite(str(folders[0] / "f1.png"), picture)
    written = []
    result = run(predictor, folders, write=lambda frame, _: written.append(frame.name))
    assert [record.status for record in result.records] == ["ok", "invalid", "ok"]
    assert result.records[1].reason == "boundary_not_finite"
    assert written == ["f0", "f2"]


def test_a_full_disk_stops_the_run_and_keeps_what_was_finished(predictor, make_stream):
    written = []

    def write(frame, result):
        if frame.name == "f3":
            raise OutputError("No space left on device")
        written.append(frame.name)

    folders = make_stream(10)
    with pytest.raises(OutputError, match="No space left"):
        run(predictor, folders, write=write)
    assert written[:3] == ["f0", "f1", "f2"]
    assert len(written) < 9, "the run went on"
    assert len(run(predictor, folders).records) == 10, "the predictor is usable afterwards"
    assert not [t for t in threading.enumerate() if t.name.startswith(("read", "write"))]


# --- a constant stream -------------------------------------------------------------------------


class ManualTime:
    """Stands in for the module: only sleeping and predicting take time."""

    def __init__(self):
        self.now = 1000.0
        self.slept = []

    def perf_counter(self):
        return self.now

    def sleep(self, seconds):
        self.slept.append(seconds)
        self.now += seconds


def constant_stream(predictor, folders, monkeypatch, *, takes_s, **options):
    """Frames at 4 Hz, each of which takes its time to predict."""
    clock = ManualTime()
    predict, takes = predictor.predict, iter(takes_s)

    def slow_predict(*frame, **options):
        clock.now += next(takes)
        return predict(*frame, **options)

    monkeypatch.setattr(runtime.app.run.pipeline, "time", clock)
    monkeypatch.setattr(predictor, "predict", slow_predict)
    return clock, run(predictor, folders, rate=4, **options)


def test_a_constant_stream_predicts_when_due_and_catches_up(predictor, make_stream, monkeypatch):
    takes_s = [0.125, 0.125, 0.625, 0.125, 0.125, 0.125]
    given = predictor, make_stream(6), monkeypatch
    clock, result = constant_stream(*given, takes_s=takes_s, deadline_ms=250)
    ages_ms = [record.times_ms["age"] for record in result.records]
    # Due at 0, 250, 500, 750 ms ...; the third ends at 1125, the fourth 125 ms later.
    assert ages_ms == pytest.approx([125, 125, 625, 500, 375, 250])
    jitter_ms = [record.times_ms.get("jitter") for record in result.records]
    assert jitter_ms[0] is None
    assert jitter_ms[1:] == pytest.approx([0, 500, 125, 125, 125])
    assert [record.times_ms["latency"] for record in result.records] == ages_ms
    met = [record.deadline_met for record in result.records]
    assert met == [True, True, False, False, False, True], "the last one is exactly on it"
    assert sum(clock.slept) == pytest.approx(0.125 + 0.125)


def test_a_constant_stream_is_stopped_while_it_waits(predictor, make_stream, monkeypatch):
    asked = iter([False, False, False, True])
    given = predictor, make_stream(3), monkeypatch
    clock, result = constant_stream(*given, takes_s=[0.0] * 3, stop=lambda: next(asked))
    assert result.interrupted
    assert [record.name for record in result.records] == ["f0"]
    assert clock.slept == [0.1], "asked again every tenth of a second"
