"""What a file of another tool says of a camera, as the TOML of `Calibration`.

Such files are shown, not used: key names differ between tools, and the frames and direction of a
4 x 4 matrix are mostly not stated. Formats with tests: OpenCV's FileStorage, ROS's camera_info,
Kalibr's camchain, Autoware's calibration, COLMAP's cameras.txt and rows of numbers.
"""

import json
import re
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.checks import cut
from runtime.errors import InputError
from runtime.lens import ALIASES, EQUIDISTANT, PLUMB_BOB, RATIONAL_POLYNOMIAL
from runtime.read_input import read_text

_EXAMPLE = """\
intrinsics = [[721.5, 0.0, 609.6], [0.0, 721.5, 172.9], [0.0, 0.0, 1.0]]  # pixels
# From the LiDAR's frame to the camera's, metres; points_in = "camera" where they are the same.
extrinsics = [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, -0.08], [1.0, 0.0, 0.0, -0.27], [0, 0, 0, 1]]
size = [375, 1242]  # height, width of the images"""
_MOST_LINES = 2000  # a longer text holds a calibration at its beginning, or none
_LEAST_FOCAL_PX = 10.0  # a 3 x 3 matrix with a smaller focal length is a rotation
_SIZES = ("resolution", "imagesize", "image_size", "size")  # width, height
#: COLMAP's cameras with lenses of this project; "SIMPLE_" and "RADIAL" have one focal length.
_COLMAP = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE",
           "FULL_OPENCV")  # fmt: skip
_PAIR = re.compile(
    r"\b(fx|fy|cx|cy|k[1-3]|p[12]|width|height)[ \t]*[:= \t][ \t]*([-+.\d][-+.\de]*)", re.IGNORECASE
)
#: Names of a 4 x 4 from the camera's frame to the LiDAR's: Autoware's, and as Kalibr names frames.
_FROM_CAMERA = re.compile(r"cameraextrinsicmat|t_(lidar|velo\w*|laser)_cam\w*")
#: Names of a 4 x 4 of other frames: an IMU's, another camera's, the vehicle's.
_OTHER_FRAMES = re.compile(r"imu|t_cn_cnm1|cam\w*_cam|body|base|world|rect|project")
_CHECK = "check that it leads from the LiDAR's frame to the camera's, else invert it"


class _Entry:
    """A value of the file: its path, its name in lower case, its text and its numbers."""

    def __init__(self, path: str, text: str) -> None:
        self.path, self.text = path, text.strip().strip("\"'")
        names = [name for name in path.lower().split("/") if name != "data"]
        self.name = names[-1] if names else ""
        words = [word for word in _spaced(text).split() if word != "-"]
        try:
            self.numbers = np.array(words, dtype=np.float64)
        except ValueError:
            self.numbers = np.empty(0)


def refuse(path: Path) -> InputError:
    """Return the error about a file of another tool, with the TOML for its first camera.

    What the file lacks is to be filled in; for one without a camera matrix the error has an
    example. Raises InputError if the file cannot be read.
    """
    entries = _read(path)
    fault, intrinsics = f"{path} is neither TOML nor a calibration of KITTI", _intrinsics(entries)
    if intrinsics is None:
        return InputError(
            f"{fault}, and no camera matrix was found in it. Expected a .toml file as this one of "
            f"another camera:\n{_EXAMPLE}"
        )
    rows = [intrinsics, *_lens(entries), *_size(entries), _extrinsics(entries)]
    toml = "\n".join(rows)
    return InputError(f"{fault}. Check what it holds and save it as a .toml file:\n{toml}")


def _read(path: Path) -> list[_Entry]:
    text = read_text(path)
    if path.suffix.lower() == ".json":
        try:
            return list(_of_json(json.loads(text), ""))
        except (ValueError, RecursionError) as error:
            raise InputError(f"{path} is not valid JSON: {cut(str(error), 200)}") from error
    lines = text.splitlines()[:_MOST_LINES]
    return list(_of_text("\n".join(line.partition("#")[0] for line in lines)))


def _intrinsics(entries: list[_Entry]) -> str | None:
    for entry in entries:
        if entry.numbers.size == 9:
            matrix = entry.numbers.reshape(3, 3)
            is_camera = (matrix[[0, 1], [0, 1]] > _LEAST_FOCAL_PX).all()
            if is_camera and np.array_equal(matrix[2], (0, 0, 1)):
                return _row("intrinsics", matrix, entry.path)
        is_named = entry.name == "intrinsics" or entry.name.startswith("line ")
        if is_named and entry.numbers.size == 4 and (entry.numbers[:2] > _LEAST_FOCAL_PX).all():
            return _row("intrinsics", _pinhole(*entry.numbers), f"{entry.path}: fx, fy, cx, cy")
    single = [_number(entries, name) for name in ("fx", "fy", "cx", "cy")]
    if None not in single:
        return _row("intrinsics", _pinhole(*single), "fx, fy, cx, cy")
    return None


def _lens(entries: list[_Entry]) -> list[str]:
    for entry in entries:
        is_named = "dist" in entry.name or re.fullmatch(r"d\d?|coeffs", entry.name)
        if is_named and entry.numbers.size in (4, 5, 8):
            model = RATIONAL_POLYNOMIAL if entry.numbers.size == 8 else PLUMB_BOB
            stated = [each.text.lower() for each in entries if each.name == "distortion_model"]
            lens = f'lens = "{model}"  # assumed: a fisheye is "{EQUIDISTANT}"'
            if stated:
                lens = f'lens = "{ALIASES.get(stated[0], stated[0])}"'
            return [lens, _row("distortion", entry.numbers, entry.path)]
        if is_named and entry.numbers.size > 1:
            count = entry.numbers.size
            return [f"# {entry.path} holds {count} numbers, of no lens here: rectify the images"]
    named = [_number(entries, name) for name in ("k1", "k2", "p1", "p2", "k3")]
    if None not in named[:4]:
        numbers = np.array([number or 0.0 for number in named])
        return [f'lens = "{PLUMB_BOB}"', _row("distortion", numbers, "k1, k2, p1, p2, k3")]
    return ["# no distortion was found: give lens and distortion unless the images are rectified"]


def _size(entries: list[_Entry]) -> list[str]:
    for prefix in ("image_", ""):
        height, width = (_number(entries, prefix + side) for side in ("height", "width"))
        if height and width:
            return [f"size = [{height:.0f}, {width:.0f}]"]
    for entry in entries:
        if entry.name in _SIZES and entry.numbers.size == 2:
            return [f"size = [{entry.numbers[1]:.0f}, {entry.numbers[0]:.0f}]  # {entry.path}"]
    return []


def _extrinsics(entries: list[_Entry]) -> str:
    matrices = [entry for entry in entries if entry.numbers.size == 16]
    named = [entry for entry in matrices if not entry.name.startswith("from line ")]
    for entry in named or matrices:
        matrix = entry.numbers.reshape(4, 4)
        if not np.array_equal(matrix[3], (0, 0, 0, 1)):
            continue
        if _FROM_CAMERA.fullmatch(entry.name) and np.linalg.det(matrix):
            return _row("extrinsics", np.linalg.inv(matrix), f"{entry.path}, inverted")
        if not _OTHER_FRAMES.search(entry.name):
            return f"# {_CHECK}:\n{_row('extrinsics', matrix, entry.path)}"
    return "# extrinsics = ... not found: 4 x 4, from the LiDAR's frame to the camera's"


def _number(entries: list[_Entry], name: str) -> float | None:
    found = (each.numbers[0] for each in entries if each.name == name and each.numbers.size == 1)
    return next(found, None)


def _pinhole(fx: Any, fy: Any, cx: Any, cy: Any) -> NDArray[np.float64]:
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)


def _row(key: str, numbers: NDArray[np.floating[Any]], source: str) -> str:
    return f"{key} = {(numbers + 0.0).tolist()}  # {cut(source)}"


def _of_json(value: Any, path: str) -> Iterator[_Entry]:
    """The values of a JSON document; a list without objects is one value."""
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _of_json(inner, f"{path}/{name}" if path else name)
    elif isinstance(value, list) and any(isinstance(each, dict) for each in value):
        for number, inner in enumerate(value):
            yield from _of_json(inner, f"{path}/{number}")
    else:
        yield _Entry(path, value if isinstance(value, str) else json.dumps(value))


def _of_text(text: str) -> Iterator[_Entry]:
    """The values of a text: pairs on one line, YAML, names with "=", COLMAP's, rows of numbers."""
    yield from (_Entry(name, number) for name, number in _PAIR.findall(text))
    named = _lines_of_yaml(text.replace("=", ":"))
    yield from (_Entry(path, value) for path, value in named.items())
    rows = [_Entry(f"line {number}", row) for number, row in enumerate(text.splitlines(), start=1)]
    words = (row.text.split() for row in rows)
    colmap = next((row for row in words if len(row) > 1 and row[1] in _COLMAP), None)
    if colmap is not None:
        yield from _of_colmap(*colmap[1:])
    for _, run in groupby(rows, lambda row: row.numbers.size):
        block = list(run)
        yield _Entry(f"from {block[0].path}", " ".join(row.text for row in block))
        yield from block


def _of_colmap(model: str, *values: str) -> Iterator[_Entry]:
    """The values of a camera of COLMAP, whose pixel centres are at 0.5."""
    try:
        width, height, *numbers = map(float, values)
        if model.startswith(("SIMPLE_", "RADIAL")):
            numbers.insert(0, numbers[0])
        fx, fy, cx, cy, *lens = numbers
    except (IndexError, ValueError):  # another tool's line
        return
    path = f"COLMAP's {model}, moved by half a pixel"
    yield _Entry(f"{path}/intrinsics", f"{fx} {fy} {cx - 0.5} {cy - 0.5}")
    yield from (_Entry("width", str(width)), _Entry("height", str(height)))
    if lens:
        padded = lens + [0.0] * (4 - len(lens))
        yield _Entry(f"COLMAP's {model}/dist", " ".join(map(str, padded)))
    if model == "OPENCV_FISHEYE":
        yield _Entry("distortion_model", EQUIDISTANT)


def _lines_of_yaml(text: str) -> dict[str, str]:
    """Path -> text of the values of a YAML document in block style, lists in any style."""
    entries: dict[str, str] = {}
    above: list[tuple[int, str]] = []  # indentation and name
    for line in text.splitlines():
        if not line.strip() or line.startswith(("%", "---", "...")):
            continue
        name, colon, value = line.partition(":")
        if colon and not set(name) & set("[]{},"):
            indentation = len(name) - len(name.lstrip())
            above = [each for each in above if each[0] < indentation]
            above.append((indentation, name.strip("- \"'\t")))
            entries["/".join(name for _, name in above)] = value
        elif above:
            entries["/".join(name for _, name in above)] += f" {line}"
    return entries


def _spaced(text: str) -> str:
    return text.translate({ord(mark): " " for mark in "[],;"})
