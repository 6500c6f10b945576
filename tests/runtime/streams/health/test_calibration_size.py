"""A calibration of another image size is found by the picture, not by its principal point alone."""

import json

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from runtime import Predictor
from runtime.app.run.cli import app
from runtime.geometry.calibration import Calibration
from runtime.recordings.bundled_stream import BUNDLED_FOCAL_LENGTH_PX, bundled_frames
from runtime.streams.health.calibration_size import CalibrationSize


@pytest.fixture(scope="module")
def nano():
    with Predictor("ssdnet-nano") as predictor:
        yield predictor


@pytest.fixture(scope="module")
def bundled():
    """Images of the bundled stream, their returns as points in the camera's frame, intrinsics."""
    frames, focal = [], BUNDLED_FOCAL_LENGTH_PX
    for frame in bundled_frames()[:15:7]:
        height, width = frame.size
        intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
        row, column = np.nonzero(frame.sparse_depth)
        rays = np.stack([column, row, np.ones(len(row))]).T @ np.linalg.inv(intrinsics).T
        depth = frame.sparse_depth[row, column, None]
        frames.append((frame.rgb, (rays * depth).astype(np.float32)))
    return frames, intrinsics


def changed(rgb, intrinsics, change):
    """An image and the intrinsics that are used with it; change: its scale, or rows and columns."""
    intrinsics = intrinsics.copy()
    if isinstance(change, tuple):
        rows, columns = change
        intrinsics[:2, 2] -= columns.start or 0, rows.start or 0
        return np.ascontiguousarray(rgb[change]), intrinsics
    if change > 1:
        intrinsics[:2] /= change
        return rgb, intrinsics
    return cv2.resize(rgb, None, fx=change, fy=change, interpolation=cv2.INTER_AREA), intrinsics


WRONG = (0.5, 2 / 3, 2)
# As it is, or cut by a third together with its calibration; below, that changes nothing.
RIGHT = (1.0, np.s_[85:, :], np.s_[:, :-277])


@pytest.mark.parametrize("change", WRONG + RIGHT)
def test_images_of_another_size_are_found_and_cut_ones_are_not(nano, bundled, change):
    frames, known = bundled
    check = CalibrationSize()
    for rgb, points in frames:
        image, intrinsics = changed(rgb, known, change)
        calibration = Calibration(intrinsics, np.eye(4))
        sparse_depth = calibration.project(points, image.shape[:2])
        camera_only = nano.predict(image, None, focal_length_px=intrinsics[0, 0])
        check.add(camera_only, sparse_depth, calibration)
    finding = check.finding()
    assert (finding is not None) == (change in WRONG)
    if finding is not None:
        assert f"returns fit them better at {change:.2g} times its scale" in finding
        assert "multiply the first two rows of the intrinsics" in finding


@pytest.mark.parametrize("is_known", [True, False])
def test_a_stated_size_is_not_believed_and_no_calibration_is_not_judged(nano, bundled, is_known):
    """Whoever changes the size to that of the images may forget the intrinsics."""
    frames, intrinsics = bundled
    rgb, points = frames[0]
    small = np.ascontiguousarray(rgb[::2, ::2])
    size = small.shape[:2]
    calibration = Calibration(intrinsics, np.eye(4), size)
    check = CalibrationSize()
    camera_only = nano.predict(small, None)
    check.add(camera_only, calibration.project(points, size), calibration if is_known else None)
    assert (check.finding() is not None) == is_known


def test_an_image_that_no_return_falls_into(bundled):
    """Quarter-size images: the principal point is outside. Without a scan nothing is known."""
    frames, intrinsics = bundled
    height, width = (side // 4 for side in frames[0][0].shape[:2])
    empty = np.zeros((height, width), np.float32)
    for scale, expected in ((1, True), (0.25, False)):
        check = CalibrationSize()
        matrix = intrinsics * [[scale], [scale], [1]]
        check.add(None, empty, Calibration(matrix, np.eye(4)))
        assert (check.finding() is not None) == expected


def test_a_run_warns_reports_and_degrades(bundled, tmp_path):
    frames, intrinsics = bundled
    for name in ("image", "points"):
        (tmp_path / f"data/{name}").mkdir(parents=True)
    for index, (rgb, points) in enumerate(frames):
        small = cv2.resize(rgb, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        assert cv2.imwrite(str(tmp_path / f"data/image/{index}.png"), small[..., ::-1])
        points.tofile(tmp_path / f"data/points/{index}.bin")
    text = f'intrinsics = {intrinsics.tolist()}\npoints_in = "camera"\n'
    (tmp_path / "data/calib.toml").write_text(text)
    source = f"one-folder:{tmp_path / 'data'},point_columns=3"
    arguments = ["--source", source, "--model", "ssdnet-nano"]
    arguments += ["--out", tmp_path / "out", "--save", "none", "--warmup", 0]
    result = CliRunner().invoke(app, [str(each) for each in arguments])
    frames_of = json.loads((tmp_path / "out/report.json").read_text())["frames"]
    assert "another size" in result.output
    assert "another size" in str(frames_of["implausible_depth"])
    assert frames_of["degraded"] == {"implausible_depth": 3}
    assert frames_of["by_status"] == {"ok": 3}


@pytest.mark.parametrize(("part", "left", "up"), [
    (np.s_[85:, :], 0, 85), (np.s_[60:-60, :], 0, 60), (np.s_[85:, 120:-120], 120, 85),
])  # fmt: skip
def test_images_cut_without_their_calibration_are_found(nano, bundled, part, left, up):
    frames, known = bundled
    check = CalibrationSize()
    calibration = Calibration(known, np.eye(4))
    for rgb, points in frames:
        image = np.ascontiguousarray(rgb[part])
        sparse_depth = calibration.project(points, image.shape[:2])
        camera_only = nano.predict(image, None, focal_length_px=known[0, 0])
        check.add(camera_only, sparse_depth, calibration)
    assert "images before they were cut" in check.finding()
    assert f"better {left} px farther left and {up} px farther up" in check.finding()
