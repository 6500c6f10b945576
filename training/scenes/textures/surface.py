"""Surface points, the kinds of surface, and the material that a texture gives them."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from training.scenes.arrays import Floats, Rows

# `surfaces` has one function for each kind.
SurfaceKind = IntEnum(
    "SurfaceKind",
    "PLAIN ASPHALT PAVING GRASS FACADE ROOF FOLIAGE BARK METAL CAR_BODY CAR_SIDE_WINDOW CAR_GLASS "
    "WHEEL SIGN GLOW BRICKWORK PLANKS CLOTH BUS_SIDE STONE",
    start=0,
)


@dataclass(frozen=True)
class Points(Rows):
    """Surface points to texture, with n rows each.

    Attributes:
        texture: (n, 3), coordinates in the object's own frame [m].
        normal: (n, 3).
        color: (n, 3), base colour.
        params: (n, 8), read by the texture of the kind.
        footprint: (n,), width [m] that a pixel covers across the view ray.
        slant: (n,), cosine between view ray and normal, 0..1.
    """

    texture: Floats
    normal: Floats
    color: Floats
    params: Floats
    footprint: Floats
    slant: Floats


@dataclass(frozen=True)
class Surface:
    """A material for the shader.

    Attributes:
        albedo: (n, 3), linear.
        gloss: (n,), share of mirrored light at normal incidence.
        glow: (n, 3), emitted light.
    """

    albedo: Floats
    gloss: Floats
    glow: Floats


def matt(albedo: Floats, gloss: float | Floats = 0.0) -> Surface:
    shiny = np.broadcast_to(np.float32(gloss), (len(albedo),)).astype(np.float32)
    return Surface(albedo, shiny, np.zeros_like(albedo))


def mix(a: Floats, b: Floats | Sequence[float], weight: Floats) -> Floats:
    w = weight[:, None]
    return np.asarray(a * (1 - w) + np.asarray(b, dtype=np.float32) * w)
