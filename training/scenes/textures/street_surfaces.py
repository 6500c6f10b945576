"""Textures of the street: asphalt with paint, paving, grass, faces of traffic signs."""

from collections.abc import Sequence

import numpy as np

from training.scenes.arrays import Floats
from training.scenes.textures.patterns import (
    Stripe,
    band,
    fractal_noise,
    hash01,
    paint_cover,
    value_noise,
)
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
    fade = np.clip(1.2 - long / pitch, 0, 1)
    tone = 1 + 0.22 * (hash01(i, j, 3) - 0.5) * fade
    grain = fractal_noise(s, d, wavelength=0.5, octaves=4, footprint=np.sqrt(long * p.footprint))
    tone += 0.16 * grain + 0.12 * fractal_noise(s, d, wavelength=3.0, octaves=2)
    in_row = band((s / pitch - i - 0.5) * pitch, 0.485 * pitch, long)
    joint = 1 - in_row * band((d / pitch - j - 0.5) * pitch, 0.485 * pitch, p.footprint)
    tone *= 1 - 0.4 * joint * fade
    return matt(p.color * np.clip(tone, 0.3, 1.7)[:, None])


def texture_grass(p: Points) -> Surface:
    x, y = p.texture[:, 0], p.texture[:, 1]
    blades = fractal_noise(x, y, wavelength=0.35, octaves=4, footprint=p.footprint * 2)
    meadow = fractal_noise(x, y, wavelength=6.0, octaves=3, footprint=p.footprint)
    dry = np.clip(0.35 + 0.9 * meadow + 0.3 * (p.params[:, 0] - 0.5), 0, 1)
    color = mix(p.color, (0.19, 0.17, 0.075), dry)
    return matt(color * np.clip(1 + 0.55 * blades, 0.3, 1.8)[:, None])


def texture_sign(p: Points) -> Surface:
    """Texture the faces of traffic signs; the texture coordinates are the face, -1..1 both ways."""
    a, b = p.texture[:, 0], p.texture[:, 1]
    kind, lot = np.rint(p.params[:, 0]).astype(int), p.params[:, 1:2]
    reach, f = np.hypot(a, b), p.footprint / 0.38
    white, red, black = (0.75, 0.75, 0.73), (0.55, 0.02, 0.02), (0.02, 0.02, 0.02)
    blue, yellow, green = (0.02, 0.1, 0.42), (0.75, 0.5, 0.02), (0.01, 0.2, 0.1)
    out = np.tile(np.asarray(white, dtype=np.float32), (len(a), 1))

    def lay(number: int, cover: Floats, color: Floats | Sequence[float]) -> None:
        rows = np.flatnonzero(kind == number)
        paint = np.broadcast_to(np.asarray(color, dtype=np.float32), out.shape)
        out[rows] = mix(out[rows], paint[rows], cover[rows])

    def triangle(up: Floats) -> Floats:
        """Return the inner part of a sign whose tip is at up = 1 and its base at 0."""
        rim = np.minimum(up - 0.12, (1 - up) * 0.9 - np.abs(a) - 0.22) / np.maximum(f, 0.02)
        return np.asarray(np.clip(rim + 0.5, 0, 1))

    bar = band(a, 0.11, f) * band(b - 0.02, 0.38, f)
    arrow = band(np.abs(a) - (0.5 - b) * 0.8, 0.1, f) * (b > 0.05) * (b < 0.5)
    word = hash01(np.floor(a * 9), np.floor((b + 1) * 2.2), 6) < 0.7
    text = band(np.mod((b + 1) * 2.2, 1) - 0.5, 0.24, f * 2.2) * word * (np.abs(a) < 0.8)
    text *= band(np.mod(a * 9, 1) - 0.5, 0.34, f * 9)
    lay(0, 1 - band(reach, 0.72, f), red)
    lay(0, band(np.abs(a) - 0.2, 0.12, f) * band(b, 0.32, f), black)
    lay(1, 1 - triangle((b + 0.8) / 1.75), red)
    lay(1, band(a, 0.08, f) * band(b + 0.15, 0.3, f), black)
    lay(7, 1 - triangle((0.95 - (b + 0.15)) / 1.75), red)
    lay(2, np.ones_like(a), blue)
    lay(2, bar + arrow, white)
    lay(3, np.ones_like(a), red)
    lay(3, band(a, 0.68, f) * band(b, 0.17, f), white)
    lay(4, band(np.abs(a) + np.abs(b), 0.72, f), yellow)
    board = np.where(lot < 0.4, blue, np.where(lot < 0.7, green, yellow))
    lay(5, band(a, 0.96, f) * band(b, 0.93, f), board)
    lay(5, text * 0.9, np.where(lot < 0.7, white, black))
    lay(6, band(a, 0.92, f) * band(b, 0.92, f), blue)
    lay(6, bar + band(a - 0.15, 0.22, f) * band(b - 0.2, 0.2, f), white)
    lay(9, (1 - band(a, 0.93, f) * band(b, 0.85, f)) + text, black)
    return matt(out, 0.03)
