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
            sparse_depth: float32 (H, W), metres up to 100, 0 = no measurement; there is at least
                one.

        Returns:
            float32 (H, W), metres; 0 where the method gives no depth.
        """
