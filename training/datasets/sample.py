"""An item of a data set: one frame with all that is known about it."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

IGNORE = 255


@dataclass(frozen=True)
class Sample:
    """One frame; H and W are the image's. A target that a set lacks is unknown everywhere."""

    #: uint8 (H, W, 3), RGB.
    rgb: NDArray[np.uint8]
    #: float32 (H, W), metres, the depth target; 0 = unknown (sky too).
    depth: NDArray[np.float32]
    #: uint8 (H, W), class ids, the semantic target; 255 = unknown.
    semantic: NDArray[np.uint8]
    #: float64 (3, 3), pixels; None if unknown.
    intrinsics: NDArray[np.float64] | None
    #: Set and frame, for messages.
    name: str
    #: float32 (H, W), metres along the optical axis, the network's input; 0 = no measurement. From
    #: a data set it is an input recorded in addition to ``depth``, which can be thinned; None: the
    #: input is sampled from ``depth``.
    sparse_depth: NDArray[np.float32] | None = None
    #: int16 (H, W), the LiDAR scan line that measured each pixel, -1 = none: of ``sparse_depth``,
    #: or, where that is None, of ``depth``. None where no lines are known.
    scan_line: NDArray[np.int16] | None = None
    #: Weight of the semantic target in the loss, below 1 for labels made by a network.
    semantic_weight: float = 1.0
    #: Focal length times stereo baseline [px m] if depth was measured as disparity: d = this /
    #: depth, in pixels of the data set's images at their original size.
    focal_baseline_px_m: float | None = None
    #: uint8 (H, W), a hand-drawn mask of the road: 0 = not road, 1 = road, 255 = unknown. None
    #: if the data set has none.
    road_mask: NDArray[np.uint8] | None = None
    #: Which of the set's places the frame shows; None where the set does not know.
    place: str | None = None

    @property
    def size(self) -> tuple[int, int]:
        """(height, width)."""
        return self.rgb.shape[0], self.rgb.shape[1]

    @property
    def focal_length_px(self) -> float | None:
        """Focal length fx [px]; None without intrinsics."""
        return None if self.intrinsics is None else float(self.intrinsics[0, 0])


class SampleSource(Protocol):
    """A data set: a length and samples by index."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> Sample: ...


def nothing_known(size: tuple[int, int]) -> NDArray[np.float32]:
    """Return a depth map without any measurement: float32 (height, width) of zeros."""
    return np.zeros(size, dtype=np.float32)
