"""Labels in PNGs: the keys of a recipe that say what their numbers mean."""

import json
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from runtime.base.errors import DatasetError
from runtime.contract.contract import NO_CLASS
from training.base.limits import STRICT, NotNegative
from training.datasets.cityscapes import TRAIN_LABELS
from training.datasets.class_mapping import (
    IGNORED,
    ClassTable,
    LabelReader,
    id_lookup,
    list_classes,
    named_table,
)
from training.datasets.source_recipe import RangeRecipe

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
        lacking: classes that images show and labels never have, such as the sky where only a
            LiDAR's returns are labelled; nothing about them is learned from the set.
        semantic_weight: weight of a labelled pixel; below 1 for labels that a network made, above 1
            where few pixels have a label.
    """

    labels: Folder | None = None
    label_classes: Literal["cityscapes"] | None = None
    label_ids: Mapping[_Id, str] | None = None
    ignore: _Id = NO_CLASS
    lacking: tuple[str, ...] = ()
    semantic_weight: NotNegative = 1.0

    def __post_init__(self) -> None:
        """Check that the ids have one meaning."""
        if self.label_ids and self.label_classes is not None:
            raise ValueError("label_ids and label_classes both name the ids: set one of them")
        if self.ignore != NO_CLASS and (self.label_ids or {}).get(self.ignore, IGNORED) != IGNORED:
            raise ValueError(
                f"ignore and label_ids give the id {self.ignore} two meanings: drop one"
            )

    @property
    def label_table(self) -> ClassTable | None:
        """See `SourceRecipe.label_table`."""
        if self.labels is None:
            return ()
        named = [name for name in (self.label_ids or {}).values() if name != IGNORED]
        own = named_table(dict.fromkeys(named))
        return own or self.label_classes

    def open_labels(self, classes: ClassTable) -> LabelReader:
        """Return the reader of the labels.

        Raises:
            DatasetError: for names of classes that the table does not have.
        """
        names = [info.name for info in list_classes(classes)]
        ids = self._read_ids(classes, names)
        return LabelReader(ids, partial(_advise, None if self.label_classes else names, ids))

    def lacking_ids(self, classes: ClassTable) -> tuple[int, ...]:
        """Return the ids of `lacking`; DatasetError for names that the table does not have."""
        names = [info.name for info in list_classes(classes)]
        if unknown := [name for name in self.lacking if name not in names]:
            raise DatasetError(
                f"lacking: {unknown[0]!r} is no class of model.classes: give some of "
                f"{', '.join(names)}"
            )
        return tuple(map(names.index, self.lacking))

    def _read_ids(self, classes: ClassTable, names: Sequence[str]) -> Mapping[int, int]:
        """Return the id in the class table for each id in the files, `NO_CLASS` for none."""
        if self.label_ids:
            ids = {name: index for index, name in enumerate(names)} | {IGNORED: NO_CLASS}
            if unknown := [name for name in self.label_ids.values() if name not in ids]:
                raise DatasetError(
                    f"label_ids: {unknown[0]!r} is no class of model.classes: give one of "
                    f"{', '.join(ids)}"
                )
            named = {index: ids[name] for index, name in self.label_ids.items()}
            return {self.ignore: NO_CLASS, **named}
        order = list(range(len(names)))
        if self.label_classes is not None:
            lookup = id_lookup(self.label_classes, classes, TRAIN_LABELS)
            order = lookup[: len(TRAIN_LABELS)].tolist()
        return {**dict(enumerate(order)), self.ignore: NO_CLASS}


def _advise(names: Sequence[str] | None, ids: Mapping[int, int], unknown: Sequence[int]) -> str:
    """Advise to name ids in the recipe if they are those of `model.classes`, which has names."""
    if names is None:
        return "give trainIds"
    by_id = dict(enumerate(names))
    known = {id_: by_id.get(index, IGNORED) for id_, index in ids.items()}
    # Ids that no key names may still follow the order of the classes.
    known |= {id_: by_id.get(id_, IGNORED) for id_ in unknown}
    pairs = ", ".join(f"{id_} = {json.dumps(name)}" for id_, name in known.items())
    return f"name the ids in the recipe: label_ids = {{ {pairs} }}"
