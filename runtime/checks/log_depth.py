"""The comparison of two depths by their logarithms, which several checks share.

The logarithms of a measured and a predicted depth of the same scene correlate, also if one of them
has a wrong unit.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

BANDS = 48  # bands of rows over the height of the image
_LEAST_DEPTH_M = 1e-3  # smaller depths, such as 0, count as this

Floats = NDArray[np.floating[Any]]


def log_depth(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Logarithm of a predicted or measured depth in metres, float32 of the same shape."""
    return np.asarray(np.log(np.maximum(depth, np.float32(_LEAST_DEPTH_M))))


def correlation(first: Floats, second: Floats) -> float:
    """Pearson's correlation; 0 if an array is constant."""
    first, second = (each - each.mean() for each in (first.astype(float), second.astype(float)))
    spread = float(np.sqrt((first @ first) * (second @ second)))
    return float(first @ second) / spread if spread > 1e-6 else 0.0


def correlations(band: NDArray[np.intp], measured: Floats, seen: Floats) -> tuple[float, float]:
    """Correlation of two log depths, as they are and without the mean of each band of rows."""
    in_bands = correlation(subtract_band_means(band, measured), subtract_band_means(band, seen))
    return correlation(measured, seen), in_bands


def subtract_band_means(band: NDArray[np.intp], values: Floats) -> NDArray[np.float64]:
    """The values minus the mean of their band of rows."""
    count = np.maximum(np.bincount(band, minlength=BANDS), 1)
    return np.asarray(values - (np.bincount(band, values, BANDS) / count)[band])
