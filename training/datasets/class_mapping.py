"""Mapping from the labels of a data set to the class table of another one.

A network has one class table, and the labels of every data set in a mixture become its ids: those
of the classes that mean the same, see `class_names`. A pair of data set and table that is missing
here has no mapping. For example, CamVid's car includes trucks and buses, which are separate classes
of Cityscapes.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from models import CLASS_TABLES
from models.training_facts import TrainingFacts
from runtime.base.errors import DatasetError
from runtime.contract.contract import NO_CLASS, ClassInfo
from training.datasets.class_names import relatives
from training.datasets.files import read_gray

# A name in `models.CLASS_TABLES`, or a table.
ClassTable = str | tuple[ClassInfo, ...]

# The names of these tables, as options take them.
TableName = Literal["camvid", "cityscapes", "virtual_kitti"]

# The name that stands for pixels without a class; no class is called so.
IGNORED = "ignore"

# The labels of each data set, as its files name them.
_LABELS: Mapping[str, tuple[str, ...]] = {
    "camvid": tuple(info.name for info in CLASS_TABLES["camvid"]),
    "cityscapes": tuple(info.name for info in CLASS_TABLES["cityscapes"]),
    "virtual_kitti": (
        *(info.name.title().replace(" ", "") for info in CLASS_TABLES["virtual_kitti"]),
        # Except the last one, which is no class, these occur only in rendered scenes.
        *("Pavement", "Fence", "Pedestrian", "Cyclist", "Undefined"),
    ),
}
# The tables to which the labels of each data set are mapped, by the relatives of their names.
_TABLES: Mapping[ClassTable, tuple[str, ...]] = {
    "camvid": ("camvid",),
    "cityscapes": ("camvid", "cityscapes"),
    "virtual_kitti": ("camvid", "cityscapes", "virtual_kitti"),
}
# For each table, the labels that are ignored in spite of a relative. Cityscapes' fences are no
# guard rails, and it labels the rider and the bicycle separately.
_IGNORED = {"cityscapes": ("GuardRail", "Cyclist")}


def named_table(classes: str | Iterable[str]) -> ClassTable:
    """Return a table by its name, or one of classes with these names, without colours."""
    if isinstance(classes, str):
        return classes
    return tuple(ClassInfo(name, (0, 0, 0)) for name in classes)


def list_classes(table: ClassTable) -> tuple[ClassInfo, ...]:
    """Return the classes of a table in the order of their ids."""
    return CLASS_TABLES[table] if isinstance(table, str) else table


def trained_classes(classes: tuple[ClassInfo, ...], facts: TrainingFacts) -> ClassTable:
    """Return the classes of a file's training: a name in `models.CLASS_TABLES`, or its own table.

    A network without a semantic head learned the boundaries of these classes, too. If the file does
    not name the classes, they are CamVid's.

    Args:
        classes: classes of the file's semantic head.
        facts: what the file says about its training.
    """
    if not classes:
        return facts.classes
    names = [info.name for info in classes]  # files may have other colours
    for name, table in CLASS_TABLES.items():
        if [info.name for info in table] == names:
            return name
    return classes


def is_mapped(labels: ClassTable, table: ClassTable) -> bool:
    """Whether the labels of a data set are mapped to a class table."""
    return table in _TABLES.get(labels, ())


def class_ids(labels: str, table: ClassTable) -> dict[str, int]:
    """Return the id in a class table for every label of a data set.

    Args:
        labels: "camvid", "cityscapes" or "virtual_kitti" (also for rendered scenes).
        table: the class table; a user's own table has no mapping.

    Returns:
        The ids by label; 255 = ignored.

    Raises:
        DatasetError: if the labels are not mapped to the table.
    """
    if not isinstance(table, str) or not is_mapped(labels, table):
        name = repr(table) if isinstance(table, str) else "a table of its own"
        raise DatasetError(
            f"the labels of {labels} are not mapped to the classes of {name}: set the recipe's "
            f"model.classes to one of {', '.join(_TABLES[labels])}, or leave the set out"
        )
    names, ids = [info.name for info in CLASS_TABLES[table]], dict[str, int]()
    for label in _LABELS[labels]:
        found = relatives(re.sub("(?<=[a-z])(?=[A-Z])", " ", label), names)
        is_ignored = not found or label in _IGNORED.get(table, ())
        ids[label] = NO_CLASS if is_ignored else names.index(found[0])
    return ids


def file_ids(labels: str, table: ClassTable, order: Sequence[str | None]) -> dict[int, int]:
    """Return the id in a class table for every id in the files of a data set; 255 = ignored.

    `order` holds the labels in the order of the files' ids, from 0; None: no class.
    """
    ids = class_ids(labels, table)
    return {index: NO_CLASS if label is None else ids[label] for index, label in enumerate(order)}


class LabelReader:
    """Reads label files, uint8 PNG, as ids of a class table, 255 = ignored.

    Args:
        ids: the class of each id in the files.
        advise: returns what to do about ids that are not among these, besides correcting the file;
            None: the original files are needed.
    """

    def __init__(
        self, ids: Mapping[int, int], advise: Callable[[Sequence[int]], str] | None = None
    ) -> None:
        self._ids, self._advise = ids, advise
        self._lookup = np.full(256, NO_CLASS, np.uint8)
        self._lookup[list(ids)] = list(ids.values())
        self._known = np.isin(np.arange(256), list(ids))

    def read(self, path: Path, size: tuple[int, int]) -> NDArray[np.uint8]:
        """Read the class ids of an image of (height, width): uint8 (H, W).

        Raises DatasetError for another kind of file or size, and for ids without a meaning.
        """
        label = read_gray(path, np.uint8, size)
        unknown = np.unique(label[~self._known[label]]).tolist()
        if unknown:
            advice = self._advise(unknown) if self._advise else "give the original files"
            raise DatasetError(
                f"{path}: class id {unknown[-1]}, expected {', '.join(map(str, self._ids))}: "
                f"correct the file, or {advice}"
            )
        classes: NDArray[np.uint8] = self._lookup[label]
        return classes
