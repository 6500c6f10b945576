"""A short stream in folders, and the command that runs over it."""

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from runtime import Predictor
from runtime.drawing.overlay import SharedOverlay
from runtime.run.cli import app
from runtime.sources.frames import Frame

N = 12


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
def stream(tmp_path, make_frame):
    """A stream of N frames of 48 x 64 in cam/ and lidar/."""
    for folder in ("cam", "lidar"):
        (tmp_path / folder).mkdir()
    for index in range(N):
        rgb, depth = make_frame(seed=index)
        rgb[..., 1] = rgb[..., 2] // 2
        rgb[:20] = index * 20 + 1
        assert cv2.imwrite(str(tmp_path / f"cam/f{index}.png"), rgb[..., ::-1])
        image = np.rint(depth * 256).astype(np.uint16)
        assert cv2.imwrite(str(tmp_path / f"lidar/f{index}.png"), image)
    return tmp_path / "cam", tmp_path / "lidar"


@pytest.fixture
def run(tmp_path, stream, model_file):
    """Run the command on the stream, into tmp_path/out, and give click's result."""
    model = model_file(heads=("semantic", "depth", "boundary", "depth_uncertainty"))

    def invoke(*arguments: object):
        rgb, depth = stream
        standard = ["--rgb", rgb, "--depth", depth, "--model", model, "--out", tmp_path / "out"]
        return CliRunner().invoke(app, [str(a) for a in [*standard, "--threads", 1, *arguments]])

    return invoke
