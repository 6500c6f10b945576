"""What the frames of a recipe's data sets hold, counted before a training begins."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models import NetworkConfig
from runtime.resize import Size
from training.datasets.class_mapping import list_classes
from training.datasets.sample import Sample, SampleSource, target_kind
from training.loading.open_dataset import FREQUENCY_SAMPLES, spread_indices
from training.recipe import Recipe

#: Share of a set's depth beyond the network's range from which it is reported.
_FAR_SHARE = 0.01


@dataclass(frozen=True)
class Survey:
    """Counts of about `FREQUENCY_SAMPLES` frames without augmentation, by the sets' weights.

    Attributes:
        frames: number of these frames.
        smallest: the least height and the least width of them.
        classes: pixels of each class, in millionths of a frame; labels made by a network count by
            their weight.
        notes: of a target, what of its labels is not trained, in words.
    """

    frames: int
    smallest: Size
    classes: NDArray[np.float64]
    notes: Sequence[tuple[str, str]]


def survey(recipe: Recipe, sources: Sequence[SampleSource], config: NetworkConfig) -> Survey:
    """Count what the sets of a recipe hold for a network."""
    names = [info.name for info in list_classes(recipe.model.class_table)]
    counts, sizes = np.zeros(len(names)), list[Size]()
    notes: list[tuple[str, str]] = []
    total = sum(item.weight for item in recipe.data.source)
    for item, source in zip(recipe.data.source, sources, strict=True):
        wanted = max(1, round(FREQUENCY_SAMPLES * item.weight / total))
        frames = spread_indices(source, wanted)
        near, far = 0, 0
        empty: Counter[str] = Counter()
        for index in frames:
            sample = source[index]
            sizes.append(sample.size)
            seen = np.bincount(sample.semantic.ravel(), minlength=256)[: len(names)]
            weight = sample.weights.get("semantic", 1.0) * wanted / len(frames)
            counts += seen * weight / sample.semantic.size
            used = int(learned(sample, "depth", config).sum())
            empty.update(t for t in sample.targets if not learned(sample, t, config).any())
            near, far = near + used, far + int((sample.depth > 0).sum()) - used
        notes += [
            (
                target,
                f"{number} of {len(frames)} frames of {item.title} have no {target} to learn from",
            )
            for target, number in empty.items()
        ]
        if far > _FAR_SHARE * (near + far):
            text = f"{item.title}: {far / (near + far):.0%} of the depth is beyond "
            text += f"{config.target_depth_m:g} m and not trained: check the unit, metres x 256 "
            notes.append(("depth", f"{text}unless the set has a depth_scale"))
    counts = np.round(counts * 1_000_000)
    titles = ", ".join(item.title for item in recipe.data.source)
    if not counts.any():
        text = f"no pixel of {titles} is labelled: classes and boundaries are not trained"
        notes.append(("semantic", text))
    elif never := [name for name, count in zip(names, counts, strict=True) if not count]:
        text = f"no pixel of {len(sizes)} frames of {titles} is labelled {', '.join(never)}: the "
        notes.append(("semantic", f"{text}class is not trained"))
    height, width = np.min(sizes, axis=0).tolist()
    return Survey(len(sizes), (height, width), counts, notes)


def learned(sample: Sample, target: str, config: NetworkConfig) -> NDArray[np.bool_]:
    """Return where a frame has labels of a target that count in the loss."""
    labels = sample.target(target)
    known = np.asarray(labels != target_kind(target).unlabelled)
    if target == "depth":
        focal = sample.focal_length_px if config.canonical_focal_px else None
        factor = (config.canonical_focal_px or 1) / focal if focal else 1.0
        known &= labels <= config.target_depth_m / factor
    return known & (sample.weights.get(target, 1.0) > 0)
