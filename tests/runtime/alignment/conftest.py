"""Frames of the bundled stream with their returns as a scan."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from painted_street import EXTRINSICS, turned_extrinsics
from runtime import Predictor
from runtime.geometry.calibration import Calibration
from runtime.recordings.bundled_stream import BUNDLED_FOCAL_LENGTH_PX, bundled_frames
from runtime.streams.frame import Frame
from runtime.streams.messages import Image, Scan


@pytest.fixture(scope="package")
def predictor():
    with Predictor("ssdnet-lite", threads=1) as predictor:
        yield predictor


@pytest.fixture(scope="package")
def frames():
    """Eight frames with a scan in the frame of a LiDAR and its right calibration."""
    focal, found = BUNDLED_FOCAL_LENGTH_PX, []
    for frame in bundled_frames()[:16:2]:
        height, width = frame.size
        intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
        row, column = np.nonzero(frame.sparse_depth)
        rays = np.stack([column, row, np.ones(len(row))]).T @ np.linalg.inv(intrinsics).T
        in_camera = rays * frame.sparse_depth[row, column, None] - EXTRINSICS[:3, 3]
        points = np.ascontiguousarray(in_camera @ EXTRINSICS[:3, :3], np.float32)
        message = Scan.of(points)
        calibration = Calibration(intrinsics, EXTRINSICS, frame.size)
        found.append(Frame(Image(frame.rgb), message, calibration=calibration))
    return found


@pytest.fixture
def turned():
    """Turn the LiDAR of a frame by yaw, pitch and roll [degrees]: its calibration is wrong so."""

    def turn(frame, angles):
        extrinsics = turned_extrinsics(angles, frame.calibration.extrinsics)
        return replace(frame, calibration=replace(frame.calibration, extrinsics=extrinsics))

    return turn


@pytest.fixture
def recording(tmp_path, frames):
    """Write frames as images/, scans/ and a calibration; gives the options of the commands."""

    def write(frames):
        calibration = frames[0].calibration
        for folder in ("images", "scans"):
            (tmp_path / folder).mkdir()
        for index, frame in enumerate(frames):
            cv2.imwrite(str(tmp_path / f"images/{index}.png"), frame.rgb[..., ::-1])
            np.save(tmp_path / f"scans/{index}.npy", frame.depth.points)
        (tmp_path / "car.toml").write_text(
            f"intrinsics = {calibration.intrinsics.tolist()}\n"
            f"extrinsics = {calibration.extrinsics.tolist()}\n"
        )
        points, car = tmp_path / "scans", tmp_path / "car.toml"
        given = [tmp_path / "images", "--points", points, "--calibration", car, "--threads", 1]
        return [str(each) for each in given]

    return write
