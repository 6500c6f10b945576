"""Encoding of heads, pictures and point clouds as PNG, JPEG and PLY files.

Encoding shares the processor with inference, so the settings are the cheapest ones. PLY: Greg Turk,
"The PLY Polygon File Format", 1994; binary, little-endian.
"""

from collections.abc import Callable, Sequence
from itertools import chain
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.contract.contract import ClassInfo
from runtime.contract.heads import Unit
from runtime.geometry.point_cloud import PointCloud

METRES_PNG_SCALE = 256  # units of a 16-bit PNG per metre, as in KITTI
METRES_PNG_MAX_M = 65535 / METRES_PNG_SCALE
_PNG_STORED = {cv2.IMWRITE_PNG_COMPRESSION: 0, cv2.IMWRITE_PNG_FILTER: cv2.IMWRITE_PNG_FILTER_NONE}
_PNG_RUNS = _PNG_STORED | {
    cv2.IMWRITE_PNG_COMPRESSION: 1,
    cv2.IMWRITE_PNG_STRATEGY: cv2.IMWRITE_PNG_STRATEGY_RLE,
}
# For files that hold many frames: a third of the size in five times the time.
_PNG_SMALL = {cv2.IMWRITE_PNG_COMPRESSION: 1, cv2.IMWRITE_PNG_FILTER: cv2.IMWRITE_PNG_FILTER_UP}
_PLY_TYPES = {"<f4": "float", "|u1": "uchar"}


def encode_ids(ids: NDArray[np.uint8]) -> memoryview:
    """Encode class ids as an 8-bit PNG."""
    return _encode(".png", ids, _PNG_RUNS)


def count_beyond_png(metres: NDArray[np.float32]) -> int:
    """Number of pixels beyond the 255.99 m that `encode_metres` can hold; they become 65535.

    Readers of this format, including `to_metres`, treat this value as no measurement.
    """
    return int(np.count_nonzero(metres > METRES_PNG_MAX_M))


def encode_metres(metres: NDArray[np.float32], *, small: bool = False) -> memoryview:
    """Encode metres as a 16-bit PNG, metres x 256 rounded; see `count_beyond_png`."""
    near = np.clip(metres, 0, METRES_PNG_MAX_M)
    parameters = _PNG_SMALL if small else _PNG_STORED
    return _encode(".png", np.rint(near * METRES_PNG_SCALE).astype(np.uint16), parameters)


def encode_probability(probability: NDArray[np.float32]) -> memoryview:
    """Encode probabilities as an 8-bit PNG, probability x 255 rounded."""
    return _encode(".png", cv2.convertScaleAbs(probability, alpha=255), _PNG_STORED)


def encode_png(picture: NDArray[np.uint8]) -> memoryview:
    """Encode a picture, (H, W, 3) in BGR, as a PNG."""
    return _encode(".png", picture, {})


def encode_jpeg(picture: NDArray[np.uint8], *, quality: int = 85) -> memoryview:
    """Encode a picture, (H, W, 3) in BGR, as a JPEG.

    Raises:
        ValueError: if a side is too long for the format.
    """
    return _encode(".jpg", picture, {cv2.IMWRITE_JPEG_QUALITY: quality})


def encode_ply(cloud: PointCloud, classes: Sequence[ClassInfo] = ()) -> bytes:
    """Return the content of a PLY file.

    Args:
        cloud: the cloud. Its points are written as x, y, z in metres in the camera's frame, and, if
            the cloud has them, red, green, blue, the class id as `label`, and `uncertainty` in
            metres.
        classes: the classes in the order of their ids; their names and colours become comments in
            the header.
    """
    columns: dict[str, NDArray[Any]] = dict(zip("xyz", cloud.points.T, strict=True))
    if cloud.rgb is not None:
        columns |= zip(("red", "green", "blue"), cloud.rgb.T, strict=True)
    if cloud.semantic is not None:
        columns["label"] = cloud.semantic
    if cloud.uncertainty is not None:
        columns["uncertainty"] = cloud.uncertainty
    kinds = [(name, each.dtype) for name, each in columns.items()]
    vertices = np.rec.fromarrays(list(columns.values()), dtype=kinds)
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment metres in the camera's frame: x right, y down, z along the optical axis",
        *(
            f"comment label {index} {_ascii(info.name)} {' '.join(map(str, info.color))}"
            for index, info in enumerate(classes if cloud.semantic is not None else ())
        ),
        f"element vertex {len(vertices)}",
        *(f"property {_PLY_TYPES[each.dtype.str]} {name}" for name, each in columns.items()),
        "end_header",
    ]
    return "\n".join(header).encode("ascii") + b"\n" + vertices.tobytes()


# Functions that encode a head's array as the content of a file, by the head's unit.
ENCODERS: dict[Unit, Callable[[NDArray[Any]], memoryview]] = {
    Unit.CLASS_ID: encode_ids,
    Unit.METRES: encode_metres,
    Unit.PROBABILITY: encode_probability,
}


def encode_ros_image(unit: Unit, values: NDArray[Any]) -> tuple[str, memoryview]:
    """Return `format` and `data` of a sensor_msgs/CompressedImage for a head.

    Ids are a PNG and metres a 16-bit PNG, as in `ENCODERS`; probabilities x 255 are a JPEG.
    """
    if unit is Unit.METRES:
        return "16UC1; png compressed", encode_metres(values, small=True)
    if unit is Unit.CLASS_ID:
        return "mono8; png compressed", encode_ids(values)
    gray = cv2.convertScaleAbs(values, alpha=255)
    return "mono8; jpeg compressed", _encode(".jpg", gray, {cv2.IMWRITE_JPEG_QUALITY: 90})


def _ascii(name: str) -> str:
    """A name as ASCII text on one line."""
    return " ".join(name.encode("ascii", "replace").decode().split())


def _encode(suffix: str, image: Any, parameters: dict[int, int]) -> memoryview:
    done, content = cv2.imencode(suffix, image, list(chain(*parameters.items())))
    if not done:
        raise ValueError(f"{image.shape[0]} x {image.shape[1]} is too large for {suffix}")
    return content.ravel().data
