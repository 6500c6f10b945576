"""Outcomes of frames, made by hand."""

from runtime.engine.prediction import Latency, Prediction
from runtime.streams.frame_result import OK, SKIPPED, FrameResult


def outcome(number=0, status=OK, *, degraded=(), returns=0, **others):
    """The outcome of a frame."""
    size, latency = (48, 64), Latency(0, 0, 0, 0)
    prediction = Prediction(
        {}, size, size, latency, valid=status == OK, degraded=degraded, depth_returns=returns
    )
    known = {} if status == SKIPPED else {"prediction": prediction}
    return FrameResult(sequence=number, **{"name": str(number), **known, **others})
