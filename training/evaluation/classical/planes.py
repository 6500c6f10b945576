"""Planes fitted to the returns around each cell: the depth that follows from returns alone."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from training.evaluation.classical.method import Depth


@dataclass(frozen=True)
class Planes:
    """Planes through the returns that lie on them, see `models.planes`: the base of ssdnet.

    They are exact on planes, whatever the pattern of the returns, in between the returns. Each
    return keeps its depth. The image is not used. A pixel without any return within 190 px has no
    depth.
    """

    def complete(self, rgb: NDArray[np.uint8], sparse_depth: Depth) -> Depth:
        """See `CompletionMethod.complete`."""
        import torch

        from models.blocks import pad_to_multiple, upsample
        from models.planes import BASE_CELL, CELL, LEVELS, fit_base
        from models.pooling import cell_maxima

        measured = sparse_depth > 0
        known = np.where(measured, sparse_depth, np.float32(np.inf))
        farthest = sparse_depth[measured].max()  # the unit; inverse depths are at least 1
        inverse = torch.from_numpy(farthest / known)[None, None]
        mask = torch.from_numpy(measured.astype(np.float32))[None, None]
        with torch.inference_mode():
            inverse, mask = (pad_to_multiple(x, CELL * 2**LEVELS) for x in (inverse, mask))
            both = torch.cat([inverse, mask / inverse.clamp(min=1.0)], dim=1)
            plane, base, _ = fit_base(inverse, mask, cell_maxima(both, CELL))
            # Cells without a plane do not contribute to the mean.
            reached = upsample((plane > 0).to(plane.dtype), factor=CELL // BASE_CELL)
            maps = upsample(torch.cat([base, reached.clamp(min=1e-6)], dim=1), factor=BASE_CELL)
            height, width = sparse_depth.shape
            above, below = maps[0, :, :height, :width].numpy()
        depth = np.where(above > 0, farthest * below / np.where(above > 0, above, 1.0), 0.0)
        return np.where(measured, sparse_depth, depth).astype(np.float32)
