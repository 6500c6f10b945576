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
        ("opencv.yml", OPENCV, "plumb_bob", BROWN, "# extrinsics = ... not found"),
        (
            "ros.yaml",
            ROS,
            "rational_polynomial",
            (0.6, -0.02, 0.001, 0.0002, 0.001, 0.95, 0.06, 0.002),
            "# extrinsics = ... not found",
        ),
        (
            "camchain.yaml",
            KALIBR,
            "equidistant",
            (-0.01, 0.02, -0.003, 0.0004),
            "from the LiDAR's frame to the camera's, else invert it:\nextrinsics = [[0.0, -1.0",
        ),
        ("named.yaml", NAMED, "plumb_bob", BROWN, "# k1, k2, p1, p2, k3"),
        ("autoware.yaml", AUTOWARE, "plumb_bob", BROWN, "CameraExtrinsicMat/data, inverted"),
        ("own.json", JSON, "plumb_bob", BROWN, "# check that it leads from the LiDAR's frame"),
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
    copied.write_text(toml.replace("# extrinsics = ...", f"extrinsics = {EXTRINSICS} #"))
    calibration = Calibration.from_file(copied)
    np.testing.assert_array_equal(
        calibration.intrinsics, [[700, 0, 320], [0, 710, 240.5], [0, 0, 1]]
    )
    np.testing.assert_allclose(calibration.extrinsics, EXTRINSICS, atol=1e-12)
    assert calibration.size == (480, 640)
    assert (calibration.lens, tuple(calibration.distortion)) == (lens, coefficients)


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
INI = """[LEFT]
width=640
height=480
fx=700
fy=710
cx=320
cy=240.5
k1=-0.3
k2=0.1
p1=0.001
p2=-0.002
[RIGHT]
fx=900
fy=900
cx=1
cy=1
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
    ("text", "lens", "coefficients"),
    [
        ("# fx fy cx cy\n700 710 320 240.5\n", None, None),
        ("700, 710, 320, 240.5", None, None),
        ("fx=700, fy=710, cx=320, cy=240.5", None, None),
        ("K = [[700, 0, 320],\n     [0, 710, 240.5],\n     [0, 0, 1]]\n", None, None),
        (ROWS, None, None),
        (DUMP, "plumb_bob", BROWN),
        (INI, "plumb_bob", BROWN),
        (COLMAP.format("PINHOLE 640 480 700 710 320.5 241"), None, None),
        (
            COLMAP.format("OPENCV 640 480 700 710 320.5 241 -0.3 0.1 0.001 -0.002"),
            "plumb_bob",
            BROWN[:4],
        ),
        (
            COLMAP.format("OPENCV_FISHEYE 640 480 700 710 320.5 241 0.1 0 0 0"),
            "equidistant",
            (0.1, 0, 0, 0),
        ),
    ],
)
def test_the_toml_of_a_text(tmp_path, text, lens, coefficients):
    path = tmp_path / "cameras.txt"
    path.write_text(text)
    with pytest.raises(InputError, match="neither TOML nor a calibration of KITTI") as caught:
        Calibration.from_file(path)
    _, toml = str(caught.value).split(":\n", 1)
    copied = tmp_path / "copied.toml"
    copied.write_text(toml.replace("# extrinsics = ...", f"extrinsics = {EXTRINSICS} #"))
    calibration = Calibration.from_file(copied)
    np.testing.assert_array_equal(
        calibration.intrinsics, [[700, 0, 320], [0, 710, 240.5], [0, 0, 1]]
    )
    np.testing.assert_array_equal(calibration.extrinsics, EXTRINSICS)
    assert calibration.size in (None, (480, 640))
    found = calibration.distortion and tuple(calibration.distortion)
    assert (calibration.lens, found) == (lens, coefficients)


def test_a_camera_of_colmap_with_one_focal_length(tmp_path):
    path = tmp_path / "cameras.txt"
    path.write_text(COLMAP.format("SIMPLE_RADIAL 640 480 700 320.5 241 -0.3"))
    with pytest.raises(InputError) as caught:
        Calibration.from_file(path)
    assert "intrinsics = [[700.0, 0.0, 320.0], [0.0, 700.0, 240.5], [0.0" in str(caught.value)
    assert "distortion = [-0.3, 0.0, 0.0, 0.0]" in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "a: [b\n",
        "- 1\n- 2\n",
        "K: [1, 0, 0, 0, 1, 0, 0, 0, 1]",
        "1 2 3",
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


def test_damaged_json(tmp_path):
    path = tmp_path / "camera.json"
    for text in ("{", "[" * 100_000):
        path.write_text(text)
        with pytest.raises(InputError, match="is not valid JSON"):
            Calibration.from_file(path)


@pytest.mark.parametrize(
    ("name", "proposed"),
    [
        ("T_cam_lidar", EXTRINSICS),
        ("T_lidar_cam", np.linalg.inv(EXTRINSICS).tolist()),
        ("T_cam_imu", None),
        ("T_cn_cnm1", None),
    ],
)
def test_transforms_of_other_sensors_are_not_proposed(tmp_path, name, proposed):
    """A file without the LiDAR's leaves the extrinsics to be filled in, and says so."""
    path = tmp_path / "camchain.yaml"
    path.write_text(KALIBR.replace("T_cam_lidar", name))
    with pytest.raises(InputError) as caught:
        Calibration.from_file(path)
    _, toml = str(caught.value).split(":\n", 1)
    copied = tmp_path / "copied.toml"
    copied.write_text(toml)
    if proposed is None:
        assert "# extrinsics = ... not found" in toml
        with pytest.raises(InputError, match="expected intrinsics, extrinsics"):
            Calibration.from_file(copied)
    else:
        found = Calibration.from_file(copied).extrinsics
        np.testing.assert_allclose(found, proposed, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (("distortion_coefficients", "D1"), "distortion = [-0.3, 0.1, 0.001, -0.002, 0.0]  # D1"),
        (("-0.002, 0.", "-0.002, 0., 1, 2, 3, 4, 5, 6, 7, 8, 9"), "14 numbers, of no lens here"),
        (("distortion_coefficients", "other"), "give lens and distortion unless the images are"),
    ],
)
def test_distortion_that_a_file_holds_is_not_denied(tmp_path, change, text):
    path = tmp_path / "opencv.yml"
    path.write_text(OPENCV.replace(*change))
    with pytest.raises(InputError) as caught:
        Calibration.from_file(path)
    assert text in str(caught.value)
