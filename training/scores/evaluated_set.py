"""The data sets on which models are scored, opened with the classes that all share."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from runtime.base.errors import InputError
from runtime.contract.contract import NO_CLASS
from training.datasets.class_mapping import ClassTable, list_classes
from training.datasets.sample import Sample, SampleSource
from training.datasets.source_recipe import SourceRecipe
from training.lidar.faults import add_fault
from training.lidar.split import LidarInput, LidarSplit, frame_generator, split_lidar
from training.loading.camera_faults import CAMERA_FAULTS, spoil
from training.loading.open_dataset import open_dataset, spread_indices
from training.scores.metrics import FARTHEST_M
from training.scores.scored_model import ScoredModel
from training.scores.scoring import HeadMaps, Scores
from training.scores.shared_classes import ScoredClasses, join_names, share_classes

# A LiDAR input, and a fault of the LiDAR or the camera.
Feed = tuple[LidarInput, str]
# Strength of the faults of a camera, see `spoil`: a blur by 12 px, a tenth of the light.
CAMERA_FAULT_STRENGTH = 0.8
# Keys that say how files are read, and are no part of a set's title.
_READING = ("kind", "path", "rgb", "label_ids", "label_colors", "label_classes", "depth_scale")


@dataclass(frozen=True)
class EvaluatedSet:
    """An open data set, the frames of it that are scored, their classes, and the range [m].

    With `leave_out_fed`, frames whose input is the depth to score are left out, and no error.
    """

    title: str
    source: SampleSource
    classes: ScoredClasses
    indices: Sequence[int]
    farthest_m: float = FARTHEST_M
    leave_out_fed: bool = False

    def begin_scores(self) -> Scores:
        """Return scores of the classes and the range without any frame."""
        return Scores(len(self.classes.names), self.farthest_m)

    def read(self, index: int) -> tuple[Sample, NDArray[np.int64]]:
        """Return a frame with labels in the scored classes, and its labelled and scored pixels."""
        sample = self.source[index]
        labelled = scored = int((sample.semantic != NO_CLASS).sum())
        if "semantic" in sample.targets:
            lookup = self.classes.lookup(self.classes.table, NO_CLASS)
            sample = sample.with_targets(semantic=lookup[sample.semantic])
            scored = int((sample.semantic != NO_CLASS).sum())
        return sample, np.array([labelled, scored])

    def answer(
        self, model: ScoredModel, sample: Sample, fed: NDArray[np.float32], index: int
    ) -> HeadMaps:
        """Return a model's answer to a frame, with ids of the scored classes."""
        if model.recorded is not None:
            answer = model.recorded(sample, self.image_name(index))
        else:
            answer = model.predict(sample.rgb, fed, sample.focal_length_px)
        if answer.semantic is None:
            return answer
        table = model.table or self.classes.table
        highest = answer.semantic[answer.semantic != NO_CLASS].max(initial=0)
        count = len(list_classes(table))
        if highest >= count:
            raise InputError(
                f"{sample.name}: the answer has the class id {highest}, and there are {count} "
                "classes: name those of the answers, with classes in an adapter or in "
                "--predictions DIR,classes=cityscapes"
            )
        lookup = self.classes.lookup(table, len(self.classes.names))
        return answer.with_semantic(lookup[answer.semantic])

    def split(
        self, sample: Sample, index: int, feeds: Sequence[Feed]
    ) -> Iterator[tuple[Feed, str, LidarSplit, NDArray[np.float32]]]:
        """Yield the inputs that a frame gives: the feed, its name, the split, and what is fed.

        The image of the split is that of a faulty camera, if the feed has such a fault. Raises
        InputError if a LiDAR feeds the depth to score and is not to be left out.
        """
        for feed in feeds:
            lidar, fault = feed
            rng = frame_generator(index)  # the same for every model, whatever the limit
            frame = split_lidar(sample, lidar, rng)
            if frame is None:
                continue
            if frame.target.any() and np.array_equal(frame.fed, frame.target):
                if self.leave_out_fed:
                    continue
                raise InputError(
                    f"{sample.name}: with the LiDAR {str(lidar)!r} the input is the depth to "
                    "score, so that an error of 0 would mean nothing: feed a share with --lidar "
                    "random:0.5, or give denser depth"
                )
            name, fed = str(lidar) if frame.fed.any() else "none", frame.fed
            if fault in CAMERA_FAULTS:
                image = spoil(frame.sample.rgb, fault, CAMERA_FAULT_STRENGTH, rng)
                frame = frame._replace(sample=frame.sample.with_image(image))
                name = f"{name}-{fault}"
            elif fault != "none" and name != "none":
                name, fed = f"{name}-{fault}", add_fault(fed, fault, rng)
            yield feed, name, frame, fed

    def image_name(self, index: int) -> str | None:
        """Return the stem of a frame's image; None if the set does not know its files."""
        images = getattr(self.source, "images", ())
        return images[index].stem if images else None

    def group(self, sample: Sample, index: int) -> str:
        """Return the place or the drive of a frame; frames in one group are alike."""
        images = getattr(self.source, "images", ())
        return sample.place or (str(images[index].parent) if images else "")


def open_sets(
    recipes: Sequence[SourceRecipe],
    tables: Mapping[str, ClassTable],
    *,
    ids: ClassTable | None = None,
    join: Mapping[str, Sequence[str]] | None = None,
    limit: int | None = None,
    farthest_m: float = FARTHEST_M,
    leave_out_fed: bool = False,
) -> list[EvaluatedSet]:
    """Open sets with the classes that they share with the models.

    Args:
        recipes: recipes of the sets.
        tables: class tables of the models, those that have one.
        ids: see `share_classes`.
        join: see `join_names`.
        limit: number of frames of each set, evenly spread; None: all.
        farthest_m: farthest true depth [m] that is scored.
        leave_out_fed: see `EvaluatedSet`.
    """
    own = [recipe.label_table or ids or () for recipe in recipes]
    joined = join_names(join or {}, [*own, *tables.values()])
    folders = short_names([Path(recipe.path) for recipe in recipes])
    opened = []
    for recipe, folder in zip(recipes, folders, strict=True):
        title = recipe.name or " ".join([folder, *_changed_keys(recipe)])
        classes = share_classes(recipe, title, tables, ids, joined)
        source = open_dataset(recipe, [Path()], classes=classes.table)
        indices = spread_indices(source, limit or len(source))
        opened.append(EvaluatedSet(title, source, classes, indices, farthest_m, leave_out_fed))
    return opened


def short_names(paths: Sequence[Path]) -> list[str]:
    """Name paths by as few of their last parts as make the names unique."""
    longest = max((len(path.parts) for path in paths), default=1)
    for parts in range(1, 1 + max(1, longest)):
        names = [str(Path(*path.parts[-parts:])) for path in paths]
        if len(set(names)) == len(set(paths)):
            break
    return names


def _changed_keys(recipe: SourceRecipe) -> list[str]:
    """Return the keys in which this set differs from the same folder without options.

    Those that only say how its files are read are left out.
    """
    return [
        f"{item.name}={getattr(recipe, item.name)}"
        for item in fields(recipe)
        if item.name not in _READING and getattr(recipe, item.name) != item.default
    ]
