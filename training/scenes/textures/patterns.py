"""The raw material of every texture: seeded noise and hashes, bands, and painted stripes.

Stripes are in street coordinates: lines, dashes, crossings and arrows.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from training.scenes.arrays import Floats

_TABLE = 256
_ROW = 1024


@lru_cache(maxsize=1)
def _table() -> Floats:
    table = np.random.default_rng(20240521).uniform(-1, 1, (_TABLE, _TABLE)).astype(np.float32)
    # One repeated row and column let bilinear reading wrap around.
    return np.pad(table, ((0, 2), (0, 2)), mode="wrap")


def value_noise(u: Floats, v: Floats) -> Floats:
    """Smooth noise in -1..1 with unit lattice, at points u, v of any equal shape."""
    n = u.size
    if not n:
        return np.zeros(u.shape, dtype=np.float32)
    rows = -(-n // _ROW)

    def places(values: Floats) -> Floats:
        padded = np.zeros(rows * _ROW, dtype=np.float32)
        padded[:n] = values.ravel()
        return np.mod(padded, _TABLE, out=padded).reshape(rows, _ROW)

    out = cv2.remap(_table(), places(u), places(v), interpolation=cv2.INTER_LINEAR)
    return out.reshape(-1)[:n].reshape(u.shape)


def fractal_noise(
    u: Floats, v: Floats, *, wavelength: float, octaves: int, footprint: Floats | None = None
) -> Floats:
    """Return the sum of octaves of `value_noise`, about -1..1.

    `wavelength` is that of the coarsest octave [m]. `footprint` is the width [m] that a pixel
    covers; finer octaves fade out, to avoid aliasing in distant textures.
    """
    total = np.zeros(u.shape, dtype=np.float32)
    amplitude, size = 0.55, wavelength
    for octave in range(octaves):
        layer = value_noise(u / np.float32(size) + 17.3 * octave, v / np.float32(size))
        if footprint is not None:
            layer *= np.clip(1.5 - 2.0 * footprint / size, 0.0, 1.0)
        total += amplitude * layer
        amplitude *= 0.6
        size *= 0.47
    return total


def hash01(*keys: Floats | int) -> Floats:
    """Return uniform numbers 0..1 from whole numbers as keys, the same for the same keys."""
    state: NDArray[np.uint32] = np.array(2166136261, dtype=np.uint32)
    with np.errstate(over="ignore"):
        for key in keys:
            k = np.asarray(key).astype(np.int64).astype(np.uint32)
            state = (state ^ k) * np.uint32(16777619)
            state = state ^ (state >> np.uint32(13))
            state = state * np.uint32(1274126177)
            state = state ^ (state >> np.uint32(16))
    return np.asarray(state.astype(np.float64) / 4294967296.0, dtype=np.float32)


@dataclass(frozen=True)
class Stripe:
    """One painted rectangle in street coordinates, possibly broken into dashes.

    With `along` "s" it runs with the street, with "d" across it. `centre` is its position on the
    other axis [m].
    """

    along: str
    centre: float
    half_width: float
    start: float
    end: float
    period: float = 0.0
    painted: float = 1.0
    color: tuple[float, float, float] = (0.62, 0.62, 0.6)


def paint_cover(
    stripe: Stripe, s: Floats, d: Floats, footprint_s: Floats, footprint_d: Floats
) -> Floats:
    """Return the share, 0..1, of each point's footprint that the stripe covers."""
    run, across, f_run, f_across = s, d, footprint_s, footprint_d
    if stripe.along == "d":
        run, across, f_run, f_across = d, s, footprint_d, footprint_s
    cover = band(across - np.float32(stripe.centre), stripe.half_width, f_across)
    middle, half = (stripe.start + stripe.end) / 2, (stripe.end - stripe.start) / 2
    cover = cover * band(run - np.float32(middle), half, f_run)
    if stripe.period > 0:
        cycle = np.mod(run - np.float32(stripe.start), stripe.period)
        dash = stripe.period * stripe.painted
        sharp = band(cycle - np.float32(dash / 2), dash / 2, f_run)
        blend = np.clip(f_run / stripe.period, 0, 1)
        cover = cover * (sharp * (1 - blend) + stripe.painted * blend)
    return cover


def band(x: Floats, half_width: float | Floats, footprint: Floats) -> Floats:
    """Return the share of a pixel of this footprint at x that is within -half_width..half_width."""
    width = np.maximum(footprint, 1e-3)
    high = np.minimum(x + width / 2, half_width)
    low = np.maximum(x - width / 2, -half_width)
    return np.clip((high - low) / width, 0.0, 1.0)
