"""The frames of other cameras."""

import json

import cv2
import numpy as np

from cameras import read_large


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
