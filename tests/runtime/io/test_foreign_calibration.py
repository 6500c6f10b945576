"""A file of another tool is answered with the TOML to copy."""

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
EXTRINSICS = [[0, -1, 0, 0.1], [0, 0, -1, -0.2], [1, 0, 0, -0.3], [0, 0, 0, 1]]
BROWN = (-0.3, 0.1, 0.001, -0.002, 0)
RATIONAL = (0.6, -0.02, 0.001, 0.0002, 0.001, 0.95, 0.06, 0.002)
FISHEYE = (-0.01, 0.02, -0.003, 0.0004)
OF_OPENCV = "OPENCV 640 480 700 710 320.5 241 -0.3 0.1 0.001 -0.002"
OF_FISHEYE = "OPENCV_FISHEYE 640 480 700 710 320.5 241 -0.01 0.02 -0.003 0.0004"


COLMAP = (
    "# Camera list\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n1 {}\n2 PINHOLE 9 9 90 90 4 4\n"
)
DUMP = """header:
  frame_id: "camera"
height: 480
width: 640
distortion_model: "plumb_bob"
D: [-0.3, 0.1, 0.001, -0.002, 0.0]
K: [700.0, 0.0, 320.0, 0.0, 710.0, 240.5, 0.0, 0.0, 1.0]
R: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
P: [700.0, 0.0, 320.0, 0.0, 0.0, 710.0, 240.5, 0.0, 0.0, 0.0, 1.0, 0.0]
"""
ROWS = """intrinsic
700 0 320
0 710 240.5
0 0 1

extrinsic
0 -1 0 0.1
0 0 -1 -0.2
1 0 0 -0.3
0 0 0 1
"""


@pytest.mark.parametrize(
    ("name", "text", "lens", "coefficients", "note"),
    [
        ("opencv.yml", OPENCV, "plumb_bob", BROWN, "extrinsics = ...  # not found"),
        ("ros.yaml", ROS, "rational_polynomial", RATIONAL, "extrinsics = ...  # not found"),
        ("dump.txt", DUMP, "plumb_bob", BROWN, ""),
        ("camchain.yaml", KALIBR, "equidistant", FISHEYE, "cam0/T_cam_lidar: must be from the"),
        ("autoware.yaml", AUTOWARE, "plumb_bob", BROWN, "CameraExtrinsicMat/data, inverted"),
        ("rows.txt", ROWS, None, None, "must be from the LiDAR's frame"),
        ("one row.txt", "# fx fy cx cy\n700, 710 320 240.5\n", None, None, ""),
        ("k.txt", "K = [[700, 0, 320],\n  [0, 710, 240.5],\n  [0, 0, 1]]\n", None, None, ""),
        ("a.txt", COLMAP.format("PINHOLE 640 480 700 710 320.5 241"), None, None, "half a pixel"),
        ("cameras.txt", COLMAP.format(OF_OPENCV), "plumb_bob", BROWN[:4], ""),
        ("cameras.txt", COLMAP.format(OF_FISHEYE), "equidistant", FISHEYE, ""),
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
    assert calibration.size in (None, (480, 640))
    found = calibration.distortion and tuple(calibration.distortion)
    assert (calibration.lens, found) == (lens, coefficients)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "a: [b\n",
        "K: [1, 0, 0, 0, 1, 0, 0, 0, 1]",
        "1 PINHOLE 640 480 700 710\n",
        "1 0 0 0 0 1 0 0 0 0 1 0\n" * 50,
        "2011-09-26 13:02:25.9\n",
    ],
)
@pytest.mark.parametrize("name", ["camera.yaml", "camera.txt"])
def test_a_file_without_a_camera_is_answered_with_an_example(tmp_path, name, text):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InputError, match="no camera matrix was found in it") as caught:
        Calibration.from_file(path)
    _, toml = str(caught.value).split(":\n", 1)
    copied = tmp_path / "copied.toml"
    copied.write_text(toml)
    assert Calibration.from_file(copied).size == (375, 1242)
