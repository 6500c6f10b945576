"""KITTI's object layout: a calibration a frame."""

import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest
from small_rig import SIZE, projected
from typer.testing import CliRunner

from runtime import InputError
from runtime.io.recording import read_recording
from runtime.sources.layouts import KittiObjectSource
from runtime.sources.registry import open_source
from runtime.tools.verify import app as verify_app

DATA = os.environ.get("SSDNET_DATA")


def calibration(focal_px, *, baseline_px=0.0):
    """As KITTI writes it; camera 3 is beside the others."""
    lines = [f"P{n}: {focal_px} 0 32 0 0 {focal_px} 24 0 0 0 1 0" for n in range(3)]
    lines.append(f"P3: {focal_px} 0 32 {baseline_px} 0 {focal_px} 24 0 0 0 1 0")
    lines.append("R0_rect: 1 0 0 0 1 0 0 0 1")
    lines.append("Tr_velo_to_cam: 0 -1 0 0 0 0 -1 -0.3 1 0 0 0")
    lines.append("Tr_imu_to_velo: 1 0 0 0 0 1 0 0 0 0 1 0")
    return "\n".join(lines) + "\n\n"


@pytest.fixture
def training(tmp_path, make_frame, make_scan, write_rgb):
    """Five frames with focal lengths of 60 to 64 px; labels and a right camera beside them."""
    folder = tmp_path / "training"
    for name in ("velodyne", "calib", "label_2", "image_3"):
        (folder / name).mkdir(parents=True)
    for number in range(5):
        write_rgb(folder / f"image_2/{number:06d}.png", make_frame(*SIZE, seed=number)[0])
        make_scan(number).tofile(folder / f"velodyne/{number:06d}.bin")
        (folder / f"calib/{number:06d}.txt").write_text(calibration(60 + number))
        (folder / f"label_2/{number:06d}.txt").write_text("Car 0 0 0 0 0 0 0 0 0 0 0 0 0 0\n")
    return folder


@pytest.mark.parametrize(("given", "focal_px"), [([], None), (["--focal-length", 200], 200)])
def test_each_frame_is_predicted_with_its_focal_length(
    training, run, model_file, contract, make_scan, tmp_path, given, focal_px
):
    """The graph adds 1.5 m of a camera of 100 px, which are 1.5 m times f / 100 of any other."""
    canonical = dataclasses.replace(contract, canonical_focal_px=100.0, max_depth_m=400.0)
    model = model_file(contract=canonical, heads=("semantic", "depth"))
    answers = run(training, "--model", model, "--record", tmp_path / "recording", *given)
    assert answers.exit_code == 0, answers.text
    for number in range(5):
        focal = focal_px or 60 + number
        expected = projected(make_scan(number), focal_px=60 + number) + 1.5 * focal / 100
        assert abs(answers.fed_depth(f"{number:06d}") + 1.5 - expected).max() < 0.01
    recording = read_recording(tmp_path / "recording")
    assert [each.focal_length_px for each in recording.frames] == [
        focal_px or 60 + number for number in range(5)
    ]
    done = CliRunner().invoke(verify_app, [str(tmp_path / "recording")])
    assert done.exit_code == 0, done.output


@pytest.mark.parametrize("kind", ["kitti-object", "folders", "one-folder"])
def test_the_right_camera_has_its_own_projection(training, make_frame, write_rgb, kind, make_scan):
    write_rgb(training / "image_3/000001.png", make_frame(*SIZE)[0])
    (training / "calib/000001.txt").write_text(calibration(61, baseline_px=-30.5))
    path, options = training, {"camera": 3}
    if kind != "kitti-object":
        options = {"points": training / "velodyne", "calibration": training / "calib"}
        path = training / "image_3"
    with open_source(kind, path, **options) as source:
        (listed,) = (each for each in source.list_frames() if each.name == "000001")
        expected = projected(make_scan(1), focal_px=61, left_m=-0.5)
        assert abs(source.read(listed).sparse_depth - expected).max() < 0.01


def test_an_image_without_its_scan_is_the_camera_alone(training):
    (training / "velodyne/000001.bin").unlink()
    (training / "image_2/000003.png").unlink()
    source = KittiObjectSource(training)
    frames = source.list_frames()
    assert [each.name for each in frames] == ["000000", "000001", "000002", "000004"]
    assert [source.read(each).sparse_depth.any() for each in frames] == [True, False, True, True]
    assert source.inputs["left_out"] == {"depth: no_image": 1}
    assert "left out: depth: no_image 1" in source.notes


def test_without_scans_the_camera_alone_is_read(training):
    (training / "velodyne").rename(training / "scans")
    source = KittiObjectSource(training)
    assert [each.complete for each in source.list_frames()] == [True] * 5
    assert source.read(source.list_frames()[0]).depth is None
    assert any("no velodyne folder" in note for note in source.notes)
    assert source.calibration.focal_length_px == 60


def test_what_is_missing_costs_its_frame(training):
    with pytest.raises(InputError, match="camera="):
        KittiObjectSource(training, camera=1)
    (training / "calib/000000.txt").write_text("P2: nan\n")
    (training / "calib/000002.txt").unlink()
    source = KittiObjectSource(training)
    frames = source.list_frames()
    for index, named in ((0, "'P2'"), (2, "000002 has no calibration")):
        with pytest.raises(InputError, match=named):
            source.read(frames[index])
    assert source.calibration.focal_length_px == source.read(frames[1]).calibration.focal_length_px


@pytest.mark.skipif(not DATA, reason="SSDNET_DATA names no folder of recordings")
def test_recorded_frames_have_returns_where_there_are_scans():
    folder = Path(DATA) / "kitti_object"
    with KittiObjectSource(folder, points=folder / "velodyne_fov") as source:
        frames = {listed.name: source.read(listed) for listed in source.list_frames()}
    returns = {name: np.count_nonzero(frame.sparse_depth) for name, frame in frames.items()}
    with_scan = [name for name, count in returns.items() if count]
    assert len(frames) == 18
    assert with_scan == [f"{number:06d}" for number in (4, 5, 6, 7, 9)]
    assert all(returns[name] > 15_000 for name in with_scan)
    assert len({frame.calibration.focal_length_px for frame in frames.values()}) > 1
