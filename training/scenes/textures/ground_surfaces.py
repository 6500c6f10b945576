"""Textures of the ground: asphalt with paint, paving, grass."""

from collections.abc import Sequence

import numpy as np

from training.scenes.textures.noise import fractal_noise, hash01, value_noise
from training.scenes.textures.paint import Stripe, band, paint_cover
from training.scenes.textures.surface import Points, Surface, matt, mix


def texture_asphalt(p: Points, stripes: Sequence[Stripe]) -> Surface:
    s, d = p.texture[:, 0], p.texture[:, 1]
    # The camera looks along the road: footprints stretch along s, hardly along d.
    long = p.footprint / np.maximum(p.slant, 0.02)
    grain = fractal_noise(s, d, wavelength=0.16, octaves=4, footprint=np.sqrt(long * p.footprint))
    stain = fractal_noise(s * 0.35, d, wavelength=1.9, octaves=3, footprint=p.footprint)
    worn = fractal_noise(s * 0.08, d, wavelength=1.1, octaves=2, footprint=p.footprint)
    tone = 1 + 0.36 * grain + 0.1 * stain + 0.09 * worn
    cell_s, cell_d = np.floor(s / 9.0).astype(np.int64), np.floor(d / 2.9).astype(np.int64)
    chance = hash01(cell_s, cell_d, 7)
    in_s, in_d = s / 9.0 - cell_s - 0.5, d / 2.9 - cell_d - 0.5
    size = 0.12 + 0.3 * hash01(cell_s, cell_d, 8)
    patch = band(in_s, size, long / 9.0) * band(in_d, size * 0.8, p.footprint / 2.9)
    tone *= 1 - np.where(chance < 0.07, 0.22, 0.0) * patch
    hole = np.hypot(in_s * 9.0, in_d * 2.9) - 0.33
    tone *= 1 - 0.55 * (chance > 0.94) * np.clip(0.5 - hole / np.maximum(long, 0.02), 0, 1)
    crack = np.abs(value_noise(s * 0.45, d * 0.9)) + 0.3 * np.abs(value_noise(s * 3, d * 3))
    tone *= 1 - 0.4 * np.clip(1 - crack / 0.05, 0, 1) * np.clip(1 - long / 0.2, 0, 1)
    albedo = p.color * np.clip(tone, 0.3, 1.8)[:, None]
    bare = np.clip(0.85 + 0.5 * stain + 0.25 * grain, 0.35, 0.95)
    for stripe in stripes:
        if stripe.along == "s":
            near = (s > stripe.start - 6) & (s < stripe.end + 6)
        else:
            near = np.abs(s - stripe.centre) < stripe.half_width + 6
        rows = np.flatnonzero(near)
        if len(rows):
            cover = paint_cover(stripe, s[rows], d[rows], long[rows], p.footprint[rows])
            albedo[rows] = mix(albedo[rows], stripe.color, cover * bare[rows])
    return matt(albedo)


def texture_paving(p: Points) -> Surface:
    s, d = p.texture[:, 0], p.texture[:, 1]
    pitch = p.params[:, 0]
    long = p.footprint / np.maximum(p.slant, 0.02)
    i, j = np.floor(s / pitch), np.floor(d / pitch)
    slab = hash01(i, j, 3) - 0.5
    fade = np.clip(1.2 - long / pitch, 0, 1)
    tone = 1 + 0.22 * slab * fade
    grain = fractal_noise(s, d, wavelength=0.5, octaves=4, footprint=np.sqrt(long * p.footprint))
    tone += 0.16 * grain + 0.12 * fractal_noise(s, d, wavelength=3.0, octaves=2)
    joint = 1 - band((s / pitch - i - 0.5) * pitch, 0.485 * pitch, long) * band(
        (d / pitch - j - 0.5) * pitch, 0.485 * pitch, p.footprint
    )
    tone *= 1 - 0.4 * joint * fade
    return matt(p.color * np.clip(tone, 0.3, 1.7)[:, None])


def texture_grass(p: Points) -> Surface:
    x, y = p.texture[:, 0], p.texture[:, 1]
    blades = fractal_noise(x, y, wavelength=0.35, octaves=4, footprint=p.footprint * 2)
    meadow = fractal_noise(x, y, wavelength=6.0, octaves=3, footprint=p.footprint)
    dry = np.clip(0.35 + 0.9 * meadow + 0.3 * (p.params[:, 0] - 0.5), 0, 1)
    color = mix(p.color, (0.19, 0.17, 0.075), dry)
    return matt(color * np.clip(1 + 0.55 * blades, 0.3, 1.8)[:, None])
