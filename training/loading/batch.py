"""The batches of a training, collated from drawn frames."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
import torch
from torch import Tensor

from models import NetworkOutput
from training.datasets.sample import Sample


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
        lacking: `Sample.lacking` of each frame; empty: no labels lack a class.
    """

    rgb: Tensor
    sparse_depth: Tensor
    targets: Mapping[str, Tensor]
    weights: Mapping[str, Tensor]
    names: Sequence[str]
    pair: Pair | None = None
    teacher: NetworkOutput | None = None
    lacking: Sequence[tuple[int, ...]] = ()

    @classmethod
    def collate(cls, drawn: Sequence[Drawn], targets: Collection[str]) -> Self:
        """Make a batch of drawn frames with these targets.

        A target that a frame lacks is unlabelled in all its pixels.
        """
        # The first views of all frames, then the second views.
        samples = [
            view for part in zip(*(item.views for item in drawn), strict=True) for view in part
        ]
        rgb = np.stack([view.rgb for view in samples]).transpose(0, 3, 1, 2)
        sparse_depth = torch.from_numpy(np.stack([view.returns for view in samples])[:, None])
        labels, weights = dict[str, Tensor](), dict[str, Tensor]()
        for name in targets:
            labels[name] = torch.from_numpy(np.stack([view.target(name) for view in samples]))
            weights[name] = torch.tensor([view.weights.get(name, 1.0) for view in samples])
        names, lacking = [item.views[0].name for item in drawn], [view.lacking for view in samples]
        pair = None
        if len(samples) > len(drawn):
            pair = Pair(torch.tensor([item.offset for item in drawn]), *sparse_depth.chunk(2))
        return cls(torch.from_numpy(rgb), sparse_depth, labels, weights, names, pair, None, lacking)

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
