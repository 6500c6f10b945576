"""Linear interpolation of inverse depth: exact on planes, the reference for learned methods."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from training.evaluation.classical.method import Depth
from training.evaluation.classical.nearest import Nearest

# Number of returns that span a triangle.
_FEWEST = 3


@dataclass(frozen=True)
class Linear:
    """Inverse depth interpolated linearly on SciPy's Delaunay triangulation of the returns.

    In inverse depth a plane is an affine function of the pixel, so planes are exact. Outside the
    triangles, and if all returns lie on one line, `Nearest` fills. The image is not used.
    """

    def complete(self, rgb: NDArray[np.uint8], sparse_depth: Depth) -> Depth:
        """See `CompletionMethod.complete`."""
        from scipy.interpolate import LinearNDInterpolator

        depth = Nearest().complete(rgb, sparse_depth)
        at = np.argwhere(sparse_depth > 0)
        if len(at) < _FEWEST or np.linalg.matrix_rank(at - at[0]) < 2:
            return depth
        inverse = 1.0 / sparse_depth[at[:, 0], at[:, 1]].astype(np.float64)
        pixels = tuple(np.indices(sparse_depth.shape))
        found = LinearNDInterpolator(at, inverse)(pixels)
        return np.where(np.isnan(found), depth, 1.0 / found).astype(np.float32)
