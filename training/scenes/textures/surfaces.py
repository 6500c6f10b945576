"""Procedural textures: albedo, gloss and glow of every surface kind, anchored to the surface."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from training.scenes.textures import building_surfaces, street_surfaces, vehicle_surfaces
from training.scenes.textures.patterns import Stripe, fractal_noise, value_noise
from training.scenes.textures.surface import Points, Surface, SurfaceKind, matt


def _foliage(p: Points) -> Surface:
    x, y, z = p.texture.T
    leaf = fractal_noise(x + 0.6 * z, y - 0.7 * z, wavelength=0.5, octaves=3, footprint=p.footprint)
    warm = value_noise(x * 0.8 + z, y * 0.8)
    color = p.color * np.clip(1 + 0.6 * leaf, 0.3, 2.0)[:, None]
    return matt(color * (1 + warm[:, None] * np.array((0.18, 0.06, -0.05), np.float32)), 0.004)


def _streaked(p: Points, numbers: Sequence[float], octaves: int, gloss: float = 0.0) -> Surface:
    """Texture noise along (x + a y) * b and z * c, of a, b, c, wavelength [m] and contrast."""
    x, y, z = p.texture.T
    a, b, c, size, contrast = numbers
    u, v = (x + a * y) * b, z * c
    noise = fractal_noise(u, v, wavelength=size, octaves=octaves, footprint=p.footprint)
    return matt(p.color * (1 + contrast * noise)[:, None], gloss)


def _plain(p: Points, gloss: float = 0.01) -> Surface:
    return matt(p.color.copy(), gloss)


def _glow(p: Points) -> Surface:
    return replace(matt(p.color.copy(), 0.04), glow=p.color * p.params[:, :1])


_SHADERS: dict[SurfaceKind, Callable[[Points], Surface]] = {
    SurfaceKind.PLAIN: _plain,
    SurfaceKind.PAVING: street_surfaces.texture_paving,
    SurfaceKind.GRASS: street_surfaces.texture_grass,
    SurfaceKind.FACADE: building_surfaces.texture_facade,
    SurfaceKind.ROOF: building_surfaces.texture_roof,
    SurfaceKind.FOLIAGE: _foliage,
    SurfaceKind.BARK: partial(_streaked, numbers=(1, 6, 1, 0.5, 0.45), octaves=3),
    SurfaceKind.METAL: partial(_streaked, numbers=(1, 1, 1, 0.7, 0.15), octaves=2, gloss=0.05),
    SurfaceKind.CAR_BODY: vehicle_surfaces.texture_car_body,
    SurfaceKind.CAR_SIDE_WINDOW: vehicle_surfaces.texture_car_side_window,
    SurfaceKind.CAR_GLASS: partial(_plain, gloss=0.09),
    SurfaceKind.WHEEL: vehicle_surfaces.texture_wheel,
    SurfaceKind.SIGN: street_surfaces.texture_sign,
    SurfaceKind.GLOW: _glow,
    SurfaceKind.BRICKWORK: building_surfaces.texture_brickwork,
    SurfaceKind.PLANKS: building_surfaces.texture_planks,
    SurfaceKind.CLOTH: partial(_streaked, numbers=(2, 1, 0.7, 0.22, 0.35), octaves=2),
    SurfaceKind.BUS_SIDE: vehicle_surfaces.texture_bus_side,
    SurfaceKind.STONE: building_surfaces.texture_stone,
}


def texture_surfaces(kind: NDArray[np.uint8], points: Points, stripes: Sequence[Stripe]) -> Surface:
    """Return the surface of every point by its kind, (n,) uint8 of `SurfaceKind`."""
    asphalt = partial(street_surfaces.texture_asphalt, stripes=stripes)
    shaders = _SHADERS | {SurfaceKind.ASPHALT: asphalt}
    albedo, glow = np.zeros((2, len(kind), 3), dtype=np.float32)
    gloss = np.zeros(len(kind), dtype=np.float32)
    for value in np.unique(kind):
        rows = np.flatnonzero(kind == value)
        part = shaders[SurfaceKind(value)](points.take(rows))
        albedo[rows], gloss[rows], glow[rows] = part.albedo, part.gloss, part.glow
    return Surface(np.clip(albedo, 0.005, 0.95), gloss, glow)
