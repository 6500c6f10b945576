"""The frames of the rigs: which returns are fed, and which are the truth."""

import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

import rigs
from training.scores.scoring import HeadMaps


@pytest.fixture
def pandaset(tmp_path):
    root = tmp_path / "pandaset_front"
    for folder in ("image", "points"):
        (root / folder).mkdir(parents=True)
    (root / "intrinsics.json").write_text(json.dumps({"fx": 50, "fy": 50, "cx": 30, "cy": 20}))
    cv2.imwrite(str(root / "image" / "0.jpg"), np.full((40, 60, 3), (255, 0, 0), np.uint8))
    # x, y, z, intensity, device, 0: straight ahead, one metre to the right at 50 m, and beside it.
    points = [[0, 0, 10, 0, 0, 0], [6, 0, 20, 0, 1, 0], [0, 0, 9, 0, 1, 0], [0, 1, 25, 0, 1, 0]]
    np.array(points, np.float32).tofile(root / "points" / "0.bin")
    return [tmp_path / "other", tmp_path]


def test_one_lidar_is_fed_and_the_returns_of_the_other_that_are_seen_are_the_truth(pandaset):
    (frame,) = rigs.read_pandaset(0, 1, 1.0, pandaset)
    assert frame.focal_length_px == 50
    assert frame.rgb[0, 0, 2] > 200
    assert frame.rgb[0, 0, 0] < 50
    fed, truth = np.zeros((40, 60)), np.zeros((40, 60))
    # The return at 25 m is beside the nearer one at 9 m; that one is at a fed pixel.
    fed[20, 30], truth[20, 45] = 10, 20
    np.testing.assert_array_equal(frame.fed, fed)
    np.testing.assert_array_equal(frame.truth, truth)
    (turned,) = rigs.read_pandaset(1, 0, 1.0, pandaset)
    assert (turned.fed[20, 30], turned.fed[20, 45], np.count_nonzero(turned.truth)) == (9, 20, 0)
    (narrow,) = rigs.read_pandaset(0, 1, 1.0, pandaset, hidden=rigs.NARROW)
    assert narrow.truth[22, 30] == 25


def test_a_reduced_picture_keeps_the_pixels_of_its_returns(pandaset, monkeypatch):
    monkeypatch.setattr(rigs, "ROWS", 20)
    (frame,) = rigs.read_pandaset(1, 0, 1.0, pandaset)
    assert frame.rgb.shape == (20, 30, 3)
    assert frame.focal_length_px == 25
    # 45 of 60 columns, 20 of 40 rows: pixel centres are integers.
    assert frame.fed[round(20.5 / 2 - 0.5), round(45.5 / 2 - 0.5)] == 20


def test_the_window_that_hides_returns_grows_with_the_picture():
    assert rigs.magnified(rigs.HIDDEN, 375).window == rigs.HIDDEN.window == (15, 9)
    assert rigs.magnified(rigs.HIDDEN, 1080).window == (39, 23)


def test_withheld_returns_are_the_truth():
    returns = np.zeros((200, 300), np.float32)
    returns[::20, ::12] = 30
    frame = rigs.withhold(rigs.Frame(None, returns, returns, None), 0.25, 0)
    np.testing.assert_array_equal(frame.fed + frame.truth, returns)
    assert 0.15 < np.count_nonzero(frame.fed) / np.count_nonzero(returns) < 0.35


def test_errors_are_means_over_frames_up_to_the_range():
    truth = np.array([[10, 0, 120, 99]], np.float32)
    frames = [rigs.Frame(None, 0 * truth, truth, None)] * 2
    answers = iter([[[13, 7, 7, 400]], [[10, 7, 7, 92]]])

    def predict(rgb, fed, focal_length_px):
        return HeadMaps(depth=np.array(next(answers), np.float32))

    mae, rmse, median = rigs.score(predict, frames)
    assert (mae, median) == (pytest.approx((2 + 3.5) / 2), pytest.approx((2 + 3.5) / 2))
    assert rmse == pytest.approx((np.sqrt(10 / 2) + np.sqrt(49 / 2)) / 2)


DATA = os.environ.get("SSDNET_DATA")


@pytest.mark.skipif(not DATA, reason="SSDNET_DATA names no folder of recordings")
def test_every_set_is_read():
    folders = [Path(str(DATA))]
    for name, (folder, read) in rigs.SETS.items():
        if rigs.find_folder(folders, folder):
            frame = next(read(folders))
            assert frame.fed.any(), name
            assert frame.truth.any(), name
            assert not ((frame.fed > 0) & (frame.truth > 0)).any() or "lines" in name
