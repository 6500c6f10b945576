"""A short stream in folders, and the command that runs over it."""

import signal

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from runtime import Predictor
from runtime.app.run.cli import app


@pytest.fixture
def make_stream(tmp_path, make_frame):
    """Write n frames of 48 x 64 into cam/ and lidar/; gives the two folders."""

    def make(n):
        folders = tmp_path / "cam", tmp_path / "lidar"
        for folder in folders:
            folder.mkdir()
        for index in range(n):
            rgb, depth = make_frame(seed=index)
            rgb[..., 1] = rgb[..., 2] // 2
            rgb[:20] = index * 20 % 255 + 1
            assert cv2.imwrite(str(folders[0] / f"f{index}.png"), rgb[..., ::-1])
            image = np.rint(depth * 256).astype(np.uint16)
            assert cv2.imwrite(str(folders[1] / f"f{index}.png"), image)
        return folders

    return make


@pytest.fixture
def stream(make_stream):
    """A stream of 12 frames."""
    return make_stream(12)


@pytest.fixture
def all_heads(model_file):
    """A model by hand with every head but the logits."""
    return model_file(heads=("semantic", "depth", "boundary", "depth_uncertainty"))


@pytest.fixture
def run(tmp_path, stream, all_heads):
    """Run the command on the stream, into tmp_path/out, and give click's result."""

    def invoke(*arguments: object):
        rgb, depth = stream
        standard = ["--rgb", rgb, "--depth", depth, "--model", all_heads, "--out", tmp_path / "out"]
        return CliRunner().invoke(app, [str(a) for a in [*standard, "--threads", 1, *arguments]])

    return invoke


@pytest.fixture(params=[signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def signal_in_frame_6(request, monkeypatch):
    """The process gets this signal while it predicts the seventh frame of the stream."""
    predict = Predictor.predict
    count = iter(range(100))

    def interrupted(self, rgb, sparse_depth=None, **options):
        # Warming up and the check before the stream ask the camera alone.
        if np.any(sparse_depth) and next(count) == 6:
            signal.raise_signal(request.param)
        return predict(self, rgb, sparse_depth, **options)

    monkeypatch.setattr(Predictor, "predict", interrupted)
    return request.param
