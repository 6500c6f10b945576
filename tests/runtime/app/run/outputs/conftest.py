"""A frame, its answers, and what draws them."""

import pytest

from runtime import Predictor
from runtime.app.run.options import RunOptions
from runtime.app.run.outputs.run_context import RunContext
from runtime.streams.frame import Frame
from runtime.streams.frame_result import FrameResult
from runtime.streams.messages import Depth, Image


@pytest.fixture
def answered(all_heads, make_frame):
    """(frame, result)."""
    rgb, depth = make_frame(60, 80)
    rgb[..., 1] = rgb[..., 2] // 2  # boundary = green / blue stays within 0..1
    prediction = Predictor(all_heads).predict(rgb, depth)
    frame = Frame(Image(rgb), Depth(depth), name="a")
    latency_ms = prediction.latency.total_ms
    return frame, FrameResult(
        sequence=0, name="a", rgb=rgb, prediction=prediction, predictor_reasons=(),
        image_stamp=None, latency_ms=latency_ms, age_ms=latency_ms,
    )  # fmt: skip


@pytest.fixture
def open_run(all_heads):
    """Make a run with these options, which is open for its outputs."""

    def make(*, kinds=(), names=(), **options):
        predictor = Predictor(all_heads, focal_length_px=options.get("focal_length"))
        given = RunOptions(**{"demo": True, "overwrite": True, **options})
        return RunContext(given, predictor, kinds, names)

    return make
