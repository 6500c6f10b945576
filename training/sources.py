"""From a recipe's words to data sets."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from runtime.errors import DatasetError
from training.datasets.camvid import CamVid
from training.datasets.kitti_stream import KittiStream
from training.datasets.mixture import Mixture, MixturePart
from training.datasets.sample import SampleSource
from training.datasets.virtual_kitti import VirtualKitti
from training.recipe import DataRecipe, SourceRecipe


def open_source(recipe: SourceRecipe, roots: Sequence[Path]) -> SampleSource:
    """Open a data set below the first of ``roots`` that has its folder. Raises DatasetError."""
    folder = next((root / recipe.path for root in roots if (root / recipe.path).is_dir()), None)
    if folder is None:
        raise DatasetError(
            f"no folder {recipe.path!r} ({recipe.kind}) below {', '.join(map(str, roots))}. "
            "Name the folder that holds it with --data."
        )
    match recipe.kind:
        case "camvid":
            return CamVid(folder, split=recipe.split)
        case "kitti_stream":
            return KittiStream(
                folder,
                first=recipe.first,
                last=recipe.last,
                semantic_weight=recipe.semantic_weight,
            )
        case "virtual_kitti":
            return VirtualKitti(folder, scenes=recipe.scenes, variants=recipe.variants)


def open_mixture(recipe: DataRecipe, sources: Sequence[SampleSource], *, length: int) -> Mixture:
    """Join data sets in the recipe's proportions and with its augmentation."""
    parts = [
        MixturePart(
            source,
            item.weight,
            replace(recipe.augment, scale=item.scale) if item.scale else recipe.augment,
        )
        for item, source in zip(recipe.source, sources, strict=True)
    ]
    return Mixture(parts, length=length, seed=recipe.seed)


def count_pixels(
    recipe: DataRecipe, sources: Sequence[SampleSource], num_classes: int
) -> NDArray[np.int64]:
    """Count the pixels of every class in the mixture: int64 (num_classes,).

    From about ``recipe.frequency_samples`` frames without augmentation, spread evenly over each
    set and in the recipe's proportions; labels made by a network count by their weight.
    """
    counts = np.zeros(num_classes, dtype=np.float64)
    total = sum(item.weight for item in recipe.source)
    for item, source in zip(recipe.source, sources, strict=True):
        wanted = max(1, round(recipe.frequency_samples * item.weight / total))
        frames = np.unique(np.linspace(0, len(source) - 1, min(wanted, len(source))).astype(int))
        for index in frames:
            sample = source[int(index)]
            seen = np.bincount(sample.semantic.ravel(), minlength=256)[:num_classes]
            counts += seen * sample.semantic_weight * (wanted / len(frames)) / sample.semantic.size
    return np.round(counts * 1_000_000).astype(np.int64)
