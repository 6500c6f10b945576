"""How well an uncertainty of depth ranks the errors, and how well it covers them."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from training.evaluation.metrics import Accumulator, scored

#: Shares of a Laplace distribution within one and two of its scales b: 1 - exp(-1), 1 - exp(-2).
LAPLACE_COVERAGE = (0.632, 0.865)

#: Shares of the pixels, the most confident, whose error is reported.
SHARES = (0.5, 0.8, 1.0)

# Bins of the uncertainty, equal in its logarithm: neighbours differ by 0.3 %.
_LOWEST_M, _HIGHEST_M, _BINS = 1e-3, 1e3, 4096


@dataclass(frozen=True)
class UncertaintyMetrics:
    """How well an uncertainty fits the errors.

    Attributes:
        confident_mae_m: share of the pixels, those of the least uncertainty -> their mean absolute
            error [m].
        coverage_1: share of the errors of at most one scale, see `LAPLACE_COVERAGE`.
        coverage_2: share of the errors of at most two scales.
    """

    pixels: int
    confident_mae_m: Mapping[float, float]
    coverage_1: float
    coverage_2: float


class UncertaintyScores(Accumulator):
    """Error of the most confident shares of the pixels of all frames together, and coverage.

    Over the same pixels as `DepthScores`. The pixels of all frames are ranked together by a
    histogram of `_BINS` bins over the logarithm of the uncertainty, so that memory is bounded. Of
    the bin in which a share ends, a part is taken, as if its pixels had equal errors.
    """

    def __init__(self) -> None:
        # Columns: pixels, sum |e|.
        self._bins = np.zeros((_BINS, 2))
        self._within = np.zeros(2)  # pixels whose error is at most one and two scales

    def update(
        self,
        uncertainty: NDArray[np.floating],
        prediction: NDArray[np.floating],
        depth: NDArray[np.floating],
    ) -> None:
        """Count a frame.

        Args:
            uncertainty: scale of a Laplace distribution around the prediction, float (H, W) [m].
            prediction: float (H, W) [m].
            depth: the true depth, float (H, W) [m]; 0, negative or not finite = unknown.
        """
        known = scored(depth)
        scale = uncertainty[known].astype(np.float64)
        error = np.abs(prediction[known].astype(np.float64) - depth[known])
        place = np.log(np.clip(scale, _LOWEST_M, _HIGHEST_M) / _LOWEST_M)
        index = (place / np.log(_HIGHEST_M / _LOWEST_M) * (_BINS - 1)).astype(np.intp)
        self._bins[:, 0] += np.bincount(index, minlength=_BINS)
        self._bins[:, 1] += np.bincount(index, weights=error, minlength=_BINS)
        self._within += [(error <= factor * scale).sum() for factor in (1, 2)]

    def compute(self) -> UncertaintyMetrics:
        """Return the metrics of all frames so far; NaN without any pixel."""
        pixels = float(self._bins[:, 0].sum())
        if not pixels:
            nan = float("nan")
            return UncertaintyMetrics(0, dict.fromkeys(SHARES, nan), nan, nan)
        counts, errors = np.vstack([np.zeros(2), self._bins.cumsum(axis=0)]).T
        confident = {
            share: float(np.interp(share * pixels, counts, errors) / (share * pixels))
            for share in SHARES
        }
        return UncertaintyMetrics(int(pixels), confident, *(self._within / pixels).tolist())
