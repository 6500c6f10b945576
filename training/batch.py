"""A batch: inputs of the network and targets of the loss."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple, Self

import numpy as np
import torch
from torch import Tensor

from models import NetworkOutput
from training.datasets.sample import Sample


class Pair(NamedTuple):
    """How the second view of each frame differs from the first."""

    #: int64 (N, 2): row and column of the second view's upper left corner in the first view.
    offset: Tensor
    #: float32 (N, 1, H, W), metres: LiDAR input of the views, 0 = no return.
    first_lidar: Tensor
    second_lidar: Tensor


class Drawn(NamedTuple):
    """A frame that was drawn from the mixture of data sets, as one view or as two shifted views."""

    views: tuple[Sample, ...]
    #: (row, column) of the second view's upper left corner in the first view.
    offset: tuple[int, int] = (0, 0)


@dataclass(frozen=True)
class Batch:
    """Frames of one size; with two views, the first views of all frames, then the second views."""

    #: uint8 (N, 3, H, W), RGB.
    rgb: Tensor
    #: float32 (N, 1, H, W), metres; 0 = no measurement.
    sparse_depth: Tensor
    #: Target -> (N, H, W), see `training.datasets.sample.target_kind`.
    targets: Mapping[str, Tensor]
    #: Target -> float32 (N,), weight of each frame's labels in the loss.
    weights: Mapping[str, Tensor]
    #: Data set and name of each frame, for messages.
    names: Sequence[str]
    #: None = no frame has two views.
    pair: Pair | None = None
    #: Output of the teacher, None = no teacher.
    teacher: NetworkOutput | None = None

    @classmethod
    def collate(cls, drawn: Sequence[Drawn], targets: Collection[str]) -> Self:
        """Make a batch of drawn frames with these targets.

        A target that a frame lacks is unlabelled in all its pixels. Raises ValueError if a frame
        has no sparse depth.
        """
        # The first views of all frames, then the second views.
        samples = [
            view for part in zip(*(item.views for item in drawn), strict=True) for view in part
        ]
        for sample in samples:
            if sample.sparse_depth is None:
                raise ValueError(f"{sample.name} has no sparse_depth; draw one with draw_lidar")
        sparse_depth = torch.from_numpy(np.stack([view.sparse_depth for view in samples])[:, None])
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

    def _map(self, change: Any) -> Self:
        def changed(value: Any) -> Any:
            if isinstance(value, Tensor):
                return change(value)
            if isinstance(value, Pair):
                return Pair(*map(change, value))
            if isinstance(value, Mapping):
                return {name: change(tensor) for name, tensor in value.items()}
            return value

        values = {item.name: changed(getattr(self, item.name)) for item in fields(self)}
        return replace(self, **values)
