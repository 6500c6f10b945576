"""How well an uncertainty of depth ranks the errors, and how well it covers them."""

import numpy as np
from numpy.typing import NDArray

from training.scores.metrics import Accumulator, DepthErrors

# Shares of a Laplace distribution within one and two of its scales b: 1 - exp(-1), 1 - exp(-2).
LAPLACE_COVERAGE = (0.632, 0.865)

# Shares of the pixels, the most confident ones, whose error is reported.
SHARES = (0.5, 0.8, 1.0)

# Bins of the uncertainty, equal in its logarithm; neighbours differ by 0.3 %.
_LOWEST_M, _HIGHEST_M, _BINS = 1e-3, 1e3, 4096


class UncertaintyScores(Accumulator):
    """Error of the most confident shares of the pixels of all frames together, and coverage.

    The pixels of all frames are ranked together with a
    histogram of `_BINS` bins over the logarithm of the uncertainty, so that memory is bounded. If a
    share ends within a bin, a part of the bin is taken, as if its pixels had equal errors.
    """

    def __init__(self) -> None:
        # The columns are number of pixels and sum |e|.
        self._bins = np.zeros((_BINS, 2))
        self._within = np.zeros(2)  # pixels whose error is at most one and two scales

    def update(self, uncertainty: NDArray[np.floating], errors: DepthErrors) -> None:
        """Count a frame by the scale of its Laplace distributions, float (H, W) [m], and errors."""
        scale, error = uncertainty[errors.known].astype(np.float64), np.abs(errors.error)
        place = np.log(np.clip(scale, _LOWEST_M, _HIGHEST_M) / _LOWEST_M)
        index = (place / np.log(_HIGHEST_M / _LOWEST_M) * (_BINS - 1)).astype(np.intp)
        self._bins[:, 0] += np.bincount(index, minlength=_BINS)
        self._bins[:, 1] += np.bincount(index, weights=error, minlength=_BINS)
        self._within += [(error <= factor * scale).sum() for factor in (1, 2)]

    def reliability(self, groups: int = 10) -> list[tuple[float, float]]:
        """Return mean scale and mean |error| [m] of pixels in groups of equal number, by scale.

        The mean |error| of a Laplace distribution is its scale.
        """
        pixels = self._bins[:, 0].sum()
        if not pixels:
            return []
        middles = np.geomspace(_LOWEST_M, _HIGHEST_M, _BINS)
        sums = np.stack([self._bins[:, 0], self._bins[:, 0] * middles, self._bins[:, 1]])
        counts, scales, errors = np.pad(sums, ((0, 0), (1, 0))).cumsum(axis=1)
        at = np.linspace(0, pixels, groups + 1)
        means = (np.diff(np.interp(at, counts, each)) for each in (scales, errors))
        scale, error = (each * groups / pixels for each in means)
        return list(zip(scale.tolist(), error.tolist(), strict=True))

    def figures(self) -> dict[str, float]:
        """Return the errors [m] of the confident pixels, and the coverage of the errors.

        coverage_1 and coverage_2 are the shares within one and two scales, see `LAPLACE_COVERAGE`.
        """
        pixels = self._bins[:, 0].sum()
        if not pixels:
            return {}
        counts, errors = np.vstack([np.zeros(2), self._bins.cumsum(axis=0)]).T
        figures = {
            f"mae_m_confident_{100 * share:.0f}": float(
                np.interp(share * pixels, counts, errors) / (share * pixels)
            )
            for share in SHARES
        }
        within = (self._within / pixels).tolist()
        return figures | dict(zip(("coverage_1", "coverage_2"), within, strict=True))
