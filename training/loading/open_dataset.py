"""Open the data sets of a recipe."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from runtime.errors import DatasetError
from training.datasets.class_mapping import ClassTable
from training.datasets.sample import SampleSource
from training.datasets.source_recipe import SourceRecipe
from training.loading.mixture import CheckedSource

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
    below = (
        "" if Path(recipe.path).is_absolute() else f" in {', '.join(map(repr, map(str, roots)))}"
    )
    raise DatasetError(
        f"no folder {recipe.path!r} ({recipe.kind}){below}. Name the folder that holds it with "
        "--data."
    )


def frame_files(sources: Iterable[SampleSource]) -> set[tuple[int, int]]:
    """Return device and number of the file of each frame's image, the same by any path or link."""
    found = (path.stat() for source in sources for path in getattr(source, "images", ()))
    return {(item.st_dev, item.st_ino) for item in found}


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
