"""An item of a data set: one frame with all that is known about it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from runtime.contract.heads import HEADS, ResizeRule

IGNORE = 255


class TargetKind(NamedTuple):
    """How a map of labels is stored."""

    #: Of its values.
    dtype: np.dtype[Any]
    #: The value of a pixel without a label.
    unlabelled: float
    #: Rule where it is resized, see `runtime.contract.heads`.
    resize: ResizeRule


#: Auxiliary targets, which no head predicts. road_mask: 0 = not road, 1 = road, drawn by hand.
AUXILIARY: Mapping[str, TargetKind] = {
    "road_mask": TargetKind(np.dtype(np.uint8), IGNORE, "nearest")
}


def target_kind(name: str) -> TargetKind:
    """Return how a target is stored: a head's by its row in `HEADS`, or an auxiliary one.

    Raises:
        ValueError: for another name.
    """
    if name in AUXILIARY:
        return AUXILIARY[name]
    if name not in HEADS:
        raise ValueError(f"no head and no target is called {name!r}")
    head = HEADS[name]
    return TargetKind(np.dtype(head.dtype), head.unlabelled, head.resize)


@dataclass(frozen=True)
class Sample:
    """One frame; H and W are the image's."""

    #: uint8 (H, W, 3), RGB.
    rgb: NDArray[np.uint8]
    #: Ground truth: head or auxiliary target -> labels (H, W), see `target_kind`. "semantic"
    #: holds class ids, "depth" metres. A target that a set lacks is not there.
    targets: Mapping[str, NDArray[Any]]
    #: float64 (3, 3), pixels; None if unknown.
    intrinsics: NDArray[np.float64] | None
    #: Set and frame, for messages.
    name: str
    #: float32 (H, W), metres along the optical axis, the network's input; 0 = no measurement. From
    #: a data set it is an input recorded in addition to the depth, which can be thinned; None: the
    #: input is sampled from the depth.
    sparse_depth: NDArray[np.float32] | None = None
    #: int16 (H, W), the LiDAR scan line that measured each pixel, -1 = none: of `sparse_depth`,
    #: or, where that is None, of the depth. None where no lines are known.
    scan_line: NDArray[np.int16] | None = None
    #: Target -> its weight in the loss, below 1 for labels made by a network; 1 where none is here.
    weights: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    #: Focal length times stereo baseline [px m] if depth was measured as disparity: d = this /
    #: depth, in pixels of the data set's images at their original size.
    focal_baseline_px_m: float | None = None
    #: Which of the set's places the frame shows; None where the set does not know.
    place: str | None = None

    def target(self, name: str) -> NDArray[Any]:
        """Return the labels of a target, (H, W), unlabelled everywhere if the set lacks them."""
        if name in self.targets:
            return self.targets[name]
        kind = target_kind(name)
        return np.full(self.size, kind.unlabelled, dtype=kind.dtype)

    def with_targets(self, **targets: NDArray[Any]) -> "Sample":
        """Return the frame with other labels of some targets."""
        return replace(self, targets={**self.targets, **targets})

    @property
    def depth(self) -> NDArray[np.float32]:
        """float32 (H, W), metres, from which LiDAR inputs are drawn; 0 = unknown (sky too)."""
        return self.target("depth")

    @property
    def semantic(self) -> NDArray[np.uint8]:
        """uint8 (H, W), class ids; 255 = unknown."""
        return self.target("semantic")

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


class FrameList:
    """The length of a data set that lists its frames.

    Attributes:
        images: the file of each frame's image, which tells whether two sets share frames.
    """

    _frames: Sequence[Any]
    images: Sequence[Path] = ()

    def __len__(self) -> int:
        return len(self._frames)


def nothing_known(size: tuple[int, int]) -> NDArray[np.float32]:
    """Return a depth map without any measurement: float32 (height, width) of zeros."""
    return np.zeros(size, dtype=np.float32)
