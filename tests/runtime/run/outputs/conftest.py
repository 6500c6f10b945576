"""A frame, its answers, and what draws them."""

import pytest

from runtime import Predictor
from runtime.drawing.overlay import Overlay
from runtime.run.options import RunOptions
from runtime.run.outputs.output import OpenRun
from runtime.sync.frame import Frame


@pytest.fixture
def answered(all_heads, make_frame):
    """(frame, prediction)."""
    rgb, depth = make_frame(60, 80)
    rgb[..., 1] = rgb[..., 2] // 2  # boundary = green / blue stays within 0..1
    return Frame(rgb, depth, name="a"), Predictor(all_heads).predict(rgb, depth)


@pytest.fixture
def open_run(all_heads, contract):
    """Make a run with these options, which is open for its outputs."""

    def make(*, kinds=(), names=(), **options):
        predictor = Predictor(all_heads, focal_length_px=options.get("focal_length"))
        overlay = Overlay(contract.classes, contract.max_depth_m)
        given = RunOptions(**{"demo": True, "overwrite": True, **options})
        return OpenRun(given, predictor, overlay, kinds, names)

    return make
