"""The video holds the overlay of every frame that was written, and is whole or not there."""

import dataclasses
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from runtime import OutputError, Predictor
from runtime.app.run.outputs.video import open_video
from runtime.drawing.overlay import Overlay
from runtime.streams.frame import Frame
from runtime.streams.messages import Image


def read_video(path):
    """(frames a second, pictures)."""
    file = cv2.VideoCapture(str(path))
    pictures = []
    while True:
        done, picture = file.read()
        if not done:
            return file.get(cv2.CAP_PROP_FPS), pictures
        pictures.append(picture)


def mean_difference(one, other):
    return abs(one.astype(int) - other).mean()


def test_it_shows_the_overlays_in_their_order(tmp_path, contract, answered, open_run):
    frame, result = answered
    overlay, expected = Overlay(contract.classes, contract.max_depth_m), []
    with open_video(open_run(video=tmp_path / "deep" / "a.mp4")) as video:
        for brightness in (40, 120, 200):
            frame = Frame(Image(np.full_like(frame.rgb, brightness)))
            video.write(frame, result)
            expected.append(overlay.draw(frame.rgb, result.prediction))
        assert not (tmp_path / "deep" / "a.mp4").exists()
    rate_hz, pictures = read_video(tmp_path / "deep" / "a.mp4")
    assert rate_hz == 10
    assert len(pictures) == 3
    for picture, drawn in zip(pictures, expected, strict=True):
        height, width = drawn.shape[:2]
        assert picture.shape == (height + height % 2, width + width % 2, 3)
        assert mean_difference(picture[:height, :width], drawn) < 12, "noise is hard to encode"
    assert mean_difference(pictures[0], pictures[1]) > 5


def test_frames_of_other_sizes_get_that_of_the_first(tmp_path, answered, open_run):
    frame, result = answered
    other = cv2.resize(frame.rgb, (400, 30))
    resized = {head: cv2.resize(each, (400, 30)) for head, each in result.prediction.heads.items()}
    answer = dataclasses.replace(result, prediction=SimpleNamespace(heads=resized))
    with open_video(open_run(video=tmp_path / "a.mp4", rate=30, overlay_width=40)) as video:
        video.write(frame, result)
        video.write(Frame(Image(other)), answer)
    rate_hz, pictures = read_video(tmp_path / "a.mp4")
    assert (rate_hz, len(pictures)) == (30, 2)
    assert pictures[0].shape == pictures[1].shape
    assert pictures[0].shape[1] % 40 == 0, "the width of a panel"
    assert pictures[1].mean() > 5


def test_a_full_disk_is_an_output_error(mount_disk, answered, open_run):
    folder = mount_disk(64)
    noise = np.random.default_rng(0)

    def fill():
        with open_video(open_run(video=folder / "a.mp4")) as video:
            for _ in range(200):
                rgb = noise.integers(0, 255, answered[0].rgb.shape, dtype=np.uint8)
                video.write(Frame(Image(rgb)), answered[1])

    with pytest.raises(OutputError, match="free some space or choose another location"):
        fill()
    assert not list(folder.iterdir())


def test_a_file_is_replaced_only_with_overwrite(tmp_path, run, monkeypatch):
    path = tmp_path / "a.mp4"
    path.symlink_to(tmp_path / "none")
    refused = run("--video", path)
    assert (refused.exit_code, "a.mp4 exists" in refused.stderr) == (1, True)
    assert not (tmp_path / "out").exists()
    assert run("--video", path, "--limit", 2, "--overwrite").exit_code == 0
    assert path.is_file()
    path.unlink()

    def appear(self, *frame, **options):
        path.write_text("mine")
        return predict(self, *frame, **options)

    predict = Predictor.predict
    monkeypatch.setattr(Predictor, "predict", appear)
    result = run("--warmup", 0, "--video", path, "--out", tmp_path / "other")
    assert (result.exit_code, f"{path} exists" in result.stderr) == (1, True)
    assert path.read_text() == "mine"
