"""YAML and JSON of other tools is answered with the TOML to copy."""

import tomllib

import numpy as np
import pytest

from runtime import InputError
from runtime.io.calibration import Calibration

OPENCV = """%YAML:1.0
---
calibration_time: "Mon 01 Jan 2024 12:00:00"
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 7.0e+02, 0., 320., 0., 7.1e+02,
       240.5, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -0.3, 0.1, 0.001, -0.002, 0. ]
"""
ROS = """image_width: 640
image_height: 480
camera_name: left  # of two
camera_matrix:
  rows: 3
  cols: 3
  data: [700, 0, 320, 0, 710, 240.5, 0, 0, 1]
distortion_model: rational_polynomial
distortion_coefficients:
  rows: 1
  cols: 8
  data: [0.6, -0.02, 0.001, 0.0002, 0.001, 0.95, 0.06, 0.002]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
"""
KALIBR = """cam0:
  T_cam_lidar:
  - [0.0, -1.0, 0.0, 0.1]
  - [0.0, 0.0, -1.0, -0.2]
  - [1.0, 0.0, 0.0, -0.3]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [-0.01, 0.02, -0.003, 0.0004]
  distortion_model: equidistant
  intrinsics: [700, 710, 320, 240.5]
  resolution: [640, 480]
  rostopic: /cam0/image_raw
cam1:
  distortion_coeffs:
  - -0.5
  - 0.5
  - 0.0
  - 0.0
  distortion_model: radtan
  intrinsics: [900, 900, 320, 240]
"""
AUTOWARE = """%YAML:1.0
---
CameraExtrinsicMat: !!opencv-matrix
   rows: 4
   cols: 4
   dt: d
   data: [ 0., 0., 1., 0.3, -1., 0., 0., 0.1, 0., -1., 0., -0.2, 0., 0., 0., 1. ]
CameraMat: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 700., 0., 320., 0., 710., 240.5, 0., 0., 1. ]
DistCoeff: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -0.3, 0.1, 0.001, -0.002, 0. ]
ImageSize: [ 640, 480 ]
"""
JSON = """{"K": [[700, 0, 320], [0, 710, 240.5], [0, 0, 1]], "D": [-0.3, 0.1, 0.001, -0.002, 0],
 "width": 640, "height": 480, "cameras": [{"note": null}],
 "T": [[0, -1, 0, 0.1], [0, 0, -1, -0.2], [1, 0, 0, -0.3], [0, 0, 0, 1]]}"""
NAMED = """%YAML:1.0
model_type: PINHOLE
image_width: 640
image_height: 480
distortion_parameters:
   k1: -0.3
   k2: 0.1
   p1: 0.001
   p2: -0.002
projection_parameters:
   fx: 700
   fy: 710
   cx: 320
   cy: 240.5
"""
EXTRINSICS = [[0, -1, 0, 0.1], [0, 0, -1, -0.2], [1, 0, 0, -0.3], [0, 0, 0, 1]]
BROWN = (-0.3, 0.1, 0.001, -0.002, 0)


@pytest.mark.parametrize(
    ("name", "text", "lens", "coefficients", "note"),
    [
        ("opencv.yml", OPENCV, "plumb_bob", BROWN, "extrinsics = ...  # not found"),
        (
            "ros.yaml",
            ROS,
            "rational_polynomial",
            (0.6, -0.02, 0.001, 0.0002, 0.001, 0.95, 0.06, 0.002),
            "extrinsics = ...  # not found",
        ),
        (
            "camchain.yaml",
            KALIBR,
            "equidistant",
            (-0.01, 0.02, -0.003, 0.0004),
            "cam0/T_cam_lidar: must be from the LiDAR's frame",
        ),
        ("named.yaml", NAMED, "plumb_bob", BROWN, "# k1, k2, p1, p2, k3"),
        ("autoware.yaml", AUTOWARE, "plumb_bob", BROWN, "CameraExtrinsicMat/data, inverted"),
        ("own.json", JSON, "plumb_bob", BROWN, "# T: must be from the LiDAR's frame"),
    ],
)
def test_the_toml_of_other_tools(tmp_path, name, text, lens, coefficients, note):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InputError, match="neither TOML nor a calibration of KITTI") as caught:
        Calibration.from_file(path)
    _, toml = str(caught.value).split(":\n", 1)
    assert note in toml
    copied = tmp_path / "copied.toml"
    copied.write_text(toml.replace("extrinsics = ...", f"extrinsics = {EXTRINSICS}"))
    calibration = Calibration.from_file(copied)
    np.testing.assert_array_equal(
        calibration.intrinsics, [[700, 0, 320], [0, 710, 240.5], [0, 0, 1]]
    )
    np.testing.assert_allclose(calibration.extrinsics, EXTRINSICS, atol=1e-12)
    assert calibration.size == (480, 640)
    assert (calibration.lens, tuple(calibration.distortion)) == (lens, coefficients)


@pytest.mark.parametrize("text", ["", "a: [b\n", "- 1\n- 2\n", "K: [1, 0, 0, 0, 1, 0, 0, 0, 1]"])
def test_a_file_without_a_camera_is_answered_with_what_to_fill_in(tmp_path, text):
    path = tmp_path / "camera.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        Calibration.from_file(path)
    _, toml = str(caught.value).split(":\n", 1)
    assert [line.split(" ")[0] for line in toml.splitlines()] == ["intrinsics", "#", "extrinsics"]
    with pytest.raises(tomllib.TOMLDecodeError):
        tomllib.loads(toml)


def test_damaged_json(tmp_path):
    path = tmp_path / "camera.json"
    for text in ("{", "[" * 100_000):
        path.write_text(text)
        with pytest.raises(InputError, match="is not valid JSON"):
            Calibration.from_file(path)
