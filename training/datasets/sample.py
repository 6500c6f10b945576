"""An item of a data set: one frame with everything that is known about it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from runtime.contract.contract import NO_CLASS
from runtime.contract.heads import HEADS, ResizeRule

IGNORE = NO_CLASS


class TargetKind(NamedTuple):
    """How a map of labels is stored.

    Attributes:
        dtype: type of its values.
        unlabelled: value of a pixel without a label.
        resize: rule by which it is resized, see `runtime.contract.heads`.
    """

    dtype: np.dtype[Any]
    unlabelled: float
    resize: ResizeRule


# Auxiliary targets, which no head predicts. road_mask is drawn by hand: 0 = not road, 1 = road.
AUXILIARY: Mapping[str, TargetKind] = {
    "road_mask": TargetKind(np.dtype(np.uint8), IGNORE, "nearest")
}


def target_kind(name: str) -> TargetKind:
    """Return how a target is stored: a head's according to `HEADS`, or an auxiliary one's.

    Raises:
        ValueError: if the name is unknown.
    """
    if name in AUXILIARY:
        return AUXILIARY[name]
    if name not in HEADS:
        raise ValueError(f"no head and no target is called {name!r}")
    head = HEADS[name]
    return TargetKind(np.dtype(head.dtype), head.unlabelled, head.resize)


def labelled(name: str, values: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which pixels of a target have a label; NaN is none in any target."""
    known: NDArray[np.bool_] = values != target_kind(name).unlabelled
    return known & (values == values) if values.dtype.kind == "f" else known


@dataclass(frozen=True)
class Sample:
    """One frame; H and W are the sides of its image.

    Attributes:
        rgb: uint8 (H, W, 3), RGB.
        targets: ground truth (H, W) by head or auxiliary target, see `target_kind`; "semantic"
            holds class ids, "depth" metres. Targets that the set lacks are missing.
        intrinsics: float64 (3, 3), pixels; None if unknown.
        name: name of the set and the frame, for messages.
        sparse_depth: input of the network, float32 (H, W), metres along the optical axis, 0 = no
            measurement. A data set fills it with an input that was recorded in addition to the
            depth, which can be thinned; None: the input is sampled from the depth.
        scan_line: int16 (H, W), the LiDAR scan line that measured each pixel of `sparse_depth` or,
            if that is None, of the depth; -1 = none. None if no lines are known.
        weights: weight of each target in the loss, below 1 for labels that a network made; 1 if it
            is not here.
        focal_baseline_px_m: focal length times stereo baseline [px m] if depth was measured as
            disparity; d = this / depth, in pixels of the data set's images at their original size.
        place: which of the set's places the frame shows; None if the set does not know.
    """

    rgb: NDArray[np.uint8]
    targets: Mapping[str, NDArray[Any]]
    intrinsics: NDArray[np.float64] | None
    name: str
    sparse_depth: NDArray[np.float32] | None = None
    scan_line: NDArray[np.int16] | None = None
    weights: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    focal_baseline_px_m: float | None = None
    place: str | None = None

    def target(self, name: str) -> NDArray[Any]:
        """Return the labels of a target, (H, W); if the set lacks them, all are unlabelled."""
        if name in self.targets:
            return self.targets[name]
        kind = target_kind(name)
        return np.full(self.size, kind.unlabelled, dtype=kind.dtype)

    def with_targets(self, **targets: NDArray[Any]) -> "Sample":
        """Return the frame with other labels of some targets."""
        return replace(self, targets={**self.targets, **targets})

    @property
    def depth(self) -> NDArray[np.float32]:
        """The depth from which LiDAR inputs are drawn, float32 (H, W), metres; 0 = unknown."""
        return self.target("depth")

    @property
    def semantic(self) -> NDArray[np.uint8]:
        """The class ids, uint8 (H, W); 255 = unknown."""
        return self.target("semantic")

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the image."""
        return self.rgb.shape[0], self.rgb.shape[1]

    @property
    def focal_length_px(self) -> float | None:
        """Focal length fx [px]; None if the intrinsics are unknown."""
        return None if self.intrinsics is None else float(self.intrinsics[0, 0])


class SampleSource(Protocol):
    """A data set: a length, and samples by index."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> Sample: ...


class FrameList:
    """The length of a data set that lists its frames.

    Attributes:
        images: the image file of each frame, which shows whether two sets share frames.
    """

    _frames: Sequence[Any]
    images: Sequence[Path] = ()

    def __len__(self) -> int:
        return len(self._frames)


def nothing_known(size: tuple[int, int]) -> NDArray[np.float32]:
    """Return a depth map without any measurement: float32 (height, width) of zeros."""
    return np.zeros(size, dtype=np.float32)
