"""An item of a data set: one frame with everything that is known about it."""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from runtime.contract.contract import NO_CLASS
from runtime.contract.heads import HEADS, ResizeRule
from runtime.geometry.calibration import Calibration
from runtime.streams.frame import Frame
from runtime.streams.messages import Depth, Image


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
    "road_mask": TargetKind(np.dtype(np.uint8), NO_CLASS, "nearest")
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
    """A frame as its sensors measured it, and what is known to be true of it.

    The frame is the engine's, but its returns are always a depth map in the image, and not a scan:
    whatever changes the pixels of a sample moves its returns with them. For the same reason the
    calibration of a changed frame holds intrinsics alone. Samples are arrays; `Batch` makes tensors
    of them.

    Attributes:
        frame: image, returns and calibration; H and W are the sides of its image. The depth is None
            if the frame has no returns. Its name is that of the set and of the frame.
        targets: ground truth (H, W) by head or auxiliary target, see `target_kind`; "semantic"
            holds class ids, "depth" metres. Targets that the set lacks are missing.
        scan_line: int16 (H, W), the LiDAR scan line that measured each return, -1 = none. None if
            no lines are known.
        weights: weight of each target in the loss, below 1 for labels that a network made; 1 if it
            is not here.
        lacking: ids of classes that the image may show and the labels never have.
        focal_baseline_px_m: focal length times stereo baseline [px m] if depth was measured as
            disparity; d = this / depth, in pixels of the data set's images at their original size.
        place: which of the set's places the frame shows; None if the set does not know.
    """

    frame: Frame
    targets: Mapping[str, NDArray[Any]]
    scan_line: NDArray[np.int16] | None = None
    weights: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    lacking: tuple[int, ...] = ()
    focal_baseline_px_m: float | None = None
    place: str | None = None

    @property
    def is_scan(self) -> bool:
        """Whether some of the returns are the input, and the others are the target.

        It is so for returns of known scan lines without a depth target beside them.
        """
        has_lines = self.frame.depth is not None and self.scan_line is not None
        return has_lines and "depth" not in self.targets

    @property
    def known(self) -> tuple[str, ...]:
        """The names of the targets, with the depth of a scan."""
        return ("depth", *self.targets) if self.is_scan else tuple(self.targets)

    def target(self, name: str) -> NDArray[Any]:
        """Return the labels of a target, (H, W); if the set lacks them, all are unlabelled."""
        if name in self.targets:
            return self.targets[name]
        if name == "depth" and self.is_scan:
            return self.frame.sparse_depth
        kind = target_kind(name)
        return np.full(self.size, kind.unlabelled, dtype=kind.dtype)

    def with_targets(self, **targets: NDArray[Any]) -> "Sample":
        """Return the frame with other labels of some targets."""
        return replace(self, targets={**self.targets, **targets})

    def with_returns(self, returns: NDArray[np.float32] | None) -> "Sample":
        """Return the frame with other returns, float32 (H, W) [m], 0 = none."""
        depth = None if returns is None else Depth(returns)
        return replace(self, frame=replace(self.frame, depth=depth))

    def with_image(self, rgb: NDArray[np.uint8]) -> "Sample":
        """Return the frame with another image, uint8 (H, W, 3), RGB."""
        return replace(self, frame=replace(self.frame, image=Image(rgb)))

    @property
    def name(self) -> str:
        """Name of the set and the frame, for messages."""
        return self.frame.name

    @property
    def rgb(self) -> NDArray[np.uint8]:
        """The image, uint8 (H, W, 3), RGB."""
        return self.frame.rgb

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the image."""
        return self.frame.size

    @property
    def returns(self) -> NDArray[np.float32] | None:
        """The returns, float32 (H, W), metres along the optical axis, 0 = none; None: no LiDAR."""
        return None if self.frame.depth is None else self.frame.sparse_depth

    @property
    def depth(self) -> NDArray[np.float32]:
        """The depth target, or the returns of a scan: float32 (H, W), metres; 0 = unknown."""
        return self.target("depth")

    @property
    def semantic(self) -> NDArray[np.uint8]:
        """The class ids, uint8 (H, W); 255 = unknown."""
        return self.target("semantic")

    @property
    def intrinsics(self) -> NDArray[np.float64] | None:
        """The camera's intrinsics, float64 (3, 3), pixels; None if unknown."""
        return None if self.frame.calibration is None else self.frame.calibration.intrinsics

    @property
    def focal_length_px(self) -> float | None:
        """Focal length fx [px]; None if the intrinsics are unknown."""
        return None if self.frame.calibration is None else self.frame.calibration.focal_length_px


_UNIT_CAMERA = Calibration(np.eye(3), np.eye(4))


def make_frame(
    rgb: NDArray[np.uint8],
    name: str,
    *,
    returns: NDArray[np.float32] | None = None,
    intrinsics: NDArray[np.float64] | None = None,
) -> Frame:
    """Return the frame of an image with its returns as a depth map, see `Sample`.

    Args:
        rgb: uint8 (H, W, 3), RGB.
        name: name of the set and the frame.
        returns: float32 (H, W), metres along the optical axis, 0 = none; None: no LiDAR.
        intrinsics: float64 (3, 3), pixels; None if unknown.
    """
    depth = None if returns is None else Depth(returns)
    calibration = None
    if intrinsics is not None:
        # Each change of a sample makes a frame, and a new Calibration, which checks its matrices,
        # would take a large part of that time.
        calibration = copy.copy(_UNIT_CAMERA)
        object.__setattr__(calibration, "intrinsics", intrinsics)
    return Frame(Image(rgb), depth, calibration=calibration, name=name)


class SampleSource(Protocol):
    """A data set: a length, and samples by index."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> Sample: ...


class ChangedSource:
    """Base of the data sets that give the frames of another one, `source`.

    Attributes:
        images: see `FrameList.images`; a set of another kind may have none.
    """

    def __init__(self, source: SampleSource) -> None:
        self._source = source
        self.images: Sequence[Path] = getattr(source, "images", ())

    def __len__(self) -> int:
        return len(self._source)


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
