"""The frames of a run and their answers, kept for `ssdnet-verify`."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

from runtime.io.recording import RecordedFrame, Recorder, Settings, record
from runtime.prediction import Prediction
from runtime.run.outputs.output import OpenRun
from runtime.sync.frame import Frame


class RunRecording:
    """Record each frame and its answers, valid or not; see `open_recording`."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder

    def write(self, frame: Frame, prediction: Prediction) -> None:
        """Record a frame. Raises OutputError."""
        predict_ms, focal_px = prediction.latency.total_ms, frame.focal_length_px
        entry = RecordedFrame(
            frame.name, prediction.valid, prediction.degraded, predict_ms, focal_px
        )
        self._recorder.add(entry, frame.rgb, frame.sparse_depth, prediction.heads)


@contextlib.contextmanager
def open_recording(run: OpenRun) -> Iterator[RunRecording]:
    """Make the recording of --record, whole when the block ends, removed after an error there."""
    options, predictor = run.options, run.predictor
    assert options.record is not None
    focal_length_px, provider = predictor.focal_length_px, str(options.provider)
    settings = Settings("ssdnet-run", options.network_size, focal_length_px, provider)
    with record(options.record, settings, overwrite=options.overwrite) as recorder:
        yield RunRecording(recorder)
        recorder.finish(Path(predictor.model), sha256=predictor.digest)
