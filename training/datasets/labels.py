"""Labels in PNGs: the keys that say what their numbers mean, and their reader."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from runtime.base.errors import DatasetError
from runtime.contract.contract import ClassInfo
from training.datasets.cityscapes import TRAIN_LABELS
from training.datasets.class_mapping import ClassTable, id_lookup, list_classes
from training.datasets.files import read_gray
from training.datasets.sample import IGNORE
from training.datasets.source_recipe import RangeRecipe
from training.limits import STRICT, Share

# A folder, relative to the `path` of its set.
Folder = Annotated[str, Field(min_length=1)]
_Id = Annotated[int, Field(ge=0, le=255)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class LabelledRecipe(RangeRecipe):
    """Options of a set in a recipe that may have a folder of labels.

    Attributes:
        labels: folder of PNGs with ids in `model.classes` or in `label_classes`, see `read_gray`.
        label_classes: "cityscapes": the ids are trainIds, which are mapped to `model.classes`.
        label_ids: name in `model.classes` of each id, or "ignore"; replaces the order of the
            classes.
        ignore: id of pixels without a class.
        semantic_weight: weight of the labels; below 1 for labels that a network made.
    """

    labels: Folder | None = None
    label_classes: Literal["cityscapes"] | None = None
    label_ids: Mapping[_Id, str] | None = None
    ignore: _Id = IGNORE
    semantic_weight: Share = 1.0

    def __post_init__(self) -> None:
        """Check that the ids have one meaning."""
        if self.label_ids and self.label_classes is not None:
            raise ValueError("label_ids and label_classes both name the ids; set one of them")
        if self.ignore != IGNORE and (self.label_ids or {}).get(self.ignore, "ignore") != "ignore":
            raise ValueError(
                f"ignore and label_ids give the id {self.ignore} two meanings; drop one"
            )

    @property
    def label_table(self) -> ClassTable | None:
        """See `SourceRecipe.label_table`."""
        if self.labels is None:
            return ()
        named = [name for name in (self.label_ids or {}).values() if name != "ignore"]
        own = tuple(ClassInfo(name, (0, 0, 0)) for name in dict.fromkeys(named))
        return own or self.label_classes


class LabelReader:
    """Reads PNGs of labels as ids of a class table.

    Raises:
        DatasetError: for names of classes that the table does not have.
    """

    def __init__(self, recipe: LabelledRecipe, classes: ClassTable) -> None:
        self._is_order = recipe.label_classes is None
        self._names = [info.name for info in list_classes(classes)]
        self._ids = _label_ids(recipe, classes)
        self._lookup = np.full(256, IGNORE, np.uint8)
        self._lookup[list(self._ids)] = list(self._ids.values())
        self._known = np.isin(np.arange(256), list(self._ids))

    def read(self, path: Path, size: tuple[int, int]) -> NDArray[np.uint8]:
        """Read the class ids of an image of (height, width): uint8 (H, W), 255 = unknown.

        Raises DatasetError for another kind of file or size, and for ids without a meaning.
        """
        label = read_gray(path, np.uint8, size)
        unknown = np.unique(label[~self._known[label]]).tolist()
        if unknown:
            advice = "give trainIds"
            if self._is_order:
                names = dict(enumerate(self._names))
                known = {id_: names.get(index, "ignore") for id_, index in self._ids.items()}
                # Ids that no key names may still follow the order of the classes.
                known |= {id_: names.get(id_, "ignore") for id_ in unknown}
                pairs = ", ".join(f"{id_} = {json.dumps(name)}" for id_, name in known.items())
                advice = f"name the ids in the recipe: label_ids = {{ {pairs} }}"
            raise DatasetError(
                f"{path}: class id {unknown[-1]}, expected {', '.join(map(str, self._ids))}: "
                f"correct the file, or {advice}"
            )
        classes: NDArray[np.uint8] = self._lookup[label]
        return classes


def _label_ids(recipe: LabelledRecipe, classes: ClassTable) -> dict[int, int]:
    """Return the id in the class table for each id in the files, `IGNORE` for none."""
    names = [info.name for info in list_classes(classes)]
    if recipe.label_ids:
        ids = {"ignore": IGNORE, **{name: index for index, name in enumerate(names)}}
        unknown = [name for name in recipe.label_ids.values() if name not in ids]
        if unknown:
            raise DatasetError(
                f"label_ids: {unknown[0]!r} is no class of model.classes; expected one of "
                f"{', '.join(ids)}"
            )
        named = {index: ids[name] for index, name in recipe.label_ids.items()}
        return {recipe.ignore: IGNORE, **named}
    order = list(range(len(names)))
    if recipe.label_classes is not None:
        order = id_lookup(recipe.label_classes, classes, TRAIN_LABELS)[: len(TRAIN_LABELS)].tolist()
    return {**dict(enumerate(order)), recipe.ignore: IGNORE}
