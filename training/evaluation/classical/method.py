"""The protocol of depth completion methods."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Depth = NDArray[np.float32]


class CompletionMethod(Protocol):
    """A method of depth completion: a frozen dataclass of its settings with one function."""

    def complete(self, rgb: NDArray[np.uint8], sparse_depth: Depth) -> Depth:
        """Complete the depth of one frame; the inputs are neither written to nor returned.

        Args:
            rgb: uint8 (H, W, 3), red first; not every method uses it.
            sparse_depth: float32 (H, W), metres; 0, negative and not finite values are no
                measurement.

        Returns:
            float32 (H, W), metres; 0 where the method gives no depth, which is everywhere if there
            is no measurement.
        """


def is_measured(sparse_depth: Depth) -> NDArray[np.bool_]:
    """Return where `sparse_depth` holds a measurement, bool (H, W).

    There is no upper limit here, because `ssdnet-eval` drops returns beyond 100 m, the range in
    which classical methods are scored, before it calls a method.
    """
    return np.asarray((sparse_depth > 0) & np.isfinite(sparse_depth))
