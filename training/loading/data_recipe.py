"""The table `data` of a recipe: its data sets, and how they are augmented and batched."""

from dataclasses import field
from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from runtime.contract.contract import MAX_CLASSES, MIN_SIDE
from training.base.limits import STRICT, BatchSize, NotNegative, Seed, Workers
from training.datasets.registry import AnySource
from training.loading.augment_config import AugmentConfig


@dataclass(frozen=True, config=STRICT)
class DataRecipe:
    """The data sets, their augmentation and batches.

    Attributes:
        batch_size: batch size of each process; `workers` is the number of workers of each process.
        cache_gib: memory for decoded frames, of all workers of a process together [GiB]; 0: no
            cache.
        sky_depth_m: depth target [m] of unmeasured pixels of the class "sky", canonical if the
            network's depth is; 0: none.
        rare_classes: classes for which `augment.rare_crops` of the crops are chosen.
    """

    source: Annotated[tuple[AnySource, ...], Field(min_length=1, max_length=100)]
    augment: AugmentConfig = field(default_factory=AugmentConfig)
    batch_size: BatchSize = 8
    workers: Workers = 1
    cache_gib: NotNegative = 0.0
    seed: Seed = 0
    sky_depth_m: NotNegative = 0.0
    rare_classes: Annotated[tuple[str, ...], Field(max_length=MAX_CLASSES)] = ()

    def __post_init__(self) -> None:
        """Check the crop, and that there are classes to choose it for."""
        crop = self.augment.size
        if min(crop) < MIN_SIDE:
            raise ValueError(f"augment.crop = {list(crop)}: both must be at least {MIN_SIDE}")
        if self.augment.rare_crops and not self.rare_classes:
            raise ValueError("augment.rare_crops needs rare_classes, names of model.classes")
