"""Each example runs and prints what it should."""

import re
import runpy
import shutil
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from runtime import Calibration
from runtime.recordings.bundled_stream import bundled_stream

EXAMPLES = Path(__file__).parents[2] / "examples"
TESTED = {
    *("bare_onnxruntime.py", "callbacks.py", "convert_calibration.py", "driving_loop.py"),
    *("multi_camera.py", "odometry.py"),
    *("ray_data.py", "rerun_viewer.py", "ros2_node.py"),  # by tests of their own
}


@pytest.fixture
def run(monkeypatch, capsys):
    """Run an example as a program, and return the lines that it prints."""

    def invoke(name, *arguments):
        monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return capsys.readouterr().out.splitlines()

    return invoke


def test_no_example_is_left_out():
    assert {path.name for path in EXAMPLES.glob("*.py")} == TESTED


def test_the_driving_loop(run, tmp_path):
    """Half a second of the loop is run."""
    for folder in bundled_stream():
        (tmp_path / folder.name).mkdir()
        for path in sorted(folder.iterdir())[:5]:
            shutil.copy(path, tmp_path / folder.name)
    lines = run("driving_loop.py", "--rgb", tmp_path / "rgb", "--depth", tmp_path / "depth")
    assert 1 <= len(lines) <= 5
    for line in lines:
        assert re.match(r"frame \d: nearest road user ahead +(none|[0-9.]+ m.*), age +", line), line


def test_several_cameras(run):
    lines = run("multi_camera.py", "--cameras", 3, "--moments", 2)
    assert len(lines) == 8
    expected = [
        (moment, camera, size)
        for moment in (0, 1)
        for camera, size in enumerate(["256 x 832", "256 x 832", "192 x 624"])
    ]
    cameras = [line for line in lines if not line.startswith("  all of them in ")]
    for line, (moment, camera, size) in zip(cameras, expected, strict=True):
        pattern = rf"moment {moment}, camera {camera}, {size}: +[0-9.]+ m ahead at the median"
        assert re.fullmatch(pattern, line), line


def test_callbacks(run):
    """Every message is pushed in its thread and accounted for, whatever the machine's speed."""
    *answers, image, depth = run("callbacks.py", "--frames", 4, "--period-s", 0.04)
    counted = r"(image|depth): 4 pushed, (\d) answered, (\d) not"
    for line in (image, depth):
        answered, others = map(int, re.fullmatch(counted, line).groups()[1:])
        assert answered + others == 4
    assert len(answers) == int(re.fullmatch(counted, image)[2]) >= 1
    assert all(re.match(r"0\.\d\d s: \d+ ms, (skew 10 ms|no depth)", line) for line in answers)


def test_an_odometry_beside_the_stream(run, tmp_path):
    """Past walls at 10 m/s: all answers have depth, and every second one that of a scan before."""
    pytest.importorskip("kiss_icp", reason="kiss-icp is no dependency")
    images, scans = tmp_path / "images", tmp_path / "scans"
    images.mkdir()
    scans.mkdir()
    walls = np.random.default_rng(0).uniform([-60, -9, -1.7], [60, -7, 4], (20_000, 3))
    walls[::2, 1] += 16 + 3 * np.sin(walls[::2, 0])
    walls[1::3, 0] = np.round(walls[1::3, 0] / 15) * 15  # houses' ends
    for number in range(8):
        name = f"{number:03d}"
        rgb = np.random.default_rng(number).integers(0, 255, (64, 96, 3), np.uint8)
        assert cv2.imwrite(str(images / f"{name}.png"), rgb)
        points = (walls - (number, 0, 0)).astype("<f4")
        np.column_stack([points, points[:, :1]]).astype("<f4").tofile(scans / f"{name}.bin")
    calibration = tmp_path / "calibration.toml"
    calibration.write_text(
        "intrinsics = [[60.0, 0, 48], [0, 60.0, 32], [0, 0, 1]]\n"
        "extrinsics = [[0.0, -1, 0, 0], [0, 0, -1, 0], [1.0, 0, 0, 0], [0, 0, 0, 1]]\n"
    )
    *lines, last = run(
        "odometry.py", "--images", images, "--scans", scans, "--calibration", calibration
    )
    assert last == "8 answers, 4 with the scan before"
    for number, line in enumerate(lines):
        age = 100 * (number % 2)
        assert line.startswith(f"{number / 10} s: depth {age} ms old, moved: "), line
        if 2 <= number < 7:  # the first scan has no motion yet
            assert "moved: scan" in line
            assert "uncompensated" not in line


DISTORTION = "[-0.3, 0.1, 0.001, -0.002, 0.0]"
OTHER_TOOLS = {
    "left.yaml": "image_width: 640\nimage_height: 240\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
    "  data: [700, 0, 320, 0, 710, 120, 0, 0, 1]\ndistortion_model: plumb_bob\n"
    f"distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: {DISTORTION}\n",
    "camera.yml": "%YAML:1.0\n---\nimage_width: 640\nimage_height: 240\n"
    "camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
    "   data: [ 7.0e+02, 0., 320., 0., 7.1e+02, 120., 0., 0., 1. ]\n"
    "distortion_coefficients: !!opencv-matrix\n   rows: 5\n   cols: 1\n   dt: d\n"
    f"   data: {DISTORTION}\n",
    "camchain.yaml": "cam0:\n  camera_model: pinhole\n"
    "  distortion_coeffs: [-0.3, 0.1, 0.001, -0.002]\n  distortion_model: radtan\n"
    "  intrinsics: [700, 710, 320, 120]\n  resolution: [640, 240]\n",
}


@pytest.mark.parametrize("name", [*OTHER_TOOLS, "of_opencv_5.yml", "camera.xml", "camera.json"])
def test_calibrations_of_other_tools(run, tmp_path, name):
    pytest.importorskip("yaml", reason="PyYAML, which the example imports, is not installed")
    if name in OTHER_TOOLS:
        (tmp_path / name).write_text(OTHER_TOOLS[name])
    else:
        write_storage(tmp_path / name)
    lines = run("convert_calibration.py", tmp_path / name)
    (tmp_path / "car.toml").write_text("\n".join((*lines, "points_in = 'camera'")))
    calibration = Calibration.from_file(tmp_path / "car.toml")
    assert calibration.intrinsics.tolist() == [[700, 0, 320], [0, 710, 120], [0, 0, 1]]
    assert calibration.size == (240, 640)
    assert calibration.lens == "plumb_bob"
    assert tuple(calibration.distortion[:4]) == (-0.3, 0.1, 0.001, -0.002)


def write_storage(path, coefficients=(-0.3, 0.1, 0.001, -0.002, 0), **more):
    """Write what OpenCV's calibration sample writes, with the installed OpenCV."""
    k = np.array([[700.0, 0, 320], [0, 710, 120], [0, 0, 1]])
    values = {"image_width": 640, "image_height": 240, "camera_matrix": k, **more}
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in (values | {"distortion_coefficients": np.array([coefficients]).T}).items():
        storage.write(key, value)
    storage.release()


def test_the_lens_of_opencv(run, tmp_path):
    """The fisheye option of OpenCV's sample and the number of coefficients name the lens."""
    pytest.importorskip("yaml", reason="PyYAML, which the example imports, is not installed")
    write_storage(tmp_path / "a.yml", (0.1, 0.2, 0.3, 0.4), fisheye_model=1)
    assert "lens = 'equidistant'" in run("convert_calibration.py", tmp_path / "a.yml")
    write_storage(tmp_path / "b.yml", (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, *[0] * 6))
    assert "lens = 'rational_polynomial'" in run("convert_calibration.py", tmp_path / "b.yml")


@pytest.mark.parametrize(
    ("known", "unknown"),
    [("pinhole", "omni"), ("radtan", "fov"), ("distortion_coeffs", "coefficients")],
)
def test_an_unknown_calibration_is_refused(run, tmp_path, capsys, known, unknown):
    pytest.importorskip("yaml", reason="PyYAML, which the example imports, is not installed")
    path = tmp_path / "camchain.yaml"
    path.write_text(OTHER_TOOLS[path.name].replace(known, unknown))
    with pytest.raises(SystemExit):
        run("convert_calibration.py", path)
    assert re.search(f"error: cannot convert .*({known}|{unknown})", capsys.readouterr().err)
