"""Seeded lattice noise and hashes: the raw material of every procedural texture."""

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
