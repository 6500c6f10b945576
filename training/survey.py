"""What the frames of a recipe's data sets hold, counted before a training begins."""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models import NetworkConfig
from training.datasets.class_mapping import list_classes
from training.datasets.sample import Sample, SampleSource, target_kind
from training.loading.open_dataset import FREQUENCY_SAMPLES, spread_indices
from training.recipe import Recipe

#: Share of a set's depth beyond the network's range from which it is reported.
_FAR_SHARE = 0.1


class Survey(NamedTuple):
    """Counts of about `FREQUENCY_SAMPLES` frames without augmentation, by the sets' weights."""

    #: The least height and the least width of the frames.
    smallest: tuple[int, int]
    #: Pixels of each class, in millionths of a frame; labels made by a network count by their
    #: weight.
    classes: NDArray[np.float64]
    #: Of a target, what of its labels is not trained, in words.
    notes: Sequence[tuple[str, str]]


def survey(recipe: Recipe, sources: Sequence[SampleSource], config: NetworkConfig) -> Survey:
    """Count what the sets of a recipe hold for a network."""
    names = [info.name for info in list_classes(recipe.model.class_table)]
    counts, sizes = np.zeros(len(names)), list[tuple[int, int]]()
    notes: list[tuple[str, str]] = []
    total = sum(item.weight for item in recipe.data.source)
    for item, source in zip(recipe.data.source, sources, strict=True):
        wanted = max(1, round(FREQUENCY_SAMPLES * item.weight / total))
        frames = spread_indices(source, wanted)
        empty: Counter[str] = Counter()
        near = known = 0
        for index in frames:
            sample = source[index]
            sizes.append(sample.size)
            seen = np.bincount(sample.semantic.ravel(), minlength=256)[: len(names)]
            weight = sample.weights.get("semantic", 1.0) * wanted / len(frames)
            counts += seen * weight / sample.semantic.size
            empty.update(name for name in sample.targets if not learned(sample, name, config).any())
            near += int(learned(sample, "depth", config).sum())
            known += int((sample.depth > 0).sum())
        for target, number in empty.items():
            text = (
                f"{number} of {len(frames)} frames of {item.title} have no {target} to learn from"
            )
            notes.append((target, text))
        # Only where the user states the unit can it be wrong.
        if known - near > _FAR_SHARE * known and hasattr(item, "depth_scale"):
            text = f"{item.title}: {1 - near / known:.0%} of the depth is beyond "
            text += f"{config.target_depth_m:g} m and not trained: check the unit (depth_scale)"
            notes.append(("depth", text))
    titles = ", ".join(item.title for item in recipe.data.source)
    counts = np.round(counts * 1_000_000)
    never = [name for name, count in zip(names, counts, strict=True) if not count]
    text = f"is labelled {', '.join(never)}: such a class is not trained"
    if len(never) == len(names):
        text = "is labelled: classes and boundaries are not trained"
    if never:
        notes.append(("semantic", f"no pixel of {len(sizes)} frames of {titles} {text}"))
    height, width = np.min(sizes, axis=0).tolist()
    return Survey((height, width), counts, notes)


def learned(sample: Sample, target: str, config: NetworkConfig) -> NDArray[np.bool_]:
    """Return where a frame has labels of a target that count in the loss."""
    labels = sample.target(target)
    known = labels != target_kind(target).unlabelled
    if target == "depth":
        canonical, focal = config.canonical_focal_px, sample.focal_length_px
        factor = canonical / focal if canonical and focal else 1.0
        known &= labels <= config.target_depth_m / factor
    return np.asarray(known & (sample.weights.get(target, 1.0) > 0))
