"""Prints a camera's calibration of another tool as `car.toml` has it, without `extrinsics`.

    pip install pyyaml
    python examples/convert_calibration.py left.yaml >car.toml

FILE is ROS's `camera_info` of raw images in YAML, what the calibration sample of OpenCV writes
(FileStorage), or Kalibr's camchain, of which the first camera, a pinhole, is taken.
"""

import argparse
from pathlib import Path
from typing import Any

import cv2
import yaml


def main() -> None:
    """Print the TOML."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path)
    path = parser.parse_args().file
    for key, value in read(path).items():
        print(f"{key} = {value!r}")


def read(path: Path) -> dict[str, Any]:
    """Return the keys of `car.toml` that a file of another tool states."""
    text = path.read_text()
    if text.startswith("%YAML:1.0"):
        return from_opencv(path)
    content = yaml.safe_load(text)
    return from_kalibr(content["cam0"]) if "cam0" in content else from_ros(content)


def from_ros(info: dict[str, Any]) -> dict[str, Any]:
    """Read a `camera_info`; its distortion models have the names of ours."""
    k = info["camera_matrix"]["data"]
    return {
        "intrinsics": [k[:3], k[3:6], k[6:]],
        "size": [info["image_height"], info["image_width"]],
        "lens": info["distortion_model"],
        "distortion": info["distortion_coefficients"]["data"],
    }


def from_opencv(path: Path) -> dict[str, Any]:
    """Read a FileStorage."""
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    return {
        "intrinsics": file.getNode("camera_matrix").mat().tolist(),
        "size": [int(file.getNode(f"image_{side}").real()) for side in ("height", "width")],
        "lens": "plumb_bob",
        "distortion": file.getNode("distortion_coefficients").mat().ravel().tolist(),
    }


def from_kalibr(camera: dict[str, Any]) -> dict[str, Any]:
    """Read a camera of a camchain; its other model than "radtan" is "equidistant"."""
    (fx, fy, cx, cy), (width, height) = camera["intrinsics"], camera["resolution"]
    return {
        "intrinsics": [[fx, 0, cx], [0, fy, cy], [0, 0, 1]],
        "size": [height, width],
        "lens": {"radtan": "plumb_bob"}.get(camera["distortion_model"], "equidistant"),
        "distortion": camera["distortion_coeffs"],
    }


if __name__ == "__main__":
    main()
