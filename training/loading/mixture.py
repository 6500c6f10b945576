"""From data sets to samples: frames are cached, drawn from a mixture and augmented."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from torch.utils.data import Dataset

from training.datasets.sample import ChangedSource, Sample, SampleSource
from training.loading.augment import augment, take_views
from training.loading.augment_config import AugmentConfig
from training.loading.batch import Drawn
from training.loading.colors import move_histograms
from training.loading.depth_values import DepthTarget, far_sky, scale_world


class CachedSource(ChangedSource):
    """A data set that keeps decoded frames in memory, up to `limit_bytes`.

    No frame is replaced by another: passes over a shuffled set would drop each frame just before it
    is used again. Each worker process has its own cache.
    """

    def __init__(self, source: SampleSource, *, limit_bytes: int) -> None:
        super().__init__(source)
        self._free = limit_bytes
        self._kept: dict[int, Sample] = {}

    def __getitem__(self, index: int) -> Sample:
        if index in self._kept:
            return self._kept[index]
        sample = self._source[index]
        arrays = (sample.rgb, sample.returns, sample.scan_line, *sample.targets.values())
        size = sum({id(array): array.nbytes for array in arrays if array is not None}.values())
        if size <= self._free:
            self._free -= size
            self._kept[index] = sample
        return sample


@dataclass(frozen=True)
class MixturePart:
    """A data set, its weight relative to the others, and its augmentation."""

    source: SampleSource
    weight: float
    augment: AugmentConfig


@dataclass(eq=False, kw_only=True)
class Mixture(Dataset[Drawn]):
    """`length` augmented samples; the i-th is a pure function of the parts, seed, length and i.

    A run resumed at sample i therefore gets the same samples, whatever the number of worker
    processes. Each set is drawn in shuffled passes, each frame once a pass.

    With `pair_shift` a sample has two views. Crops may be chosen for the classes `rare`.
    """

    parts: Sequence[MixturePart]
    length: int
    seed: int
    depth: DepthTarget
    pair_step: int
    rare: Sequence[int]

    def __post_init__(self) -> None:
        """Draw the set and the frame of each sample."""
        weights = np.array([part.weight for part in self.parts], dtype=np.float64)
        rng = np.random.default_rng([self.seed, 0])
        self._part = rng.choice(len(self.parts), size=self.length, p=weights / weights.sum())
        self._frame = np.empty(self.length, dtype=np.int64)
        for index, part in enumerate(self.parts):
            drawn = np.nonzero(self._part == index)[0]
            frames = len(part.source)
            passes = -(-len(drawn) // frames)
            order = [rng.permutation(frames) for _ in range(passes)]
            self._frame[drawn] = np.concatenate(order)[: len(drawn)] if order else 0

    def __len__(self) -> int:
        return self.length

    def __getitem__(self, index: int) -> Drawn:
        part, target = self.parts[self._part[index]], self.depth
        rng = np.random.default_rng([self.seed, 1, index])
        sample = part.source[int(self._frame[index])]
        if part.augment.restyle and rng.random() < part.augment.restyle:
            # Its colours become nearer to those of an image of any set.
            source = self.parts[int(rng.integers(len(self.parts)))].source
            other = source[int(rng.integers(len(source)))]
            sample = sample.with_image(move_histograms(sample.rgb, other.rgb, rng.random()))
        sample = augment(sample, part.augment, rng, target, self.rare)
        views: tuple[Sample, ...] = (sample,)
        offset = (0, 0)
        if part.augment.pair_shift:
            first, second, offset = take_views(sample, part.augment, rng, step=self.pair_step)
            views = first, second
        views = scale_world(views, part.augment, rng, max_depth_m=target.max_depth_m)
        if target.sky is not None:
            views = tuple(far_sky(view, target.sky, target.sky_depth_m) for view in views)
        return Drawn(views, offset)
