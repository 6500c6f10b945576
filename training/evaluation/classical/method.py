"""What every method of depth completion is."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Depth = NDArray[np.float32]


class CompletionMethod(Protocol):
    """A method with its settings, one verb."""

    def complete(self, rgb: NDArray[np.uint8], sparse_depth: Depth) -> Depth:
        """Complete one frame; nothing of the inputs is written to or given back.

        rgb: uint8 (H, W, 3), red first; not every method looks at it
        sparse_depth: float32 (H, W) [m]; 0, negative and not finite = no measurement
        Returns float32 (H, W) [m], 0 where the method gives no depth: everywhere without any
        measurement.
        """


def is_measured(sparse_depth: Depth) -> NDArray[np.bool_]:
    """Whether a pixel of `sparse_depth` holds a depth."""
    return np.asarray((sparse_depth > 0) & np.isfinite(sparse_depth))
