"""Checks of rotations and rigid transforms from files and messages."""

from typing import Any

import numpy as np

from runtime.base.arguments import array_dtype, shown
from runtime.base.arrays import Float64
from runtime.base.errors import InputError
from runtime.geometry.assumptions import assume

_EXACT = 1e-3  # covers the error of float32, and of files with four digits
_LARGEST_M = 1e7
_NEAR = 0.02  # DAIR-V2X's calibrations are within it, but not a lost sign or a scale


def nearest_rotation(name: str, rotation: Float64) -> Float64:
    """Return a rotation matrix, float64 (3, 3); if it is inexact, return the nearest rotation.

    Raises:
        InputError: if the matrix is no rotation, because it scales, shears or mirrors.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.abs(rotation.T @ rotation - np.eye(3)).max()
        determinant = np.linalg.det(rotation)
    if not error <= _NEAR or determinant < 0:
        raise InputError(
            f"{name} must be rigid, a rotation and a position, got {rotation.tolist()}: it scales, "
            f"shears or mirrors (its determinant is {determinant:.3g}), or a sign is lost, or its "
            "quaternion is not of unit length; give rows at right angles and of length 1, of which "
            "the third is the cross product of the first two"
        )
    if error <= _EXACT:
        return rotation
    remedy = f"give more digits, first of {name}"
    assume(f"the nearest rotations to some that are none to {_EXACT:g}", remedy)
    left, _, right = np.linalg.svd(rotation)
    return np.asarray(left @ right)


def nearest_rigid(name: str, matrix: Any) -> Float64:
    """Return a rigid transform as a new array, float64 (4, 4), see `nearest_rotation`.

    Raises:
        InputError: in the cases of `nearest_rotation`, and if the shape or type is wrong, a number
            is not finite, the position is beyond 10,000 km, or the last row is not 0, 0, 0, 1.
    """
    check_matrix(name, matrix, 4)
    if not np.array_equal(matrix[3], (0, 0, 0, 1)):
        raise InputError(
            f"the last row of {name} must be 0, 0, 0, 1, got {matrix[3].tolist()}: is the matrix "
            "transposed?"
        )
    if not np.abs(matrix[:3, 3]).max() <= _LARGEST_M:
        raise InputError(f"{name} must have a position in metres, got {matrix[:3, 3].tolist()}")
    rigid: Float64 = matrix.astype(np.float64)
    rigid[:3, :3] = nearest_rotation(name, rigid[:3, :3])
    return rigid


def check_matrix(name: str, matrix: Any, side: int) -> None:
    """Raise InputError unless `matrix` is a plain array of finite floats, (side, side)."""
    kind = array_dtype(matrix)
    if not (isinstance(kind, np.dtype) and kind.kind == "f"):
        raise InputError(f"{name} must be an array of floats, got {kind}")
    if matrix.shape != (side, side):
        raise InputError(f"{name} must have the shape ({side}, {side}), got {matrix.shape}")
    if not np.isfinite(matrix).all():
        raise InputError(f"{name} must be finite: check the calibration")


def finite_matrix(name: str, numbers: Any, rows: int, columns: int) -> Float64:
    """Return numbers of any type, or their texts, as a matrix (rows, columns).

    Raises InputError if they are not so many finite numbers.
    """
    try:
        matrix = np.asarray(numbers, dtype=np.float64)
    except (OverflowError, TypeError, ValueError):
        matrix = np.empty(0)
    if matrix.size != rows * columns or not np.isfinite(matrix).all():
        raise InputError(f"{name} must be {rows} x {columns} finite numbers, got {shown(numbers)}")
    return matrix.reshape(rows, columns)
