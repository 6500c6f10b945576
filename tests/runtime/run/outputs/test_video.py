"""The video holds the overlay of every frame that was written, and is whole or not there."""

import dataclasses
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from runtime import OutputError, Predictor
from runtime.drawing.overlay import Overlay
from runtime.run.cli import app
from runtime.run.outputs.video import open_video
from runtime.sync.frame import Frame, Message


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
            frame = Frame(Message(data=np.full_like(frame.rgb, brightness)))
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
    assert mean_difference(pictures[0], pictures[1]) > 10


@pytest.mark.parametrize("size", [(61, 81), (30, 400)])
def test_frames_of_other_sizes_get_that_of_the_first(tmp_path, answered, size, open_run):
    frame, result = answered
    other = cv2.resize(frame.rgb, size[::-1])
    resized = {
        head: cv2.resize(getattr(result.prediction, head), size[::-1])
        for head in ("semantic", "depth", "boundary", "depth_uncertainty")
    }
    answer = dataclasses.replace(result, prediction=SimpleNamespace(heads=resized))
    with open_video(open_run(video=tmp_path / "a.mp4", rate=30)) as video:
        video.write(frame, result)
        video.write(Frame(Message(data=other)), answer)
    rate_hz, pictures = read_video(tmp_path / "a.mp4")
    assert rate_hz == 30
    assert len(pictures) == 2
    assert pictures[0].shape == pictures[1].shape
    assert pictures[1].mean() > 5


@pytest.mark.parametrize(
    ("given", "panel", "in_video"),
    [([], (500, 320), (1000, 640)), (["--overlay-width", 250], (250, 160), (250, 160))],
)
def test_the_video_has_the_width_of_the_frames(
    tmp_path, model_file, make_frame, given, panel, in_video
):
    """Overlays are at most 640 wide, unless --overlay-width says otherwise for both."""
    rgb, _ = make_frame(640, 1000)
    rgb[..., 1] = rgb[..., 2] // 2
    cv2.imwrite(str(tmp_path / "a.png"), rgb[..., ::-1])
    command = [tmp_path / "a.png", "--model", model_file(), "--out", tmp_path / "out", *given]
    command += ["--save", "overlay", "--video", tmp_path / "a.mp4", "--size", 64]
    result = CliRunner().invoke(app, [str(word) for word in command])
    assert result.exit_code == 0, result.output
    overlay = cv2.imread(str(tmp_path / "out/overlay/a.jpg"))
    panels = overlay.shape[1] // panel[0]
    assert panels * panel[0] == overlay.shape[1]
    assert overlay.shape[0] >= panel[1]
    _, (picture,) = read_video(tmp_path / "a.mp4")
    assert picture.shape[1] == min(panels * in_video[0], 4096)


def test_a_run_without_frames_has_no_video(tmp_path, open_run):
    (tmp_path / "a.mp4").write_text("of before")
    with open_video(open_run(video=tmp_path / "a.mp4")):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["model.onnx"]


def test_a_full_disk_is_an_output_error(mount_disk, answered, open_run):
    folder = mount_disk(64)
    noise = np.random.default_rng(0)

    def fill():
        with open_video(open_run(video=folder / "a.mp4")) as video:
            for _ in range(200):
                rgb = noise.integers(0, 255, answered[0].rgb.shape, dtype=np.uint8)
                video.write(Frame(Message(data=rgb)), answered[1])

    with pytest.raises(OutputError, match="free some space or choose another location"):
        fill()
    assert not list(folder.iterdir())


@pytest.mark.parametrize("suffix", ["mp4", "html", "mcap"])
def test_a_file_is_replaced_only_with_overwrite(tmp_path, run, monkeypatch, suffix):
    option = {"mp4": "--video", "html": "--report", "mcap": "--mcap"}[suffix]
    if suffix == "mcap":
        pytest.importorskip("rosbags")
    path = tmp_path / f"a.{suffix}"
    assert run(option, tmp_path / "a.pdf").exit_code == 2
    path.symlink_to(tmp_path / "none")
    refused = run(option, path)
    assert refused.exit_code == 1
    assert f"a.{suffix} exists: choose another name, or replace it with --over" in refused.stderr
    assert not (tmp_path / "out").exists()
    assert run(option, path, "--limit", 2, "--overwrite").exit_code == 0
    assert path.is_file()
    path.unlink()
    path.mkdir()
    assert "is a folder: name a file" in run(option, path, "--overwrite").stderr
    path.rmdir()
    (tmp_path / "file").touch()
    unwritable = run(option, tmp_path / "file" / path.name, "--overwrite")
    assert "choose another location" in unwritable.stderr

    def appear(self, *frame, **options):
        path.write_text("mine")
        return predict(self, *frame, **options)

    predict = Predictor.predict
    monkeypatch.setattr(Predictor, "predict", appear)
    result = run("--warmup", 0, option, path, "--out", tmp_path / "other")
    assert (result.exit_code, f"{path} exists" in result.stderr) == (1, True)
    assert path.read_text() == "mine"
