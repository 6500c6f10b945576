"""Labels in PNGs: the keys of a recipe that say what their numbers mean."""

import json
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Annotated, Literal, TypeVar

from pydantic import Field
from pydantic.dataclasses import dataclass

from runtime.base.errors import DatasetError
from runtime.contract.contract import NO_CLASS
from training.base.limits import STRICT, NotNegative
from training.datasets.cityscapes import TRAIN_LABELS
from training.datasets.class_list import Color
from training.datasets.class_mapping import (
    IGNORED,
    ClassTable,
    LabelReader,
    file_ids,
    list_classes,
    named_table,
)
from training.datasets.color_reader import ColorReader
from training.datasets.source_recipe import RangeRecipe

T = TypeVar("T")
# A folder, relative to the `path` of its set.
Folder = Annotated[str, Field(min_length=1)]
_Id = Annotated[int, Field(ge=0, le=255)]
_Color = Annotated[str, Field(pattern=r"^\d{1,3}(,\d{1,3}){2}$")]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class LabelledRecipe(RangeRecipe):
    """Options of a set in a recipe that may have a folder of labels.

    Attributes:
        labels: folder of PNGs with ids in `model.classes` or in `label_classes`, see `read_gray`.
        label_classes: "cityscapes": the ids are trainIds, which are mapped to `model.classes`.
        label_ids: name in `model.classes` of each id, or "ignore"; replaces the order of the
            classes.
        label_colors: name in `model.classes` of each colour, or "ignore", for labels in colours: {
            "128,64,128" = "road" }, red, green and blue.
        ignore: id of pixels without a class.
        lacking: classes that images show and labels never have, such as the sky where only a
            LiDAR's returns are labelled; nothing about them is learned from the set.
        semantic_weight: weight of a labelled pixel; below 1 for labels that a network made, above 1
            where few pixels have a label.
    """

    labels: Folder | None = None
    label_classes: Literal["cityscapes"] | None = None
    label_ids: Mapping[_Id, str] | None = None
    label_colors: Mapping[_Color, str] | None = None
    ignore: _Id = NO_CLASS
    lacking: tuple[str, ...] = ()
    semantic_weight: NotNegative = 1.0

    def __post_init__(self) -> None:
        """Check that the ids have one meaning."""
        keys = ("label_ids", "label_classes", "label_colors")
        if len(given := [key for key in keys if getattr(self, key)]) > 1:
            raise ValueError(f"{' and '.join(given)} both name the classes: set one of them")
        if wrong := [text for text in self._colors if max(self._colors[text]) > 255]:
            raise ValueError(f"label_colors has {wrong[0]!r}: expected numbers from 0 to 255")
        if self.ignore != NO_CLASS and (self.label_ids or {}).get(self.ignore, IGNORED) != IGNORED:
            raise ValueError(
                f"ignore and label_ids give the id {self.ignore} two meanings: drop one"
            )

    @property
    def label_table(self) -> ClassTable | None:
        """See `SourceRecipe.label_table`."""
        if self.labels is None:
            return ()
        names = (self.label_ids or self.label_colors or {}).values()
        named = [name for name in names if name != IGNORED]
        own = named_table(dict.fromkeys(named))
        return own or self.label_classes

    @property
    def _colors(self) -> dict[str, Color]:
        channels = {
            text: [int(each) for each in text.split(",")] for text in self.label_colors or ()
        }
        return {text: (red, green, blue) for text, (red, green, blue) in channels.items()}

    def open_labels(self, classes: ClassTable) -> LabelReader | ColorReader:
        """Return the reader of the labels.

        Raises:
            DatasetError: for names of classes that the table does not have.
        """
        names = [info.name for info in list_classes(classes)]
        if self.label_colors:
            named = self._find("label_colors", self.label_colors, names)
            ids_of = {self._colors[text]: index for text, index in named.items()}
            advice = "name each, or list it as a class that is left out by --ignore"
            return ColorReader(ids_of, "label_colors", advice)
        if self.label_ids:
            ids = {self.ignore: NO_CLASS, **self._find("label_ids", self.label_ids, names)}
        elif self.label_classes is not None:
            ids = {**file_ids(self.label_classes, classes, TRAIN_LABELS), self.ignore: NO_CLASS}
        else:
            ids = {**{index: index for index in range(len(names))}, self.ignore: NO_CLASS}
        return LabelReader(ids, partial(_advise, None if self.label_classes else names, ids))

    def lacking_ids(self, classes: ClassTable) -> tuple[int, ...]:
        """Return the ids of `lacking`; DatasetError for names that the table does not have."""
        names = [info.name for info in list_classes(classes)]
        found = self._find("lacking", dict(enumerate(self.lacking)), names).values()
        return tuple(index for index in found if index != NO_CLASS)

    def _find(self, key: str, table: Mapping[T, str], names: Sequence[str]) -> dict[T, int]:
        """Return the class id of each entry of a table; DatasetError for an unknown name."""
        ids = {name: index for index, name in enumerate(names)} | {IGNORED: NO_CLASS}
        if unknown := [name for name in table.values() if name not in ids]:
            raise DatasetError(
                f"{key}: {unknown[0]!r} is no class of model.classes: give one of {', '.join(ids)}"
            )
        return {entry: ids[name] for entry, name in table.items()}


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
