"""From a recipe's words to data sets."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast, get_args

import numpy as np
from numpy.typing import NDArray

from runtime.errors import DatasetError
from training.datasets.camvid import CamVid
from training.datasets.cityscapes import Cityscapes
from training.datasets.kitti_depth import KittiDepth
from training.datasets.kitti_raw import KittiRaw
from training.datasets.kitti_stream import KittiStream
from training.datasets.sample import SampleSource
from training.datasets.virtual_kitti import VirtualKitti
from training.datasets.virtual_kitti_1 import VirtualKitti1
from training.datasets.virtual_kitti_split import Selection, Split, read_frame_list
from training.loading.cache import CachedSource
from training.loading.mixture import Mixture, MixturePart
from training.loading.resized import ResizedSource
from training.recipe import DataRecipe, SourceRecipe


def open_source(recipe: SourceRecipe, roots: Sequence[Path], *, classes: str) -> SampleSource:
    """Open a data set below the first of ``roots`` that has its folder.

    ``classes`` is the class table that its labels are told in. Raises DatasetError.
    """
    source = _open(recipe, roots, classes)
    return ResizedSource(source, recipe.size) if recipe.size else source


def _open(recipe: SourceRecipe, roots: Sequence[Path], classes: str) -> SampleSource:
    if recipe.kind == "rendered_on_the_fly":
        # Only here: it needs the ray caster.
        from training.datasets.rendered_scenes import RenderedScenes
        from training.scenes.rendering.weather import VARIANTS

        unknown = sorted(set(recipe.variants or ()) - set(VARIANTS))
        if unknown:
            raise DatasetError(f"no variant {unknown[0]!r}; known: {', '.join(VARIANTS)}.")
        return RenderedScenes(
            scenes=recipe.num_scenes,
            frames=recipe.frames_per_scene,
            seed=recipe.scene_seed,
            size=recipe.size or (375, 1242),
            variants=[item for item in VARIANTS if item in (recipe.variants or VARIANTS)],
            classes=classes,
        )
    folder = next((root / recipe.path for root in roots if (root / recipe.path).is_dir()), None)
    if folder is None:
        raise DatasetError(
            f"no folder {recipe.path!r} ({recipe.kind})"
            + ("" if Path(recipe.path).is_absolute() else f" below {', '.join(map(str, roots))}")
            + ". Name the folder that holds it with --data."
        )
    match recipe.kind:
        case "camvid":
            return CamVid(folder, split=recipe.split, classes=classes)
        case "cityscapes":
            return Cityscapes(folder, split=recipe.split, classes=classes)
        case "kitti_depth":
            return KittiDepth(folder, split=recipe.split, cameras=recipe.cameras or (2,))
        case "kitti_raw":
            return KittiRaw(
                folder,
                drives=recipe.drives,
                cameras=recipe.cameras or (2,),
                withhold_hidden=recipe.withhold_hidden,
            )
        case "kitti_stream":
            return KittiStream(
                folder,
                first=recipe.first,
                last=recipe.last,
                semantic_weight=recipe.semantic_weight,
                classes=classes,
            )
        case "rendered" | "virtual_kitti":
            return VirtualKitti(
                folder,
                selection=_selection(recipe, folder),
                cameras=recipe.cameras or (0,),
                classes=classes,
            )
        case "virtual_kitti_1":
            return VirtualKitti1(folder, selection=_selection(recipe, folder), classes=classes)


def _selection(recipe: SourceRecipe, folder: Path) -> Selection:
    split = recipe.split
    if recipe.kind == "rendered":  # every scene on disk: the folder is the split
        split = "all"
    if split not in get_args(Split):
        raise DatasetError(
            f"Virtual KITTI has no split {split!r}; known: {', '.join(get_args(Split))}."
        )
    return Selection(
        cast("Split", split),
        recipe.scenes,
        recipe.variants,
        None if recipe.frames is None else read_frame_list(folder / recipe.frames),
    )


def open_mixture(recipe: DataRecipe, sources: Sequence[SampleSource], *, length: int) -> Mixture:
    """Join data sets in the recipe's proportions, with its augmentation and its memory."""
    share = recipe.cache_gib / (max(1, recipe.workers) * len(sources))
    parts = [
        MixturePart(
            CachedSource(source, limit_bytes=int(share * 2**30)) if share else source,
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
