"""Outcomes of frames, made by hand."""

from dataclasses import replace

import numpy as np

from runtime.app.run.frame_record import OK, SKIPPED, FrameRecord
from runtime.engine.prediction import Latency, Prediction
from runtime.streams.frame_result import FrameResult


def outcome(
    number=0,
    status=OK,
    *,
    name=None,
    degraded=(),
    returns=0,
    latency_ms=0.0,
    deadline_met=None,
    **others,
):
    """The outcome of a frame."""
    name, size = str(number) if name is None else name, (48, 64)
    if status == SKIPPED:
        return FrameRecord(name=name, deadline_met=deadline_met)
    prediction = Prediction(
        *({}, size, size, Latency(0, 0, 0, 0)),
        valid=status == OK, degraded=degraded, depth_returns=returns,
    )  # fmt: skip
    result = FrameResult(
        sequence=number, name=name, rgb=np.zeros((*size, 3), np.uint8), prediction=prediction,
        predictor_reasons=degraded, latency_ms=latency_ms, age_ms=latency_ms,
        **{"image_stamp": None, **others},
    )  # fmt: skip
    return replace(FrameRecord.of(result, {"read": 0.0}), deadline_met=deadline_met)
