"""The frames of other cameras, and their scores."""

import json
import math

import cv2
import numpy as np
import pytest

from cameras import Frame, read_large, score
from training.evaluation.scoring import HeadMaps


def test_one_lidar_is_fed_and_the_other_is_the_truth(tmp_path):
    root = tmp_path / "pandaset_front"
    for folder in ("image", "points"):
        (root / folder).mkdir(parents=True)
    (root / "intrinsics.json").write_text(json.dumps({"fx": 50, "fy": 50, "cx": 30, "cy": 20}))
    cv2.imwrite(str(root / "image" / "0.jpg"), np.full((40, 60, 3), (255, 0, 0), np.uint8))
    # x, y, z, intensity, device, 0: straight ahead, one metre to the right at 50 m, and beside it.
    points = [[0, 0, 10, 0, 0, 0], [1, 0, 50, 0, 1, 0], [0, 0, 9, 0, 1, 0], [0, 1, 25, 0, 1, 0]]
    np.array(points, np.float32).tofile(root / "points" / "0.bin")
    (frame,) = read_large([tmp_path / "other", tmp_path])
    assert frame.focal_length_px == 50
    assert frame.rgb[0, 0, 2] > 200
    assert frame.rgb[0, 0, 0] < 50
    fed, truth = np.zeros((40, 60)), np.zeros((40, 60))
    fed[20, 30], truth[20, 31], truth[22, 30] = 10, 50, 25
    np.testing.assert_array_equal(frame.fed, fed)
    np.testing.assert_array_equal(frame.truth, truth)
    (turned,) = read_large([tmp_path], devices=(1, 0))
    assert (turned.fed[20, 30], turned.truth[20, 30]) == (9, 0)


def test_scores_are_means_over_frames_of_what_is_known_up_to_100_m():
    seen = []

    def predict(rgb, sparse_depth, focal_length_px):
        seen.append(focal_length_px)
        np.testing.assert_array_equal(sparse_depth, [[0, 100], [0, 7]])
        return HeadMaps(None, np.array([[12, 12], [12, 150]], np.float32), None)

    def frame(truth):
        maps, fed = (np.array(each, np.float32) for each in (truth, [[101, 100], [0, 7]]))
        return Frame(np.zeros((2, 2, 3), np.uint8), fed, maps, 700.0)

    frames = [frame([[10, 250], [16, 150]]), frame([[12, 13], [0, 99]])]
    wanted = [(3 + 2 / 3) / 2, (math.sqrt(10) + math.sqrt(2 / 3)) / 2, (3 + 1) / 2]
    assert score(predict, frames, focal=True) == pytest.approx(wanted)
    score(predict, frames, focal=False)
    assert seen == [700.0, 700.0, None, None]
