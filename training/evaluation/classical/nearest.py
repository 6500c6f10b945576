"""Nearest-neighbour filling: the baseline that every other method must beat."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from training.evaluation.classical.method import Depth

_MASK_SIZE = 5


@dataclass(frozen=True)
class Nearest:
    """Each pixel takes the depth of the nearest return, with OpenCV's labelled distance transform.

    The distance is Euclidean, approximated by a chamfer mask of 5 x 5 (Borgefors 1986), so the
    return may be at most 5 % farther away than the nearest one. A single return fills the frame.
    The image is not used.
    """

    def complete(self, rgb: NDArray[np.uint8], sparse_depth: Depth) -> Depth:
        """See `CompletionMethod.complete`."""
        measured = sparse_depth > 0
        _, labels = cv2.distanceTransformWithLabels(
            (~measured).astype(np.uint8), cv2.DIST_L2, _MASK_SIZE, labelType=cv2.DIST_LABEL_PIXEL
        )
        depth_of_label = np.zeros(int(labels.max()) + 1, dtype=np.float32)
        depth_of_label[labels[measured]] = sparse_depth[measured]
        return np.asarray(depth_of_label[labels])
