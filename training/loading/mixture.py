"""From data sets to batches: frames are cached, drawn from a mixture and collated."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from models import NetworkOutput
from runtime.contract.contract import MAX_RETURN_M
from training.datasets.sample import Sample, SampleSource
from training.limits import PAIR_STEP_PX
from training.loading.augment import augment, take_views, with_margin
from training.loading.augment_config import AugmentConfig
from training.loading.depth_values import far_sky, scale_world


class CachedSource:
    """A data set that keeps decoded frames in memory, up to `limit_bytes`.

    No frame is replaced by another: passes over a shuffled set would drop each frame just before it
    is used again. Each worker process has its own cache.
    """

    def __init__(self, source: SampleSource, *, limit_bytes: int) -> None:
        self._source = source
        self._free = limit_bytes
        self._kept: dict[int, Sample] = {}

    def __len__(self) -> int:
        return len(self._source)

    def __getitem__(self, index: int) -> Sample:
        if index in self._kept:
            return self._kept[index]
        sample = self._source[index]
        size = _bytes_of(sample)
        if size <= self._free:
            self._free -= size
            self._kept[index] = sample
        return sample


def _bytes_of(sample: Sample) -> int:
    arrays = (sample.rgb, sample.returns, sample.scan_line, *sample.targets.values())
    return sum({id(array): array.nbytes for array in arrays if array is not None}.values())


class Pair(NamedTuple):
    """How the second view of each frame differs from the first.

    Attributes:
        offset: row and column of the second view's upper left corner in the first view, int64 (N,
            2).
        first_lidar: LiDAR input of the views, float32 (N, 1, H, W), metres, 0 = no return.
    """

    offset: Tensor
    first_lidar: Tensor
    second_lidar: Tensor


class Drawn(NamedTuple):
    """A frame that was drawn from the mixture of data sets, as one view or as two shifted views.

    Attributes:
        offset: (row, column) of the second view's upper left corner in the first view.
    """

    views: tuple[Sample, ...]
    offset: tuple[int, int] = (0, 0)


@dataclass(frozen=True)
class Batch:
    """Frames of one size; with two views, the first views of all frames, then the second views.

    Attributes:
        rgb: uint8 (N, 3, H, W), RGB.
        sparse_depth: float32 (N, 1, H, W), metres; 0 = no measurement.
        targets: labels (N, H, W) of each target, see `training.datasets.sample.target_kind`.
        weights: weight of each frame's labels in the loss, float32 (N,), by target.
        names: data set and name of each frame, for messages.
        pair: how second views differ; None: no frame has two views.
        teacher: output of the teacher; None: there is no teacher.
    """

    rgb: Tensor
    sparse_depth: Tensor
    targets: Mapping[str, Tensor]
    weights: Mapping[str, Tensor]
    names: Sequence[str]
    pair: Pair | None = None
    teacher: NetworkOutput | None = None

    @classmethod
    def collate(cls, drawn: Sequence[Drawn], targets: Collection[str]) -> Self:
        """Make a batch of drawn frames with these targets.

        A target that a frame lacks is unlabelled in all its pixels.
        """
        # The first views of all frames, then the second views.
        samples = [
            view for part in zip(*(item.views for item in drawn), strict=True) for view in part
        ]
        sparse_depth = torch.from_numpy(np.stack([view.returns for view in samples])[:, None])
        pair = None
        if len(samples) > len(drawn):
            pair = Pair(torch.tensor([item.offset for item in drawn]), *sparse_depth.chunk(2))
        return cls(
            rgb=torch.from_numpy(np.stack([view.rgb for view in samples]).transpose(0, 3, 1, 2)),
            sparse_depth=sparse_depth,
            targets={
                name: torch.from_numpy(np.stack([view.target(name) for view in samples]))
                for name in targets
            },
            weights={
                name: torch.tensor([view.weights.get(name, 1.0) for view in samples])
                for name in targets
            },
            names=[item.views[0].name for item in drawn],
            pair=pair,
        )

    def pin_memory(self) -> Self:
        """Return the batch in page-locked memory. The DataLoader calls this for a GPU."""
        return self._map(Tensor.pin_memory)

    def to(self, device: torch.device) -> Self:
        """Return the batch on a device."""
        return self._map(lambda tensor: tensor.to(device, non_blocking=True))

    def _map(self, change: Callable[[Tensor], Tensor]) -> Self:
        return replace(
            self,
            rgb=change(self.rgb),
            sparse_depth=change(self.sparse_depth),
            targets={name: change(labels) for name, labels in self.targets.items()},
            weights={name: change(weights) for name, weights in self.weights.items()},
            pair=None if self.pair is None else Pair(*map(change, self.pair)),
        )


@dataclass(frozen=True)
class MixturePart:
    """A data set, its weight relative to the others, and its augmentation."""

    source: SampleSource
    weight: float
    augment: AugmentConfig


@dataclass(frozen=True)
class DepthTarget:
    """The unit of the depth target, see `models.NetworkConfig`, and the depth of the sky.

    Attributes:
        sky: class whose unmeasured pixels get the depth `sky_depth_m`; None: no class.
        max_depth_m: range of the network.
    """

    canonical_focal_px: float | None = None
    sky: int | None = None
    sky_depth_m: float = 100.0
    max_depth_m: float = MAX_RETURN_M


class Mixture(Dataset[Drawn]):
    """`length` augmented samples; the i-th is a pure function of the parts, seed, length and i.

    A run resumed at sample i therefore gets the same samples, whatever the number of worker
    processes. Each set is drawn in shuffled passes, each frame once a pass.

    With `pair_shift` a sample has two views. Crops may be chosen for the classes `rare`.
    """

    def __init__(
        self,
        parts: Sequence[MixturePart],
        *,
        length: int,
        seed: int,
        depth: DepthTarget | None = None,
        pair_step: int = PAIR_STEP_PX,
        rare: Sequence[int] = (),
    ) -> None:
        self._parts = list(parts)
        self._seed = seed
        self._depth = depth or DepthTarget()
        self._pair_step = pair_step
        self._rare = tuple(rare)
        weights = np.array([part.weight for part in parts], dtype=np.float64)
        rng = np.random.default_rng([seed, 0])
        self._part = rng.choice(len(parts), size=length, p=weights / weights.sum())
        self._frame = np.empty(length, dtype=np.int64)
        for index, part in enumerate(parts):
            drawn = np.nonzero(self._part == index)[0]
            frames = len(part.source)
            passes = -(-len(drawn) // frames)
            order = [rng.permutation(frames) for _ in range(passes)]
            self._frame[drawn] = np.concatenate(order)[: len(drawn)] if order else 0

    def __len__(self) -> int:
        return len(self._part)

    def __getitem__(self, index: int) -> Drawn:
        part = self._parts[self._part[index]]
        rng = np.random.default_rng([self._seed, 1, index])
        target = self._depth
        sample = augment(
            part.source[int(self._frame[index])],
            with_margin(part.augment),
            rng,
            canonical_focal_px=target.canonical_focal_px,
            max_depth_m=target.max_depth_m,
            rare=self._rare,
        )
        views: tuple[Sample, ...] = (sample,)
        offset = (0, 0)
        if part.augment.pair_shift:
            first, second, offset = take_views(sample, part.augment, rng, step=self._pair_step)
            views = first, second
        views = scale_world(views, part.augment, rng, max_depth_m=target.max_depth_m)
        if target.sky is not None:
            views = tuple(far_sky(view, target.sky, target.sky_depth_m) for view in views)
        return Drawn(views, offset)
