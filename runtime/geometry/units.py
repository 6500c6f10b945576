"""Warnings about numbers that are possible, but unlikely in the expected unit.

The limits come from wide lenses. A lens of 150 degrees, treated as a pinhole, stretches the edges
15 times. Even a fisheye of 190 degrees has a focal length of 0.3 image widths, with which a pinhole
sees 118 degrees.
"""

import math

import numpy as np

from runtime.base.arrays import Floats
from runtime.geometry.assumptions import assume

_WIDEST_DEGREES = 150
_FARTHEST_SENSOR_M, _FARTHEST_BODY_M = 3.0, 10.0


def check_field_of_view(focal_px: float, width: int) -> None:
    """Warn if a focal length [px] is unlikely for this image width [px], such as millimetres."""
    degrees = 2 * math.degrees(math.atan(width / (2 * focal_px)))
    if degrees > _WIDEST_DEGREES:
        assume(
            f"a focal length of {focal_px:g} px, by which images of {width} px show {degrees:.0f} "
            "degrees",
            "give fx of the camera's matrix, in pixels; px = mm x image width in px / sensor width "
            "in mm",
        )


def check_principal_point(intrinsics: Floats, size: tuple[int, ...]) -> None:
    """Warn if the principal point is outside images of this (height, width)."""
    (column, row), (height, width) = intrinsics[:2, 2], size
    if not (0 <= column <= width and 0 <= row <= height):
        assume(
            f"a principal point outside the images of {width} x {height} px, at cx {column:g} and "
            f"cy {row:g}",
            "check cx and cy: scale them with the images, or subtract the columns and rows that "
            "were cut at the left and above; only images cut far from the middle have it there",
        )


def check_mount_distance(extrinsics: Floats, body: Floats | None) -> None:
    """Warn if the LiDAR is unlikely far from its camera or body, such as in centimetres.

    Args:
        extrinsics: (4, 4), from the LiDAR to the camera.
        body: (4, 4), from the LiDAR to the body; None if unknown.
    """
    mounts = ("camera", extrinsics, _FARTHEST_SENSOR_M), ("body", body, _FARTHEST_BODY_M)
    for name, matrix, farthest_m in mounts:
        if matrix is None or (apart_m := float(np.linalg.norm(matrix[:3, 3]))) <= farthest_m:
            continue
        assume(
            f"the LiDAR is {apart_m:.3g} m from the {name}",
            "translations are metres: check that those of the calibration are not centimetres or "
            "millimetres",
        )
