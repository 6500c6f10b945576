"""Point clouds as PLY files.

Format: Greg Turk, "The PLY Polygon File Format", 1994; binary, little-endian.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.contract import ClassInfo
from runtime.geometry.point_cloud import PointCloud

_PLY_TYPES = {"<f4": "float", "|u1": "uchar"}


def encode_ply(cloud: PointCloud, classes: Sequence[ClassInfo] = ()) -> bytes:
    """Return the content of a PLY file.

    Args:
        cloud: its points have x, y, z in metres in the camera's frame, and, where it has them, red,
            green, blue, and the class id as `label`.
        classes: in the order of the ids; names and colours are written as comments of the header.
    """
    columns: list[tuple[str, str, NDArray[Any]]] = [
        (axis, "<f4", cloud.points[:, index]) for index, axis in enumerate("xyz")
    ]
    if cloud.rgb is not None:
        columns += [
            (color, "|u1", cloud.rgb[:, index])
            for index, color in enumerate(("red", "green", "blue"))
        ]
    if cloud.semantic is not None:
        columns.append(("label", "|u1", cloud.semantic))
    vertices = np.empty(len(cloud.points), dtype=[(name, kind) for name, kind, _ in columns])
    for name, _, values in columns:
        vertices[name] = values
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment metres in the camera's frame: x right, y down, z along the optical axis",
        *(
            f"comment label {index} {_ascii(info.name)} {' '.join(map(str, info.color))}"
            for index, info in enumerate(classes if cloud.semantic is not None else ())
        ),
        f"element vertex {len(vertices)}",
        *(f"property {_PLY_TYPES[kind]} {name}" for name, kind, _ in columns),
        "end_header",
    ]
    return "\n".join(header).encode("ascii") + b"\n" + vertices.tobytes()


def _ascii(name: str) -> str:
    """A name as ASCII text on one line."""
    return " ".join(name.encode("ascii", "replace").decode().split())
