"""The frames of a run and their answers, kept for `ssdnet-verify`."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

from runtime.io.recording import RecordedFrame, Recorder, Settings, record
from runtime.prediction import Prediction
from runtime.predictor import Predictor
from runtime.sources.frames import Frame


class RunRecording:
    """Record each frame and its answers, valid or not; see `open_recording`."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder

    def write(self, frame: Frame, prediction: Prediction) -> None:
        """Record a frame. Raises OutputError."""
        entry = RecordedFrame(
            frame.name, prediction.valid, prediction.degraded, prediction.latency.total_ms
        )
        self._recorder.add(entry, frame.rgb, frame.sparse_depth, prediction.heads)


@contextlib.contextmanager
def open_recording(
    folder: Path, settings: Settings, predictor: Predictor, *, overwrite: bool
) -> Iterator[RunRecording]:
    """Make a recording in `folder`, whole when the block ends, removed after an error there."""
    with record(folder, settings, overwrite=overwrite) as recorder:
        yield RunRecording(recorder)
        recorder.finish(Path(predictor.model), sha256=predictor.digest)
