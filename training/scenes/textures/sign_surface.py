"""Faces of traffic signs."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from training.scenes.arrays import Floats
from training.scenes.textures.noise import hash01
from training.scenes.textures.paint import band
from training.scenes.textures.surface import Points, Surface, matt, mix


def texture_sign(p: Points) -> Surface:
    """Faces of traffic signs; texture is the face, -1..1 both ways."""
    a, b = p.texture[:, 0], p.texture[:, 1]
    kind = np.rint(p.params[:, 0]).astype(int)
    reach = np.hypot(a, b)
    f = p.footprint / 0.38
    white, red = (0.75, 0.75, 0.73), (0.55, 0.02, 0.02)
    blue, yellow, green = (0.02, 0.1, 0.42), (0.75, 0.5, 0.02), (0.01, 0.2, 0.1)
    black = (0.02, 0.02, 0.02)
    out = np.tile(np.asarray(white, dtype=np.float32), (len(a), 1))

    def lay(which: NDArray[np.bool_], cover: Floats, color: Sequence[float]) -> None:
        rows = np.flatnonzero(which)
        out[rows] = mix(out[rows], color, cover[rows])

    ones = np.ones_like(a)
    glyph = band(np.abs(a) - 0.2, 0.12, f) * band(b, 0.32, f)
    bar = band(a, 0.11, f) * band(b - 0.02, 0.38, f)
    lay(kind == 0, 1 - band(reach, 0.72, f), red)
    lay(kind == 0, glyph, black)
    low = (b + 0.8) / 1.75  # 0 at the base of a triangle, 1 at its tip
    rim = np.minimum(low - 0.12, (1 - low) * 0.9 - np.abs(a) - 0.22) / np.maximum(f, 0.02)
    lay(kind == 1, 1 - np.clip(rim + 0.5, 0, 1), red)
    lay(kind == 1, band(a, 0.08, f) * band(b + 0.15, 0.3, f), black)
    high = (0.95 - (b + 0.15)) / 1.75
    inner = np.minimum(high - 0.12, (1 - high) * 0.9 - np.abs(a) - 0.22) / np.maximum(f, 0.02)
    lay(kind == 7, 1 - np.clip(inner + 0.5, 0, 1), red)
    lay(kind == 2, ones, blue)
    lay(kind == 2, bar + band(np.abs(a) - (0.5 - b) * 0.8, 0.1, f) * (b > 0.05) * (b < 0.5), white)
    lay(kind == 3, ones, red)
    lay(kind == 3, band(a, 0.68, f) * band(b, 0.17, f), white)
    lay(kind == 4, band(np.abs(a) + np.abs(b), 0.72, f), yellow)
    lot = p.params[:, 1:2]
    board = np.where(lot < 0.4, blue, np.where(lot < 0.7, green, yellow)).astype(np.float32)
    rows = np.flatnonzero(kind == 5)
    edge = band(a, 0.96, f) * band(b, 0.93, f)
    out[rows] = mix(out[rows], board[rows], edge[rows])
    line = np.floor((b + 1) * 2.2)
    word = hash01(np.floor(a * 9), line, 6) < 0.7
    text = band(np.mod((b + 1) * 2.2, 1) - 0.5, 0.24, f * 2.2) * word * (np.abs(a) < 0.8)
    text *= band(np.mod(a * 9, 1) - 0.5, 0.34, f * 9)
    lay((kind == 5) & (p.params[:, 1] < 0.7), text * 0.9, white)
    lay((kind == 5) & (p.params[:, 1] >= 0.7), text * 0.9, black)
    lay(kind == 6, band(a, 0.92, f) * band(b, 0.92, f), blue)
    lay(kind == 6, bar + band(a - 0.15, 0.22, f) * band(b - 0.2, 0.2, f), white)
    lay(kind == 9, (1 - band(a, 0.93, f) * band(b, 0.85, f)) + text, black)
    return matt(out, 0.03)
