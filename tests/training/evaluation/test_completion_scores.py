"""Classical completion on the recorded stream."""

import os
from pathlib import Path

import pytest

from training.datasets.kitti_stream import KittiStream
from training.evaluation.metrics import DepthScores
from training.evaluation.scored_model import open_method
from training.lidar.split import LidarInput, frame_generator, split_lidar


@pytest.fixture(scope="module")
def stream():
    root = os.environ.get("SSDNET_DATA")
    if not root or not (Path(root) / "kitti_stream").is_dir():
        pytest.skip("SSDNET_DATA does not point to the recorded stream")
    return Path(root) / "kitti_stream"


def test_ip_basic_beats_nearest_on_withheld_scan_lines(stream):
    """Frames 50-59, every second line fed: near the 0.5 m / 2.4 m these methods come to there."""
    scores = {name: DepthScores() for name in ("nearest", "ip-basic")}
    predict = {name: open_method(name).predict for name in scores}
    source = KittiStream(stream, first=50, last=59)
    for index in range(0, 10, 3):
        frame = split_lidar(source[index], LidarInput("own"), frame_generator(index))
        for name, score in scores.items():
            score.update(predict[name](frame.sample.rgb, frame.fed, None).depth, frame.target)
    nearest, morphology = (score.compute() for score in scores.values())
    assert 0.40 < morphology.metres.mae < nearest.metres.mae < 0.60
    assert 1.9 < morphology.metres.rmse < nearest.metres.rmse < 3.0
