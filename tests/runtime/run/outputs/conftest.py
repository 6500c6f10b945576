"""A frame, its answers, and what draws them."""

import pytest

from runtime import Predictor
from runtime.drawing.overlay import SharedOverlay
from runtime.run.options import RunOptions
from runtime.run.outputs.frame_writer import FrameWriter
from runtime.run.outputs.output import OpenRun
from runtime.run.run_folder import RunFolder
from runtime.sources.frames import Frame


@pytest.fixture
def answered(model_file, make_frame):
    """(frame, prediction)."""
    rgb, depth = make_frame(60, 80)
    rgb[..., 1] = rgb[..., 2] // 2  # boundary = green / blue stays within 0..1
    heads = ("semantic", "depth", "boundary", "depth_uncertainty")
    return Frame(rgb, depth, name="a"), Predictor(model_file(heads=heads)).predict(rgb, depth)


@pytest.fixture
def overlay(contract):
    """What draws the frames of a run."""
    return SharedOverlay(contract.classes, contract.max_depth_m)


@pytest.fixture
def open_run(model_file, overlay):
    """Make a run with these options, which is open for its outputs."""

    def make(**options):
        heads = ("semantic", "depth", "boundary", "depth_uncertainty")
        model = model_file(heads=heads)
        predictor = Predictor(model, focal_length_px=options.get("focal_length"))
        return OpenRun(
            RunOptions(**{"demo": True, "overwrite": True, **options}), predictor, overlay
        )

    return make


@pytest.fixture
def make_writer(open_run):
    """Make a writer into the folder of a run."""

    def make(out, focal_length=None, **options):
        return FrameWriter(RunFolder(out, **options), open_run(focal_length=focal_length))

    return make
