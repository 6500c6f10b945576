"""Lens distortion: where a ray meets the image, and the ray of each pixel.

The models and the order of their coefficients are those of OpenCV and of ROS's CameraInfo (Brown
1966; Kannala and Brandt 2006). A ray is (x, y) = (X / Z, Y / Z) in the camera's frame. A model is
used up to the angle from the optical axis at which its radius stops growing. Beyond this angle it
would fold the scene back into the image.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from runtime.base.arguments import shown
from runtime.base.arrays import Float32, Float64, Floats, Size
from runtime.base.errors import InputError
from runtime.geometry.assumptions import assume

PLUMB_BOB, RATIONAL_POLYNOMIAL, EQUIDISTANT = "plumb_bob", "rational_polynomial", "equidistant"
# Names that Kalibr, OpenCV and librealsense use for these models.
_ALIASES = {"radtan": PLUMB_BOB} | dict.fromkeys(
    ("equi", "fisheye", "kannala_brandt4"), EQUIDISTANT
)
# Accepted numbers of coefficients, and the names of the coefficients, for each model.
_COEFFICIENTS = {
    PLUMB_BOB: ((4, 5), "k1, k2, p1, p2[, k3]"),
    RATIONAL_POLYNOMIAL: ((8,), "k1, k2, p1, p2, k3, k4, k5, k6"),
    EQUIDISTANT: ((4,), "k1, k2, k3, k4"),
}
_WIDEST = np.deg2rad(89.9)  # from the optical axis; depth along this axis must be positive
_KNOTS = 65_537  # of the table of angles: with linear interpolation the error is below 1e-8 rad
_ROUNDS, _CLOSE = 20, 1e-7  # for the inversion of the tangential part

Key = tuple[float, ...]
Rays = TypeVar("Rays", Float32, Float64)


class RayBounds(NamedTuple):
    """Bounds of the rays that can meet an image, float32; `radius_2` bounds x * x + y * y."""

    left: Any
    right: Any
    top: Any
    bottom: Any
    radius_2: Any


@dataclass(frozen=True)
class Lens:
    """A model of distortion and its coefficients.

    Attributes:
        model: "plumb_bob", "rational_polynomial" or "equidistant" (a fisheye).
        coefficients: coefficients of the model.

    Raises:
        InputError: if the model is unknown, the number of coefficients is wrong, or one of them is
            not finite.
    """

    model: str
    coefficients: tuple[float, ...]

    def __post_init__(self) -> None:
        """Check the values."""
        if self.model not in _COEFFICIENTS:
            raise InputError(
                f"lens must be one of {', '.join(_COEFFICIENTS)}, got {shown(self.model)}: "
                "calibrate with one of these, or rectify the images and leave out the lens"
            )
        counts, names = _COEFFICIENTS[self.model]
        if len(self.coefficients) not in counts or not np.isfinite(self.coefficients).all():
            raise InputError(
                f"the distortion of the lens {self.model} must be the {counts[-1]} finite numbers "
                f"{names} in OpenCV's order, got {shown(list(self.coefficients))}"
            )

    @classmethod
    def of(cls, model: Any, coefficients: Any) -> "Lens":
        """Make a lens from values of any type; zeros after the model's coefficients are ignored.

        Raises InputError.
        """
        try:
            numbers = tuple(np.asarray(coefficients, dtype=np.float64).ravel().tolist())
        except (OverflowError, TypeError, ValueError) as error:
            raise InputError(
                f"distortion must be the lens's coefficients, got {shown(coefficients)}"
            ) from error
        (*_, most), _ = _COEFFICIENTS.get(str(model), ((0,), ""))
        if not any(numbers[most:]):  # OpenCV uses 14 for all its models
            numbers = numbers[:most]
        return cls(str(model), numbers)

    @classmethod
    def of_ros(cls, model: Any, coefficients: Any) -> "Lens | None":
        """Make the lens of a ROS CameraInfo; None for a pinhole. Raises InputError."""
        name = _ALIASES.get(str(model), str(model))
        if name == EQUIDISTANT or np.any(coefficients):
            return cls.of(name, coefficients)
        if model and name not in (PLUMB_BOB, RATIONAL_POLYNOMIAL, "none", "pinhole"):
            assume(f"a pinhole: all coefficients of {shown(model)} are 0", "give `calibration=`")
        return None

    def distort(self, x: Rays, y: Rays) -> tuple[Rays, Rays]:
        """Project rays to the image plane at focal length 1; they must be in the field of view."""
        radius_2 = x * x + y * y
        scale = self._scale(radius_2)
        moved_x, moved_y = self._tangential(x, y, radius_2)
        return x * scale + moved_x, y * scale + moved_y

    def undistort(self, x: Float64, y: Float64) -> tuple[Float64, Float64]:
        """Return the ray of each point (x, y) of the image plane; NaN if there is no such ray."""
        angles, radii = _field(self)
        ray_x, ray_y = x, y
        with np.errstate(all="ignore"):
            for _ in range(_ROUNDS):
                before_x, before_y = ray_x, ray_y
                moved_x, moved_y = self._tangential(ray_x, ray_y, ray_x * ray_x + ray_y * ray_y)
                radial_x, radial_y = x - moved_x, y - moved_y
                radius = np.hypot(radial_x, radial_y)
                ray_radius = np.tan(np.interp(radius, radii, angles, right=np.nan))
                ratio = np.divide(ray_radius, radius, out=np.ones_like(radius), where=radius != 0)
                ray_x, ray_y = radial_x * ratio, radial_y * ratio
                change = np.maximum(np.abs(ray_x - before_x), np.abs(ray_y - before_y))
                if not self._has_tangential or not (change > _CLOSE).any():
                    break
        return ray_x, ray_y

    @property
    def is_ideal(self) -> bool:
        """Whether the lens does not distort: all coefficients of its polynomial are 0."""
        return self.model != EQUIDISTANT and not any(self.coefficients)

    @property
    def _has_tangential(self) -> bool:
        return self.model != EQUIDISTANT and any(self.coefficients[2:4])

    def _scale(self, radius_2: Any) -> Any:
        """Ratio of the radius in the image to the radius of the ray."""
        if self.model == EQUIDISTANT:
            k1, k2, k3, k4 = self.coefficients
            radius = np.sqrt(radius_2)
            angle = np.arctan(radius)
            square = angle * angle
            angle *= 1 + square * (k1 + square * (k2 + square * (k3 + square * k4)))
            return np.divide(angle, radius, out=np.ones_like(radius), where=radius != 0)
        k1, k2, _, _, k3, *below = (*self.coefficients, 0.0)[: max(5, len(self.coefficients))]
        scale = 1 + radius_2 * (k1 + radius_2 * (k2 + radius_2 * k3))
        if below:
            k4, k5, k6 = below
            scale /= 1 + radius_2 * (k4 + radius_2 * (k5 + radius_2 * k6))
        return scale

    def _tangential(self, x: Rays, y: Rays, radius_2: Rays) -> tuple[Any, Any]:
        if not self._has_tangential:
            return 0, 0
        p1, p2 = self.coefficients[2:4]
        twice_xy = 2 * x * y
        moved_x = p1 * twice_xy + p2 * (radius_2 + 2 * x * x)
        return moved_x, p1 * (radius_2 + 2 * y * y) + p2 * twice_xy


def to_image_plane(
    intrinsics: Floats, column: NDArray[Any], row: NDArray[Any]
) -> tuple[Float64, Float64]:
    """Return where pixels lie on the image plane at focal length 1, (x, y).

    In a rectified image this is the ray of the pixel.
    """
    lines = np.linalg.inv(intrinsics.astype(np.float64))[:2]
    x, y = (of_column * column + of_row * row + shift for of_column, of_row, shift in lines)
    return x, y


def cache_key(intrinsics: Floats) -> Key:
    """Return the numbers of a matrix (3, 3), a key for the cached tables of a camera."""
    return tuple(intrinsics.astype(np.float64).ravel().tolist())


@lru_cache(maxsize=16)
def _field(lens: Lens) -> tuple[Float64, Float64]:
    """Angles from the optical axis, while the radius in the image grows, and these radii."""
    angles = np.linspace(0, _WIDEST, _KNOTS)
    radius = np.tan(angles)
    with np.errstate(all="ignore"):
        radii: Float64 = radius * lens._scale(radius * radius)
        ends = np.flatnonzero(~(np.diff(radii) > 0))
    count = ends[0] + 1 if len(ends) else _KNOTS
    return angles[:count], radii[:count]


@lru_cache(maxsize=4)
def rays(lens: Lens, intrinsics: Key, size: Size) -> Any:
    """Return the ray (x, y) of each pixel, float32 (height, width, 2); NaN where there is none.

    The array is read-only, and is kept for the next call.
    """
    height, width = size
    row, column = np.mgrid[:height, :width].astype(np.float64)
    plane = to_image_plane(np.reshape(intrinsics, (3, 3)), column, row)
    table = np.stack(lens.undistort(*plane), axis=-1).astype(np.float32)
    table.flags.writeable = False
    return table


@lru_cache(maxsize=16)
def ray_bounds(lens: Lens, intrinsics: Key, size: Size) -> RayBounds:
    """Return the bounds of the rays that can meet an image of this (height, width)."""
    height, width = size
    angles, _ = _field(lens)
    farthest = np.tan(angles[-1])
    across, down = np.arange(width + 1) - 0.5, np.arange(height + 1) - 0.5
    column = np.concatenate([across, across, np.full_like(down, -0.5), 0 * down + width - 0.5])
    row = np.concatenate([np.full_like(across, -0.5), 0 * across + height - 0.5, down, down])
    x, y = lens.undistort(*to_image_plane(np.reshape(intrinsics, (3, 3)), column, row))
    bounds = np.array([x.min(), x.max(), y.min(), y.max()])
    if not np.isfinite(bounds).all():  # the image is larger than the field of view of the lens
        bounds = np.array([-farthest, farthest, -farthest, farthest])
    margin = 1e-3 * (bounds[1::2] - bounds[::2]).max()
    bounds += [-margin, margin, -margin, margin]
    left, right, top, bottom = bounds.astype(np.float32)
    return RayBounds(left, right, top, bottom, np.float32(farthest * farthest))


def pixels_of_rays(
    x: Rays, y: Rays, lens: Lens | None, intrinsics: Floats, size: Size
) -> list[Rays]:
    """Return the columns and the rows at which rays meet an image; -1 where the lens sees none."""
    seen = None
    if lens is not None:
        seen = x * x + y * y <= ray_bounds(lens, cache_key(intrinsics), size).radius_2
        x, y = lens.distort(np.where(seen, x, 0), np.where(seen, y, 0))
    lines = intrinsics[:2].astype(x.dtype)
    pixels = [for_x * x + for_y * y + shift for for_x, for_y, shift in lines]
    return pixels if seen is None else [np.where(seen, each, x.dtype.type(-1)) for each in pixels]


@lru_cache(maxsize=4)
def rectifying_maps(lens: Lens, intrinsics: Key, size: Size) -> tuple[Float32, Float32]:
    """Return where each pixel of the rectified image lies in the distorted one, for `cv2.remap`.

    The columns and rows are float32 (height, width), -1 where nothing was seen, and are kept for
    the next call.
    """
    height, width = size
    matrix = np.reshape(intrinsics, (3, 3))
    row, column = np.mgrid[:height, :width].astype(np.float64)
    pixels = pixels_of_rays(*to_image_plane(matrix, column, row), lens, matrix, size)
    across, down = (each.astype(np.float32) for each in pixels)
    return across, down
