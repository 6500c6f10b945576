"""Completion by a Markov random field whose smoothness depends on the colours.

Diebel and Thrun, "An Application of Markov Random Fields to Range Sensing", NIPS 2005. The most
probable depth y minimises

    data_weight * sum over returns (y - depth)^2 + sum over neighbours w (y_i - y_j)^2

over the four-neighbourhood, with w = exp(-edge_sharpness * |x_i - x_j|^2) of colours x in 0..1.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from training.evaluation.classical.method import Depth

# Least weight of neighbours; with exp() of very different colours a region would be isolated.
_LEAST_WEIGHT = 1e-4


@dataclass(frozen=True)
class MRF:
    """The Markov random field, solved directly as a sparse linear system with SciPy.

    The paper iterates by conjugate gradients; the direct solution is the same minimum without a
    tolerance. It takes seconds and about 1.3 GB per megapixel. Each depth is a weighted mean of
    returns, so it lies between the smallest and the largest return. A single return fills the
    frame.

    Attributes:
        data_weight: k of the paper; the weights of neighbours are at most 1.
        edge_sharpness: c of the paper; 1000 halves a weight at 7 grey values of one colour.
    """

    data_weight: float = 10.0
    edge_sharpness: float = 1000.0

    def complete(self, rgb: NDArray[np.uint8], sparse_depth: Depth) -> Depth:
        """See `CompletionMethod.complete`."""
        from scipy import sparse
        from scipy.sparse import linalg

        measured = sparse_depth > 0
        count = sparse_depth.size
        first, second, weight = neighbours(rgb, self.edge_sharpness)
        coupling = sparse.coo_array((weight, (first, second)), shape=(count, count))
        data_term = self.data_weight * measured.ravel()
        diagonal = (
            data_term + np.bincount(first, weight, count) + np.bincount(second, weight, count)
        )
        system = sparse.diags_array(diagonal) - coupling - coupling.T
        right_side = data_term * np.where(measured, sparse_depth, 0).ravel()
        # This ordering, for symmetric patterns, needs half the memory of the default.
        solution = linalg.spsolve(system.tocsc(), right_side, permc_spec="MMD_AT_PLUS_A")
        depth: Depth = solution.reshape(sparse_depth.shape).astype(np.float32)
        return depth


def neighbours(
    rgb: NDArray[np.uint8], edge_sharpness: float
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float64]]:
    """Return each pair of neighbouring pixels once: both indices and the weight, (P,) each."""
    height, width = rgb.shape[:2]
    index = np.arange(height * width, dtype=np.int32).reshape(height, width)
    colors = rgb.astype(np.float64) / 255
    squared = [np.square(np.diff(colors, axis=axis)).sum(axis=-1).ravel() for axis in (1, 0)]
    weight = np.maximum(np.exp(-edge_sharpness * np.concatenate(squared)), _LEAST_WEIGHT)
    first = np.concatenate([index[:, :-1].ravel(), index[:-1].ravel()])
    second = np.concatenate([index[:, 1:].ravel(), index[1:].ravel()])
    return first, second, weight
