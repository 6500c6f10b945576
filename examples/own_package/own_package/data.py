"""A data set with labels of the new head: made-up frames whose lower half is bright and free."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic.dataclasses import dataclass

from training.base.limits import STRICT, Positive
from training.datasets.sample import Sample, make_frame
from training.datasets.source_recipe import SourceRecipe

SIZE = (64, 96)


class Streets(Sequence[Sample]):
    """Frames of noise; a third of their columns is not labelled."""

    def __init__(self, count: int) -> None:
        self._count = count

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: Any) -> Any:
        """Return a frame with its labels: float32 (H, W), NaN where a pixel is not labelled."""
        if index >= self._count:
            raise IndexError(index)
        rgb = np.random.default_rng(index).integers(0, 60, (*SIZE, 3), dtype=np.uint8)
        rgb[SIZE[0] // 2 :] += 180
        free = (rgb[..., 0] > 100).astype(np.float32)
        free[:, : SIZE[1] // 3] = np.nan
        return Sample(make_frame(rgb, str(index)), {"drivable": free}, weights={"drivable": 0.5})


@dataclass(frozen=True, kw_only=True, config=STRICT)
class StreetsRecipe(SourceRecipe):
    """The keys of the data set in a recipe.

    Attributes:
        count: number of frames.
    """

    kind: Literal["own-streets"] = "own-streets"
    count: Positive = 1.0

    def open(self, folder: Path, classes: Any) -> Streets:
        """See `SourceRecipe.open`."""
        return Streets(int(self.count))
