"""Labels that follow a list of classes: the classes, and what ids or colours in the files mean."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from models import CLASS_TABLES
from models.classes import voc_color
from runtime.base.errors import InputError
from runtime.contract.contract import ClassInfo
from runtime.files.read_input import read_input
from training.base.palette import Palette
from training.datasets.class_list import Color, read_class_list
from training.datasets.class_mapping import IGNORED

_VOC_BORDER = "224,224,192"
# Types of PNGs in a colour for each pixel, with and without transparency.
_RGB_TYPES = (2, 6)


def read_labels(
    path: Path, labels: Path, *, ignore: Collection[str] = (), palette: Palette | None = None
) -> tuple[tuple[ClassInfo, ...], dict[str, Any]]:
    """Return the classes of a list that are learned, and the keys of a set with these labels.

    Args:
        path: the list, see `read_class_list`.
        labels: folder of the labels, whose first file shows whether they are ids or colours.
        ignore: classes that are not learned, in any case of letters.
        palette: colours of the labels; None: those of the list, if the labels are in colours.

    Raises:
        InputError: if the list or a label cannot be read, if `ignore` names others or all, and for
            labels in colours that are not stated, or that two classes have.
    """
    listed = read_class_list(path)
    ignored = {name.casefold() for name in ignore}
    if unknown := ignored - {item.name.casefold() for item in listed}:
        raise InputError(f"--ignore {min(unknown)}: is no class of {path}: give one of its names")
    if IGNORED not in ignored and IGNORED in {item.name.casefold() for item in listed}:
        raise InputError(
            f"{path}: has the class {IGNORED!r}, which stands for pixels without a class: leave it "
            f"out (--ignore {IGNORED}), or give it another name"
        )
    names = [IGNORED if item.name.casefold() in ignored else item.name for item in listed]
    if all(name == IGNORED for name in names):
        raise InputError("--ignore: no class is left to learn: leave out one of them")
    colors = [item.color for item in listed] if palette is None else _palette(palette, path, names)
    classes = tuple(
        ClassInfo(name, color or voc_color(index))
        for index, (name, color) in enumerate(zip(names, colors, strict=True))
        if name != IGNORED
    )
    if palette is None and not _are_colored(labels):
        return classes, {"label_ids": dict(enumerate(names))} if ignored else {}
    return classes, {"label_colors": _by_color(names, colors, path, labels, palette)}


def _by_color(
    names: Sequence[str],
    colors: Sequence[Color | None],
    path: Path,
    labels: Path,
    palette: Palette | None,
) -> Mapping[str, str]:
    table = {_VOC_BORDER: IGNORED} if palette == "voc" else {}
    for name, color in zip(names, colors, strict=True):
        if color is None:
            raise InputError(
                f"{labels}: shows the classes in colours, and {path} does not state that of "
                f"{name}: write it behind the name, {name} 128 64 128, or give --palette"
            )
        key = ",".join(map(str, color))
        if table.setdefault(key, name) != name:
            raise InputError(
                f"{path}: {table[key]} and {name} have the colour {key}, in which labels cannot "
                "be told apart: give each its own"
            )
    return table


def _are_colored(labels: Path) -> bool:
    """Return whether the first label is a PNG with colours instead of ids."""
    listed = labels.iterdir() if labels.is_dir() else ()
    files = [path for path in listed if path.suffix.lower() == ".png"]
    header = read_input(min(files))[:26] if files else b""
    return len(header) > 25 and header[25] in _RGB_TYPES


def _palette(palette: Palette, path: Path, names: Sequence[str]) -> list[Color | None]:
    if palette == "voc":
        return [voc_color(index - 1) for index in range(len(names))]
    known = {info.name: info.color for info in CLASS_TABLES[palette]}
    if missing := [name for name in names if name != IGNORED and name.casefold() not in known]:
        raise InputError(
            f"--palette {palette}: has no colour of {missing[0]}: write the colours into {path}, "
            f"{missing[0]} 128 64 128 (it has {', '.join(known)})"
        )
    return [known.get(name.casefold(), (0, 0, 0)) for name in names]
