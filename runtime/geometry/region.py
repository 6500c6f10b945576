"""The part of a camera's sensor that its images show: binning and region of interest (REP 104)."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from runtime.base.arrays import Float64, Size
from runtime.geometry.assumptions import assume

# Largest offset of a principal point that lies in the middle, in shares of the sides.
_CENTRED = 0.05


def region_of_images(
    fields: Mapping[str, Any], intrinsics: Float64, size: Size | None = None
) -> tuple[Float64, Size | None]:
    """Return the intrinsics of the images of a CameraInfo, and their (height, width).

    By REP 104, the matrices, height and width of a CameraInfo describe the whole sensor. Some
    drivers state the size of the images, the matrices of the images, or both. If the sizes
    contradict each other or the principal point is far from the middle, the reading whose principal
    point is nearer to the middle is used. An `AssumptionWarning` says so, unless only binning is
    involved.

    Args:
        fields: fields of the CameraInfo: "height", "width", "binning_x", "binning_y", and "roi".
        intrinsics: its K or P, (3, 3).
        size: (height, width) of the images; None if unknown.
    """
    roi = fields.get("roi") or {}
    step = np.array([int(fields.get(f"binning_{axis}") or 1) for axis in "xy"])
    offset = np.array([int(roi.get(f"{axis}_offset") or 0) for axis in "xy"])
    whole, part = (
        np.array([int(of.get(side) or 0) for side in ("width", "height")]) for of in (fields, roi)
    )
    crop = np.diag([*(1 / step), 1.0])
    crop[:2, 2] = -(offset + (step - 1) / 2) / step  # `step` pixels have their centre in the middle
    sides = np.where(part > 0, part, whole) // step
    contradict = bool((offset + part > whole).any())
    if size is not None and all(size):
        contradict |= size == (whole[1], whole[0])
        sides = np.array(size[::-1]) if contradict else sides
    elif contradict:
        sides = whole
    stated = (int(sides[1]), int(sides[0])) if sides.all() else None
    if stated is None or np.array_equal(crop, np.eye(3)):
        return crop @ intrinsics, stated
    off, off_uncropped = (
        float(np.abs(matrix[:2, 2] / sides - 0.5).max())
        for matrix in (crop @ intrinsics, intrinsics)
    )
    is_of_images = off_uncropped < (off if contradict else min(_CENTRED, off / 2))
    if offset.any() and (contradict or is_of_images):
        of = "of the region of interest" if is_of_images else "of the whole sensor"
        assume(f"K and P of the CameraInfo are {of}", "give `calibration=`")
    return intrinsics if is_of_images else crop @ intrinsics, stated
