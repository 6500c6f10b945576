"""Conversion of a predicted depth map to a point cloud without points between objects."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from runtime.base.arguments import check_number
from runtime.base.arrays import Float32, Floats, UInt8
from runtime.base.errors import InputError
from runtime.contract.heads import EDGE_BOUNDARY
from runtime.geometry.lens import Lens, cache_key, rays, to_image_plane
from runtime.geometry.projection import check_intrinsics

_LEAST_VOXEL_M = 0.01


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Points in the camera's frame: x to the right, y down, z along the optical axis.

    Attributes:
        points: float32 (N, 3), metres.
        rgb: uint8 (N, 3), colours of the image; None if no image was given.
        semantic: uint8 (N,), class ids; None if the model has no such head.
        uncertainty: float32 (N,), metres, see `Prediction.depth_uncertainty`; None if the model has
            no such head.
        rows: int32 (N,), row of each point's pixel.
        columns: int32 (N,), column of each point's pixel.
    """

    points: Float32
    rgb: UInt8 | None
    semantic: UInt8 | None
    uncertainty: Float32 | None
    rows: NDArray[np.int32]
    columns: NDArray[np.int32]

    def take(self, chosen: NDArray[Any]) -> "PointCloud":
        """Return a cloud of some of the points.

        Args:
            chosen: their indices, or bool (N,).
        """
        return PointCloud(**_taken(vars(self), chosen))


def _taken(arrays: Mapping[str, NDArray[Any] | None], chosen: Any) -> dict[str, Any]:
    """The same elements of each array that is given."""
    return {name: None if each is None else each[chosen] for name, each in arrays.items()}


def depth_to_cloud(
    depth: Float32,
    intrinsics: Floats,
    *,
    lens: Lens | None = None,
    rgb: UInt8 | None = None,
    semantic: UInt8 | None = None,
    boundary: Float32 | None = None,
    uncertainty: Float32 | None = None,
    edge_boundary: float | Literal["auto"] | None = "auto",
    max_uncertainty: float | None = None,
    sky: int | None = None,
) -> PointCloud:
    """Return a point for each pixel that has depth, row after row.

    Args:
        depth: float32 (H, W), metres; pixels of 0, negative depth, NaN and Inf have no point.
        intrinsics: float (3, 3), in pixels of this depth map; integers are pixel centres.
        lens: the distortion of the image; None if the image is rectified. Pixels outside the lens's
            field of view have no point.
        rgb: uint8 (H, W, 3), colours of the points.
        semantic: uint8 (H, W), class ids.
        boundary: float32 (H, W), probability; pixels above `edge_boundary` have no point.
        uncertainty: float32 (H, W), metres.
        edge_boundary: "auto" is 0.25 if `semantic` is given and 0.5 if not, because the boundary of
            a model without classes is never halved. None keeps all pixels.
        max_uncertainty: pixels whose uncertainty is a larger share of their depth have no point;
            None keeps all pixels.
        sky: class id whose pixels have no point; None if there is no such class.

    Raises:
        InputError: if the shapes or types of the arrays do not fit each other.
    """
    check_intrinsics(intrinsics)
    if rgb is not None and rgb.dtype != np.uint8:
        raise InputError(f"rgb must be uint8, got {rgb.dtype}")
    kept_arrays = {"rgb": rgb, "semantic": semantic, "uncertainty": uncertainty}
    for name, array in {**kept_arrays, "boundary": boundary}.items():
        expected = (*depth.shape, 3) if name == "rgb" else depth.shape
        if array is not None and array.shape != expected:
            raise InputError(f"{name} must have the shape {expected}, got {array.shape}")
    if max_uncertainty is not None:
        max_uncertainty = check_number("max_uncertainty", max_uncertainty, 0, 1e6, error=InputError)
        if uncertainty is None:
            raise InputError("max_uncertainty needs an uncertainty, which this model does not have")
    if edge_boundary == "auto":
        edge_boundary = EDGE_BOUNDARY if semantic is None else EDGE_BOUNDARY / 2
    kept = (depth > 0) & (depth < np.inf)
    if boundary is not None and edge_boundary is not None:
        kept &= boundary <= edge_boundary
    if uncertainty is not None and max_uncertainty is not None:
        kept &= uncertainty <= max_uncertainty * depth
    if semantic is not None and sky is not None:
        kept &= semantic != sky
    if lens is not None:
        table = rays(lens, cache_key(intrinsics), (depth.shape[0], depth.shape[1]))
        kept &= np.isfinite(table[..., 0])
    row, column = np.nonzero(kept)
    z = depth[row, column]
    if lens is None:
        x, y = (place.astype(np.float32) for place in to_image_plane(intrinsics, column, row))
    else:
        x, y = table[row, column].T
    return PointCloud(
        points=np.stack([x * z, y * z, z], axis=1),
        rows=row.astype(np.int32),
        columns=column.astype(np.int32),
        **_taken(kept_arrays, (row, column)),
    )


def thin_to_voxels(cloud: PointCloud, side_m: float) -> PointCloud:
    """Keep one point in each cube of space, in the order of the pixels.

    The point with the smallest uncertainty is kept, or the first one if there is no uncertainty.

    Args:
        cloud: the points.
        side_m: side of the cubes, metres; they are aligned with the axes of the camera.

    Raises:
        InputError: if the side is out of range.
    """
    side_m = check_number("voxel_m", side_m, _LEAST_VOXEL_M, 1e6, "metres", error=InputError)
    # With 21 bits per axis, cubes of a centimetre reach to 10 km.
    cubes = np.clip(np.floor(cloud.points / side_m).astype(np.int64), -(2**20), 2**20 - 1)
    x, y, z = (cubes + 2**20).T
    keys = (x << 42) | (y << 21) | z
    order = np.argsort(keys, kind="stable")  # within a cube the points keep the order of the pixels
    cube = np.cumsum(np.diff(keys[order], prepend=keys[order[:1]]) > 0)
    if cloud.uncertainty is not None and len(order):
        doubt = cloud.uncertainty[order]
        least = np.minimum.reduceat(doubt, np.flatnonzero(np.diff(cube, prepend=-1)))
        surest = doubt == least[cube]
        order, cube = order[surest], cube[surest]
    return cloud.take(np.sort(order[np.diff(cube, prepend=-1) > 0]))
