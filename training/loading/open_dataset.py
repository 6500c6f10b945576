"""Open the data sets of a recipe."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from runtime.errors import DatasetError
from training.datasets.class_mapping import ClassTable
from training.datasets.sample import SampleSource
from training.datasets.source_recipe import SourceRecipe
from training.limits import PAIR_STEP_PX
from training.loading.cache import CachedSource
from training.loading.checked import CheckedSource
from training.loading.mixture import DepthTarget, Mixture, MixturePart
from training.recipe import DataRecipe

#: Number of frames from which the class frequencies of the loss are counted.
FREQUENCY_SAMPLES = 400
#: Frames of the training that pruning is based on, at least.
_PICTURES = 32


def open_dataset(
    recipe: SourceRecipe, roots: Sequence[Path], *, classes: ClassTable
) -> SampleSource:
    """Open a data set in the first of ``roots`` that has its folder.

    ``classes`` is the table of the class ids. DatasetError if there is none, or it cannot be read.
    """
    source = recipe.open(_find_folder(recipe, roots), classes)
    return CheckedSource(source, recipe.size)


def _find_folder(recipe: SourceRecipe, roots: Sequence[Path]) -> Path:
    for root in roots:
        if (root / recipe.path).is_dir():
            return root / recipe.path
    below = "" if Path(recipe.path).is_absolute() else f" below {', '.join(map(str, roots))}"
    raise DatasetError(
        f"no folder {recipe.path!r} ({recipe.kind}){below}. Name the folder that holds it with "
        "--data."
    )


def open_mixture(
    recipe: DataRecipe,
    sources: Sequence[SampleSource],
    *,
    length: int,
    depth: DepthTarget | None = None,
    pair_step: int = PAIR_STEP_PX,
    rare: Sequence[int] = (),
) -> Mixture:
    """Mix data sets by the recipe's weights, with its augmentation and cache.

    ``depth`` is the unit of the depth; None = metres, and no depth of the sky. The offsets of
    second views are multiples of ``pair_step`` [px]. ``rare`` are the ids of the rare classes.
    """
    share = recipe.cache_gib / (max(1, recipe.workers) * len(sources))
    parts = [
        MixturePart(
            CachedSource(source, limit_bytes=int(share * 2**30)) if share else source,
            item.weight,
            replace(recipe.augment, scale=item.scale) if item.scale else recipe.augment,
        )
        for item, source in zip(recipe.source, sources, strict=True)
    ]
    return Mixture(
        parts, length=length, seed=recipe.seed, depth=depth, pair_step=pair_step, rare=rare
    )


def spread_indices(source: SampleSource, count: int) -> list[int]:
    """Return ``count`` indices at equal distances, or all of a smaller set."""
    indices: list[int] = (
        np.linspace(0, len(source) - 1, min(count, len(source))).astype(int).tolist()
    )
    return indices


def spread_pictures(sources: Sequence[SampleSource]) -> Iterator[Tensor]:
    """Yield the images of frames of all sets, each float (1, 3, H, W), RGB in 0..255."""
    for source in sources:
        for index in spread_indices(source, -(-_PICTURES // len(sources))):
            yield torch.from_numpy(source[index].rgb).permute(2, 0, 1)[None].float()


def count_pixels(
    recipe: DataRecipe, sources: Sequence[SampleSource], num_classes: int
) -> NDArray[np.int64]:
    """Count the pixels of every class in the mixture: int64 (num_classes,).

    From about `FREQUENCY_SAMPLES` frames without augmentation, at equal distances in each
    set and by the recipe's weights; labels made by a network count by their weight.
    """
    counts = np.zeros(num_classes, dtype=np.float64)
    total = sum(item.weight for item in recipe.source)
    for item, source in zip(recipe.source, sources, strict=True):
        wanted = max(1, round(FREQUENCY_SAMPLES * item.weight / total))
        frames = spread_indices(source, wanted)
        for index in frames:
            sample = source[index]
            seen = np.bincount(sample.semantic.ravel(), minlength=256)[:num_classes]
            weight = sample.weights.get("semantic", 1.0) * wanted / len(frames)
            counts += seen * weight / sample.semantic.size
    return np.round(counts * 1_000_000).astype(np.int64)
