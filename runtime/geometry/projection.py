"""Projection of LiDAR returns to the sparse depth map of a camera.

Integers are pixel centres: the pixel in row v and column u reaches from v - 0.5 to v + 0.5 and from
u - 0.5 to u + 0.5, as in the intrinsics of KITTI and OpenCV. A return at (u, v) falls into pixel
(rint(u), rint(v)).
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from runtime.base.arguments import check_integer, shown
from runtime.base.arrays import Float32, Float64, Floats, Indices, Int64, Size
from runtime.base.errors import InputError
from runtime.contract.contract import MAX_SIDE
from runtime.geometry.lens import Lens, cache_key, pixels_of_rays, ray_bounds
from runtime.geometry.returns import check_points, coordinates_of
from runtime.geometry.rigid import check_matrix, nearest_rigid

_INDEX_BITS = 32


class ProjectedPoints(NamedTuple):
    """A sparse depth map and the points from which its returns come.

    Attributes:
        sparse_depth: float32 (H, W), metres, 0 = no return.
        rows: int32 (H, W), index of each pixel's return in the points, -1 if it has none.
    """

    sparse_depth: Float32
    rows: NDArray[np.int32]


def project_points(
    points: Float32, intrinsics: Floats, extrinsics: Floats, size: Size, *, lens: Lens | None = None
) -> Float32:
    """Project LiDAR returns into a camera as a sparse depth map.

    If several returns fall on one pixel, the nearest is kept. Returns behind the camera or outside
    the image are dropped, and so are points that are no returns, see `is_return`. The arithmetic is
    float32: a return within about 1e-3 px of the border of two pixels may fall into either.

    Args:
        points: float32 (N, 3) or wider, x, y, z first, metres, LiDAR frame.
        intrinsics: float (3, 3), pixels.
        extrinsics: float (4, 4), LiDAR to camera (x right, y down, z ahead), metres.
        size: (height, width) of the image.
        lens: the distortion of the image; None if the image is rectified. Returns outside the
            lens's field of view are dropped.

    Returns:
        float32 (height, width), metres along the optical axis, 0 = no return.

    Raises:
        InputError: if points, matrices or size have another type or shape, if the matrices are not
            those of a camera, or if the points cannot be metres, see `is_return`.
    """
    return project_with_rows(points, intrinsics, extrinsics, size, lens=lens).sparse_depth


def project_with_rows(
    points: Float32, intrinsics: Floats, extrinsics: Floats, size: Size, *, lens: Lens | None = None
) -> ProjectedPoints:
    """Project like `project_points`, and return the point of each pixel; ties keep the first."""
    check_points(points)
    check_intrinsics(intrinsics)
    extrinsics = nearest_rigid("extrinsics", extrinsics)
    height, width = _check_size(size)
    row, pixel, z = find_pixels(coordinates_of(points), intrinsics, extrinsics, size, lens=lens)

    # Positive floats are ordered like their bits. Far returns are written first, so that the
    # nearest remain.
    key = (z.view(np.int32).astype(np.int64) << _INDEX_BITS) | np.arange(len(z))
    key.sort()
    order = key[::-1] & ((1 << _INDEX_BITS) - 1)
    pixel = pixel[order]
    sparse_depth = np.zeros((height, width), dtype=np.float32)
    sparse_depth.reshape(-1)[pixel] = z[order]
    rows = np.full((height, width), -1, dtype=np.int32)
    rows.reshape(-1)[pixel] = row[order]
    return ProjectedPoints(sparse_depth, rows)


class PixelsOfPoints(NamedTuple):
    """The points that fall into an image.

    Attributes:
        rows: index of each of them, int (M,).
        pixel: row * width + column in the image, int64 (M,).
        depth: float32 (M,), metres along the optical axis.
    """

    rows: Indices
    pixel: Int64
    depth: Float32


def find_pixels(
    axes: Float32,
    intrinsics: Floats,
    extrinsics: Float64,
    size: tuple[int, ...],
    *,
    lens: Lens | None = None,
) -> PixelsOfPoints:
    """Return the pixels of points, float32 (3, N), like `project_points`, also of hidden ones.

    Raises InputError if the matrices together are beyond float32.
    """
    height, width = size
    with np.errstate(over="ignore", invalid="ignore"):
        product = intrinsics.astype(np.float64) @ extrinsics[:3].astype(np.float64)
        matrix = product.astype(np.float32)
        if not np.isfinite(matrix).all():
            raise InputError("intrinsics times extrinsics is beyond float32: check the calibration")
        # Comparing before dividing saves most divisions. The comparisons together are true only for
        # z > 0, and false for NaN.
        if lens is None:
            u_z, v_z, z = _transform(axes, matrix)
            row = np.flatnonzero((u_z > -z) & (u_z < width * z) & (v_z > -z) & (v_z < height * z))
            z = z[row]
            u, v = u_z[row] / z, v_z[row] / z
        else:
            x_z, y_z, z = _transform(axes, extrinsics[:3].astype(np.float32))
            bounds = ray_bounds(lens, cache_key(intrinsics), (height, width))
            left, right, top, bottom, _ = bounds
            row = np.flatnonzero(
                (x_z > left * z) & (x_z < right * z) & (y_z > top * z) & (y_z < bottom * z)
            )
            z = z[row]
            u, v = pixels_of_rays(x_z[row] / z, y_z[row] / z, lens, intrinsics, (height, width))
        u, v = np.rint(u), np.rint(v)
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    pixel = v[inside].astype(np.int64) * width + u[inside].astype(np.int64)
    return PixelsOfPoints(row[inside], pixel, z[inside])


def _transform(axes: Float32, matrix: Float32) -> list[Float32]:
    """Multiply `matrix`, float32 (3, 4), with (x, y, z, 1) of every point, float32 (3, N).

    A matrix product would use the threads of a BLAS, which compete with inference.
    """
    x, y, z = axes
    products = []
    for for_x, for_y, for_z, shift in matrix:
        product = for_x * x
        product += for_y * y
        product += for_z * z
        product += shift
        products.append(product)
    return products


def check_intrinsics(matrix: Any, name: str = "intrinsics") -> None:
    """Check the matrix of a camera.

    Args:
        matrix: float (3, 3), pixels, with positive fx and fy and the last row 0, 0, 1.
        name: name of the matrix in the message.

    Raises:
        InputError: for anything else, including masked arrays and `numpy.matrix`.
    """
    check_matrix(name, matrix, 3)
    usable = (matrix[[0, 1], [0, 1]] > 0).all() and np.linalg.det(matrix.astype(np.float64)) > 0
    if not usable or not np.array_equal(matrix[2], (0, 0, 1)):
        raise InputError(
            f"{name} must have positive focal lengths fx and fy and the last row 0, 0, 1, got "
            f"{matrix.tolist()}: is the matrix transposed?"
        )


def split_projection(projection: Float64, name: str) -> tuple[Float64, Float64]:
    """Return K (3, 3) and [I | t], (4, 4), of a projection P = K [I | t], (3, 4).

    t is the offset of a camera, in its own frame, from the first one of its pair. Raises InputError
    if K is not the matrix of a camera.
    """
    intrinsics, shift = projection[:, :3], np.eye(4)
    check_intrinsics(intrinsics, f"{name}, without its last column,")
    shift[:3, 3] = np.linalg.solve(intrinsics, projection[:, 3])
    return intrinsics, shift


def _check_size(size: Any) -> Size:
    if not isinstance(size, tuple) or len(size) != 2:
        raise InputError(f"size must be (height, width), got {shown(size)}")
    height, width = (
        check_integer("each side of size", side, 1, MAX_SIDE, "pixels", error=InputError)
        for side in size
    )
    return height, width
