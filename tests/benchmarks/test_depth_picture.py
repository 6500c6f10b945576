"""The picture of one frame's depth by several models."""

import sys

import cv2
import numpy as np
import pytest

import depth_picture
from runtime.bundled_models import find_model


def run(monkeypatch, *arguments):
    words = ["depth_picture.py", *map(str, arguments), "--threads", "1"]
    monkeypatch.setattr(sys, "argv", words)
    depth_picture.main()


@pytest.fixture
def frame(tmp_path):
    """A frame of 40 x 64 pixels with returns at 5 m in its left half."""
    rgb, depth = np.full((40, 64, 3), 90, np.uint8), np.zeros((40, 64), np.uint16)
    depth[::3, :32:3] = 5 * 256
    cv2.imwrite(str(tmp_path / "a.png"), rgb)
    cv2.imwrite(str(tmp_path / "a_depth.png"), depth)
    return ["--rgb", tmp_path / "a.png", "--depth", tmp_path / "a_depth.png"]


def test_a_panel_a_model_and_the_same_colours_for_the_same_depth(tmp_path, frame, monkeypatch):
    out = tmp_path / "depth.png"
    models = ["ssdnet-lite", find_model("ssdnet-lite")]
    run(monkeypatch, *models, *frame, "--titles", " ", " ", "--out", out, "--return-px", 1)
    picture = cv2.imread(str(out))
    bar = picture.shape[0] - 4 * 40
    assert picture.shape == (4 * 40 + bar, 64, 3)
    _, fed, before, after = picture[: 4 * 40].reshape(4, 40, 64, 3)
    np.testing.assert_array_equal(before, after)
    assert before.std() > 0
    assert (fed[30, 3:30:3] == fed[30, 3]).all()
    assert fed[30, 3].any()
    assert not fed[29].any()
    assert not fed[25:, 32:].any()


def test_a_part_is_magnified(tmp_path, frame, monkeypatch):
    out, options = tmp_path / "depth.jpg", ["--crop", 10, 20, 16, 32, "--zoom", 4]
    run(monkeypatch, "ssdnet-lite", *frame, "--out", out, *options)
    height, width = cv2.imread(str(out)).shape[:2]
    assert width == 32 * 4
    assert 3 * 16 * 4 < height < 3 * 16 * 4 + 60
    with pytest.raises(SystemExit, match="--crop 30 20 16 32: reaches beyond the frame"):
        run(monkeypatch, "ssdnet-lite", *frame, "--out", out, "--crop", 30, 20, 16, 32)


def test_what_cannot_be_drawn_is_refused(tmp_path, frame, monkeypatch, capsys):
    out = tmp_path / "depth.png"
    with pytest.raises(SystemExit, match="no bundled model is called 'other'"):
        run(monkeypatch, "other", *frame, "--out", out)
    with pytest.raises(SystemExit, match=r"--frame 20: the stream has 0\.\.19"):
        run(monkeypatch, "ssdnet-lite", "--frame", 20, "--out", out)
    for arguments, said in (
        (["--titles", "a", "b", "--out", out], "2 --titles for 1 models"),
        (["--out", tmp_path / "depth.pdf"], "give it the ending .jpg or .png"),
        (["--rgb", out, "--out", out], "give both --rgb and --depth"),
    ):
        with pytest.raises(SystemExit):
            run(monkeypatch, "ssdnet-lite", *arguments)
        assert said in capsys.readouterr().err
    assert not out.exists()
