"""Planes fitted to the returns around each cell: what the returns alone tell of depth."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from training.evaluation.classical.method import Depth, is_measured

#: Side of a cell in pixels, and how often the grid of cells is halved.
_CELL, _LEVELS = 4, 3


@dataclass(frozen=True)
class Planes:
    """Inverse depth by local least squares over a pyramid, see `models.planes`.

    Exact on planes, whatever the pattern of the returns, and bounded by the returns around. Each
    return keeps its depth. The image is not used; a pixel without any return within 190 px has no
    depth.
    """

    def complete(self, rgb: NDArray[np.uint8], sparse_depth: Depth) -> Depth:
        """See `CompletionMethod.complete`."""
        import torch

        from models.blocks import pad_to_multiple, upsample
        from models.planes import fit_planes
        from models.pooling import cell_maxima

        measured = is_measured(sparse_depth)
        if not measured.any():
            return np.zeros(sparse_depth.shape, dtype=np.float32)
        known = np.where(measured, sparse_depth, np.float32(np.inf))
        farthest = sparse_depth[measured].max()  # as the unit: inverse depths are at least 1
        inverse = torch.from_numpy(farthest / known)[None, None]
        mask = torch.from_numpy(measured.astype(np.float32))[None, None]
        with torch.inference_mode():
            inverse, mask = (pad_to_multiple(x, _CELL * 2**_LEVELS) for x in (inverse, mask))
            both = torch.cat([inverse, mask / inverse.clamp(min=1.0)], dim=1)
            extremes = cell_maxima(both, _CELL)
            cells, _ = fit_planes(inverse, mask, extremes, cell=_CELL, levels=_LEVELS)
            height, width = sparse_depth.shape
            # Cells without a plane have no share in the mean.
            reached = upsample((cells > 0).to(cells.dtype), factor=_CELL).clamp(min=1e-6)
            plane = (upsample(cells, factor=_CELL) / reached)[0, 0, :height, :width].numpy()
        depth = np.where(plane > 0, farthest / np.where(plane > 0, plane, 1.0), 0.0)
        return np.where(measured, sparse_depth, depth).astype(np.float32)
