"""Mapping from the labels of a data set to the class table of another one.

A network has one class table, and the labels of every data set in a mixture become its ids. A pair
of data set and table that is missing here has no mapping. For example, CamVid's car includes trucks
and buses, which are separate classes of Cityscapes.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from models import CLASS_TABLES
from models.training_facts import TrainingFacts
from runtime.base.errors import DatasetError
from runtime.contract.contract import NO_CLASS, ClassInfo
from training.datasets.files import read_gray

# A name in `models.CLASS_TABLES`, or a table.
ClassTable = str | tuple[ClassInfo, ...]

# The names of these tables, as options take them.
TableName = Literal["camvid", "cityscapes", "virtual_kitti"]

# The name that stands for pixels without a class; no class is called so.
IGNORED = "ignore"

_Names = Mapping[str, str | None]


def _joined(classes: Mapping[str | None, Sequence[str]]) -> _Names:
    """Turn a mapping from classes to their labels into one from labels to classes."""
    return {label: name for name, labels in classes.items() for label in labels}


# For each (data set, table): the class of each label of the data set, None if it is ignored.
_MAPPINGS: Mapping[tuple[str, str], _Names] = {
    ("camvid", "camvid"): {info.name: info.name for info in CLASS_TABLES["camvid"]},
    ("cityscapes", "cityscapes"): {info.name: info.name for info in CLASS_TABLES["cityscapes"]},
    # As in the SegNet mapping, walls join building and terrain joins tree (CamVid's
    # VegetationMisc); riders and two-wheelers become bicyclist.
    ("cityscapes", "camvid"): _joined(
        {
            "road": ["road"],
            "pavement": ["sidewalk"],
            "building": ["building", "wall"],
            "fence": ["fence"],
            "pole": ["pole"],
            "sign": ["traffic light", "traffic sign"],
            "tree": ["vegetation", "terrain"],
            "sky": ["sky"],
            "pedestrian": ["person"],
            "bicyclist": ["rider", "motorcycle", "bicycle"],
            "car": ["car", "truck", "bus", "train"],
        }
    ),
    ("virtual_kitti", "virtual_kitti"): {
        # The names are those in Virtual KITTI's files; the ignored classes occur only in rendered
        # scenes.
        **{info.name.title().replace(" ", ""): info.name for info in CLASS_TABLES["virtual_kitti"]},
        **dict.fromkeys(("Pavement", "Fence", "Pedestrian", "Cyclist", "Undefined")),
    },
    ("virtual_kitti", "camvid"): _joined(
        {
            "sky": ["Sky"],
            "building": ["Building"],
            "pole": ["Pole"],
            "road": ["Road"],
            "pavement": ["Pavement"],
            "tree": ["Tree", "Vegetation", "Terrain"],
            "sign": ["TrafficSign", "TrafficLight"],
            "fence": ["Fence", "GuardRail"],
            "car": ["Car", "Van", "Truck"],
            "pedestrian": ["Pedestrian"],
            "bicyclist": ["Cyclist"],
            None: ["Misc", "Undefined"],
        }
    ),
    # Cityscapes labels the rider and the bicycle separately; here they are one class.
    ("virtual_kitti", "cityscapes"): _joined(
        {
            "sky": ["Sky"],
            "building": ["Building"],
            "pole": ["Pole"],
            "road": ["Road"],
            "sidewalk": ["Pavement"],
            "vegetation": ["Tree", "Vegetation"],
            "terrain": ["Terrain"],
            "traffic sign": ["TrafficSign"],
            "traffic light": ["TrafficLight"],
            "fence": ["Fence"],
            "car": ["Car", "Van"],
            "truck": ["Truck"],
            "person": ["Pedestrian"],
            None: ["GuardRail", "Cyclist", "Misc", "Undefined"],
        }
    ),
}


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
    return (labels, table) in _MAPPINGS


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
        known = sorted(t for s, t in _MAPPINGS if s == labels)
        name = repr(table) if isinstance(table, str) else "a table of its own"
        raise DatasetError(
            f"the labels of {labels} are not mapped to the classes of {name}: set the recipe's "
            f"model.classes to one of {', '.join(known)}, or leave the set out"
        )
    ids = {info.name: index for index, info in enumerate(CLASS_TABLES[table])}
    mapping = _MAPPINGS[labels, table]
    return {label: NO_CLASS if name is None else ids[name] for label, name in mapping.items()}


def id_lookup(labels: str, table: ClassTable, order: Sequence[str | None]) -> NDArray[np.uint8]:
    """Return a look-up table (256,) from a file's ids to those of the class table.

    `order` holds the labels in the order of the file's ids, from 0.
    """
    ids = class_ids(labels, table)
    lookup = np.full(256, NO_CLASS, dtype=np.uint8)
    for index, label in enumerate(order):
        if label is not None:
            lookup[index] = ids[label]
    return lookup


class LabelReader:
    """Reads label files, uint8 PNG, as ids of a class table, 255 = ignored.

    Args:
        ids: the class of each id in the files.
        advise: returns what to do about ids that are not among these, besides correcting the file;
            None: the original files are needed.
    """

    def __init__(
        self,
        ids: Mapping[int, int],
        advise: Callable[[Sequence[int]], str] | None = None,
    ) -> None:
        self._ids, self._advise = ids, advise
        self._lookup = np.full(256, NO_CLASS, np.uint8)
        self._lookup[list(ids)] = list(ids.values())
        self._known = np.isin(np.arange(256), list(ids))

    @classmethod
    def of(cls, labels: str, classes: ClassTable, order: Sequence[str | None]) -> Self:
        """Return the reader of a data set's files; `order` as in `id_lookup`."""
        return cls(dict(enumerate(id_lookup(labels, classes, order)[: len(order)].tolist())))

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
