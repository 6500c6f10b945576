"""Prints a camera's calibration of another tool as `car.toml` has it, without `extrinsics`.

    pip install pyyaml
    python examples/convert_calibration.py left.yaml >car.toml

FILE is ROS's `camera_info` of raw images in YAML, what the calibration sample of OpenCV writes
(FileStorage in YAML, XML or JSON, of a pinhole or a fisheye), or Kalibr's camchain, of which the
first camera is taken. What it does not know (another model of camera or lens) is refused.
"""

import argparse
from pathlib import Path
from typing import Any

import cv2
import yaml

from runtime import InputError, Lens


def main() -> None:
    """Print the TOML."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path)
    path = parser.parse_args().file
    try:
        intrinsics, size, lens = read(path)
    except (InputError, KeyError, TypeError, ValueError, cv2.error, yaml.YAMLError) as error:
        lacks = "it lacks " if isinstance(error, KeyError) else ""
        parser.exit(1, f"error: cannot convert {path}: {lacks}{error}\n")
    print(f"intrinsics = {intrinsics!r}\nsize = {size!r}")
    if lens is not None:
        print(f"lens = {lens.model!r}\ndistortion = {list(lens.coefficients)!r}")


def read(path: Path) -> tuple[list[list[float]], list[int], Lens | None]:
    """Return the intrinsics, (height, width) and lens of a file of another tool."""
    text = path.read_text()
    if "opencv-matrix" in text:
        return from_opencv(path)
    content = yaml.safe_load(text)
    if not isinstance(content, dict):
        raise InputError("it is no calibration of ROS, OpenCV or Kalibr")
    return from_kalibr(content["cam0"]) if "cam0" in content else from_ros(content)


def from_ros(info: dict[str, Any]) -> tuple[list[list[float]], list[int], Lens | None]:
    """Read a `camera_info`."""
    k, d = info["camera_matrix"]["data"], info["distortion_coefficients"]["data"]
    lens = Lens.of_ros(info["distortion_model"], d)
    return [k[:3], k[3:6], k[6:]], [info["image_height"], info["image_width"]], lens


def from_opencv(path: Path) -> tuple[list[list[float]], list[int], Lens | None]:
    """Read a FileStorage. OpenCV states a fisheye, and the other lenses by their coefficients."""
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    keys = ("camera_matrix", "distortion_coefficients", "image_height", "image_width")
    for key in keys:
        if file.getNode(key).empty():
            raise KeyError(f"{key}: it has {', '.join(file.root().keys())}")
    matrix, coefficients = (file.getNode(key).mat() for key in keys[:2])
    d = coefficients.ravel().tolist()
    is_fisheye = not file.getNode("fisheye_model").empty() and file.getNode("fisheye_model").real()
    model = "equidistant" if is_fisheye else "rational_polynomial" if any(d[5:]) else "plumb_bob"
    size = [int(file.getNode(key).real()) for key in keys[2:]]
    return matrix.tolist(), size, Lens.of_ros(model, d)


def from_kalibr(camera: dict[str, Any]) -> tuple[list[list[float]], list[int], Lens | None]:
    """Read a camera of a camchain."""
    if camera["camera_model"] != "pinhole":
        raise InputError(f"its camera model is {camera['camera_model']!r}, expected 'pinhole'")
    (fx, fy, cx, cy), (width, height) = camera["intrinsics"], camera["resolution"]
    lens = Lens.of_ros(camera["distortion_model"], camera["distortion_coeffs"])
    return [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], [height, width], lens


if __name__ == "__main__":
    main()
