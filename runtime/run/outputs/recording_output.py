"""The frames of a run and their answers, kept for `ssdnet-verify`."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

from runtime.io.recording import RecordedFrame, Settings, record
from runtime.prediction import Prediction
from runtime.predictor import Predictor
from runtime.run.pipeline import TakeFrame
from runtime.sources.frames import Frame


@contextlib.contextmanager
def open_recording(
    folder: Path | None,
    settings: Settings,
    predictor: Predictor,
    *,
    overwrite: bool,
) -> Iterator[TakeFrame]:
    """Yield what keeps each frame and its answers in a recording, which is whole after the block;
    without a folder it keeps nothing.
    """
    if folder is None:
        yield lambda name, frame, prediction: None
        return
    with record(folder, settings, overwrite=overwrite) as recorder:

        def keep(name: str, frame: Frame, prediction: Prediction) -> None:
            entry = RecordedFrame(
                name, prediction.valid, prediction.degraded, prediction.latency.total_ms
            )
            answers = prediction.heads
            recorder.add(entry, frame.rgb, frame.sparse_depth, answers)

        yield keep
        recorder.finish(Path(predictor.model), sha256=predictor.digest)
