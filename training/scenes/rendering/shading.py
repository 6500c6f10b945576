"""From ray hits to light: sun with shadows, sky light with contact shading, mirrors, haze."""

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from training.scenes.arrays import Floats
from training.scenes.rendering.raycast import Hits, RayCaster
from training.scenes.rendering.weather import Weather, sky_color
from training.scenes.textures.patterns import fractal_noise
from training.scenes.textures.surface import SurfaceKind

_GROUND = (SurfaceKind.ASPHALT, SurfaceKind.PAVING)
_LIFT = 2e-3
# Number and reach of the rays of contact shading.
_CONTACT_RAYS, _CONTACT_M = 3, 2.5


def shade(
    caster: RayCaster,
    hits: Hits,
    directions: Floats,
    *,
    pixel_angle: float,
    openness: Floats,
    weather: Weather,
    rng: Generator,
) -> Floats:
    """Return the linear RGB radiance (n, 3) of rays from the origin along directions (n, 3).

    Args:
        caster: casts further rays.
        hits: the rays' first hits, at hits.distance times the direction.
        directions: directions of the rays.
        pixel_angle: angle that a pixel covers [rad].
        openness: (n,), share of the sky that reaches the hit point past near surfaces.
        weather: light and weather.
        rng: source of random numbers.
    """
    length = np.linalg.norm(directions, axis=1)
    view = directions / length[:, None]
    radiance = np.empty_like(view)
    rows = np.flatnonzero(hits.face >= 0)
    free = np.flatnonzero(hits.face < 0)
    radiance[free] = sky_color(weather, view[free])
    if len(free) and weather.haze > 0.004:
        veil = np.exp(-np.clip(view[free, 2:], 0, 1) * 0.06 / weather.haze)
        radiance[free] = radiance[free] * (1 - veil) + np.asarray(weather.horizon) * veil
    if not len(rows):
        return np.asarray(radiance)
    hits, view = hits.take(rows), view[rows]
    sun, horizon = np.asarray((weather.sun, weather.horizon), np.float32)
    distance = hits.distance * length[rows]
    point = directions[rows] * hits.distance[:, None]
    points, surface = caster.surfaces(hits, view, (distance * pixel_angle).astype(np.float32))
    normal, flat = points.normal, caster.normals(hits, view)
    kind = caster.mesh.kind[hits.face]
    soft, albedo, gloss = kind == SurfaceKind.FOLIAGE, surface.albedo, surface.gloss
    ground = np.isin(kind, _GROUND)
    if weather.wet:
        puddle = fractal_noise(point[:, 0], point[:, 1], wavelength=5.0, octaves=3)
        albedo = albedo * np.where(ground, 1 - 0.45 * weather.wet, 0.9)[:, None]
        film = np.clip(0.45 + puddle, 0.1, 1)
        gloss = np.where(ground, 0.05 * weather.wet * film, gloss)

    lift = point + flat * (_LIFT + 2e-5 * distance[:, None]).astype(np.float32)
    reflect_sun = np.zeros(len(rows), dtype=np.float32)
    light = np.zeros_like(albedo)
    if weather.sun[0] > 0:
        toward = np.asarray(weather.sun_direction, np.float32)
        facing = normal @ toward
        # Leaves let light through; other surfaces do not.
        facing = np.where(soft, 0.25 + 0.75 * facing, facing)
        facing = np.where(soft | (flat @ toward > 0), np.clip(facing, 0, 1), 0)
        lit = np.flatnonzero(facing > 0)
        blur = 0.0015 * rng.standard_normal((len(lit), 3)).astype(np.float32)
        start = lift[lit] + toward * np.where(soft[lit], 0.25, 0.0)[:, None].astype(np.float32)
        dark = caster.blocked(start, toward + blur)
        facing[lit[dark]] = 0
        light += facing[:, None] * sun
        mirror = view - 2 * (view * normal).sum(1, keepdims=True) * normal
        reflect_sun = np.where(facing > 0, np.clip(mirror @ toward, 0, 1) ** 180, 0)
    ambient = 0.5 + 0.5 * normal[:, 2:]
    dome = 0.62 * np.asarray(weather.zenith, np.float32) + 0.38 * horizon
    bounce = 0.16 * (dome + 0.5 * sun * weather.sun_direction[2])
    light += openness[rows, None] * (ambient * dome + (1 - ambient) * bounce)
    color = albedo * light + surface.glow

    shiny = np.flatnonzero(gloss > 0.003)
    if len(shiny):
        n, d = normal[shiny], view[shiny]
        cosine = np.clip(-(n * d).sum(1), 0, 1)
        rise = np.minimum((1 - cosine) ** 5, 0.75)
        share = gloss[shiny] + (1 - gloss[shiny]) * rise * np.clip(gloss[shiny] / 0.05, 0, 1)
        mirror = d - 2 * (n * d).sum(1, keepdims=True) * n
        seen = _surroundings(weather, mirror, caster, lift[shiny], ground[shiny])
        seen += (2.5 * reflect_sun[shiny])[:, None] * sun
        color[shiny] = color[shiny] * (1 - share[:, None]) + seen * share[:, None]
    kept = np.exp(-weather.haze * distance)[:, None]
    radiance[rows] = color * kept + 0.9 * horizon * (1 - kept)
    return np.asarray(radiance)


def _surroundings(
    weather: Weather, mirror: Floats, caster: RayCaster, start: Floats, ground: NDArray[np.bool_]
) -> Floats:
    """Return the radiance in a mirror: sky, dark houses if the ray is blocked, or street."""
    sky = sky_color(weather, mirror, detail=False)
    dim = 0.16 * np.asarray(weather.horizon, np.float32)
    below = np.clip(0.5 - mirror[:, 2:] * 8, 0, 1)
    seen = sky * (1 - below) + dim * below
    # A ripple makes reflections in a wet road long and broken rather than sharp.
    towards = mirror.copy()
    towards[ground, 2] += 0.02
    hidden = caster.blocked(start, towards, 120.0)
    seen[hidden] = np.where(below[hidden] > 0.5, seen[hidden], seen[hidden] * 0.22 + dim * 0.4)
    return seen


def contact_shading(caster: RayCaster, points: Floats, normals: Floats, rng: Generator) -> Floats:
    """Return the share (n,) of short rays that escape over the hemisphere; dark under cars."""
    free = np.zeros(len(points), dtype=np.float32)
    for _ in range(_CONTACT_RAYS):
        ball = rng.standard_normal((len(points), 3), dtype=np.float32)
        ball /= np.linalg.norm(ball, axis=1, keepdims=True)
        # A point on the unit sphere around the normal's tip is a cosine-weighted direction.
        direction = normals + 0.98 * ball
        free += ~caster.blocked(points, direction, _CONTACT_M)
    return free / _CONTACT_RAYS
