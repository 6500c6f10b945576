"""Class images of Virtual KITTI: a colour for each category, listed in a text file."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.errors import DatasetError
from runtime.read_input import read_text
from training.datasets.class_mapping import ClassTable, class_ids
from training.datasets.files import dataset_errors, read_rgb, require_size


@dataclass(frozen=True, eq=False)
class ColorTable:
    """Classes of the colours of a file.

    Attributes:
        colors: int32 (n,), ascending, r << 16 | g << 8 | b.
        ids: uint8 (n,).
        path: the file.
    """

    colors: NDArray[np.int32]
    ids: NDArray[np.uint8]
    path: Path


@dataset_errors()
def read_colors(path: Path, classes: ClassTable) -> ColorTable:
    """Read the colours of a file and their ids in the class table `classes`.

    Rows are 'Category r g b', as in Virtual KITTI 2, or 'Category:instance r g b', as in 1.3.1.
    Raises DatasetError for an unknown category and for rows of another form.
    """
    known = class_ids("virtual_kitti", classes)
    found: dict[int, int] = {}
    rows = [line.split() for line in read_text(path).splitlines()[1:] if line.strip()]
    if not rows:
        raise DatasetError(f"{path}: no rows under its header.")
    for row in rows:
        name, values = row[0].split(":")[0], row[-3:]
        if name not in known:
            raise DatasetError(f"{path}: unknown category {name!r}; known: {', '.join(known)}.")
        try:
            red, green, blue = (int(value) for value in values)
        except ValueError as error:
            raise DatasetError(f"{path}: {' '.join(row)!r} is not 'Category r g b'.") from error
        if not all(0 <= value <= 255 for value in (red, green, blue)):
            raise DatasetError(f"{path}: {' '.join(row)!r} has a colour outside 0..255.")
        found[red << 16 | green << 8 | blue] = known[name]
    colors = sorted(found)
    ids = np.array([found[color] for color in colors], dtype=np.uint8)
    return ColorTable(np.array(colors, dtype=np.int32), ids, path)


def read_classes(path: Path, table: ColorTable, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Class ids uint8 (H, W) of a colour image; an unlisted colour is a DatasetError."""
    label = read_rgb(path)
    require_size(path, label.shape, size)
    # Bytes blue, green, red and 0: r << 16 | g << 8 | b as a little-endian integer.
    packed = cv2.cvtColor(label, cv2.COLOR_RGB2BGRA)
    packed[..., 3] = 0
    color = packed.view("<i4").ravel()
    # Neighbouring pixels mostly have one colour: look up each run of equal pixels once.
    starts = np.flatnonzero(np.diff(color, prepend=-1))
    run = color[starts]
    index = np.searchsorted(table.colors, run).clip(max=len(table.colors) - 1)
    unlisted = table.colors[index] != run
    if unlisted.any():
        red, green, blue = label.reshape(-1, 3)[starts[unlisted][0]]
        raise DatasetError(
            f"{path}: colour ({red}, {green}, {blue}) is not in {table.path.name}. "
            "Restore the original file (JPEG compression changes colours)."
        )
    ids: NDArray[np.uint8] = np.repeat(table.ids[index], np.diff(starts, append=color.size))
    return ids.reshape(size)
