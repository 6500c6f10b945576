"""The frames of a run and their answers, kept for `ssdnet-verify`."""

import contextlib
from collections.abc import Iterator

from runtime.app.run.outputs.run_context import RunContext
from runtime.engine.predictor import Predictor
from runtime.streams.answerer import known_focal_length_px
from runtime.streams.frame import Frame
from runtime.streams.frame_result import FrameResult
from runtime.verification.reference import (
    PredictorSettings,
    ReferenceFrame,
    ReferenceWriter,
    write_reference,
)


class RunReference:
    """Records each frame and its answers, valid or not; see `open_reference`."""

    def __init__(self, recorder: ReferenceWriter, predictor: Predictor) -> None:
        self._recorder, self._predictor = recorder, predictor

    def write(self, frame: Frame, result: FrameResult) -> None:
        """Record a frame and what `Predictor.predict` answered. Raises OutputError."""
        prediction, reasons = result.prediction, result.predictor_reasons
        focal_px = known_focal_length_px(self._predictor, frame.calibration)
        time_ms = prediction.latency.total_ms
        entry = ReferenceFrame(frame.name, prediction.valid, reasons, time_ms, focal_px)
        self._recorder.add(entry, frame.rgb, frame.fed(frame.sparse_depth), prediction.heads)


@contextlib.contextmanager
def open_reference(run: RunContext) -> Iterator[RunReference]:
    """Make the reference of --record, complete when the block ends, removed after an error."""
    options, predictor = run.options, run.predictor
    assert options.record is not None
    focal_length_px, provider = predictor.focal_length_px, str(options.provider)
    settings = PredictorSettings("ssdnet-run", options.network_size, focal_length_px, provider)
    with write_reference(options.record, settings, overwrite=options.overwrite) as recorder:
        yield RunReference(recorder, predictor)
        recorder.finish(predictor.model.path, sha256=predictor.model.sha256)
