"""Lists of classes as people and tools write them: the name of a class a line, in the order of ids.

A line may also have the id before or behind the name, and the colour in which labels show the
class, before or behind both: `road`, `0 road`, `road 128 64 128`, `road,128,64,128`, or
`road:128,64,128::` as in CVAT's labelmap.txt. `drivable = road, pavement` names the classes that a
class unites. Lines that begin with "#" are comments, and a header of a CSV is skipped. Labels show
the classes of a list by their ids or colours.
"""

import json
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from models import CLASS_TABLES
from models.classes import voc_color
from runtime.base.arguments import shown
from runtime.base.errors import InputError
from runtime.contract.contract import ClassInfo
from runtime.files.read_input import read_input, read_text
from training.base.palette import Palette
from training.datasets.class_mapping import IGNORED

Color = tuple[int, int, int]

_GAP = r"\s*[\s,:;]\s*"
_RGB = _GAP.join(rf"(?P<{channel}>\d+)" for channel in ("red", "green", "blue"))
# A line with a colour: of CVAT, whose colour may be empty, and with the colour first or last.
_COLORED = (
    re.compile(rf"(?P<name>[^:]*):(?:{_RGB})?:[^:]*:[^:]*"),
    re.compile(rf"{_RGB}{_GAP}(?P<name>.*\D.*)"),
    re.compile(rf"(?P<name>.*\D.*?){_GAP}{_RGB}"),
)
_NUMBERED = (
    re.compile(rf"(?P<id>\d+){_GAP}(?P<name>.+)"),
    re.compile(rf"(?P<name>.+?){_GAP}(?P<id>\d+)"),
)
_HEADER = re.compile(
    r"(pixel value|class( ?name)?|name|label|(train ?)?id|index|color(_rgb)?|r|g|b|[\s,;:\t])+"
)
# What no name has: the marks of JSON, YAML, XML and CSV.
_MARKS = re.compile(r"""[\[\]{}<>|"'=,:\t]|^-\s""")
# The colour of borders in labels of PASCAL VOC, and the types of PNGs in a colour for each pixel,
# with and without transparency.
_VOC_BORDER, _RGB_TYPES = "224,224,192", (2, 6)
_FORMS = "a class a line: road, 0 road, road 128 64 128, or drivable = road, pavement"


@dataclass(frozen=True)
class ListedClass:
    """A class of a list.

    Attributes:
        name: its name.
        line: the line that names it.
        color: RGB of it in the labels; None: not stated.
        relatives: names of the classes that it unites.
    """

    name: str
    line: int
    color: Color | None = None
    relatives: tuple[str, ...] = ()


def read_class_list(path: Path) -> tuple[ListedClass, ...]:
    """Read a list of classes in the order of their ids.

    Raises InputError for a line that is not understood, ids that are not 0, 1, ..., and a name that
    is given twice.
    """
    text = read_text(path).rstrip()
    listed = [*_read_json(path, text)] if text[:1] in ("[", "{") else [*_read_lines(path, text)]
    listed = _without_ids(path, listed)
    if not listed:
        raise InputError(f"{path}: is empty; expected {_FORMS}")
    first: dict[str, int] = {}
    for item in listed:
        if not item.name or _MARKS.search(item.name):
            raise InputError(
                f"{path}: line {item.line} is not understood ({shown(item.name)}); expected "
                f"{_FORMS}"
            )
        if (line := first.setdefault(item.name.casefold(), item.line)) != item.line:
            raise InputError(
                f"{path}: line {item.line} names {shown(item.name)}, as line {line} does; expected "
                "names that differ beyond upper and lower case"
            )
    return tuple(listed)


def _read_lines(path: Path, text: str) -> Iterator[ListedClass]:
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), 1)]
    lines = [(number, line) for number, line in lines if not line.startswith("#")]
    if lines and "," in lines[0][1] and _HEADER.fullmatch(lines[0][1].lower()):
        del lines[0]
    for number, line in lines:
        name, equals, united = re.sub(r"\s#.*", "", line).partition("=")
        relatives = tuple(part.strip() for part in united.split(","))
        if equals and not all(relatives):
            raise InputError(f"{path}: line {number} unites a class without a name: name it")
        item = ListedClass(name.strip(), number, None, relatives if equals else ())
        for form in _COLORED:
            if found := form.fullmatch(item.name):
                item = _with_color(path, item, found)
                break
        yield item


def _with_color(path: Path, item: ListedClass, found: re.Match[str]) -> ListedClass:
    named = found["name"].strip()
    if found.groupdict().get("red") is None:
        return replace(item, name=named)
    red, green, blue = (int(found[channel][:9]) for channel in ("red", "green", "blue"))
    if max(red, green, blue) > 255:
        raise InputError(
            f"{path}: line {item.line} has the colour {red}, {green}, {blue}; expected red, green "
            "and blue from 0 to 255"
        )
    return replace(item, name=named, color=(red, green, blue))


def _read_json(path: Path, text: str) -> Iterator[ListedClass]:
    """Yield the classes of a list of names, or of a table of ids and names in either order."""
    try:
        found: Any = json.loads(text)
    except ValueError as error:
        raise InputError(f"{path}: is not valid JSON: {error}") from error
    items = found.items() if isinstance(found, Mapping) else enumerate(found)
    for number, (key, value) in enumerate(items, 1):
        if not isinstance(value, str | int):
            raise InputError(f"{path}: entry {number} is no name ({shown(value)}): {_FORMS}")
        yield ListedClass(f"{key} {value}", number)


def _without_ids(path: Path, listed: list[ListedClass]) -> list[ListedClass]:
    """Remove ids if all lines have them, so that the names differ, and sort the classes by them."""
    for form, least in zip(_NUMBERED, (1, 2), strict=True):
        found = [form.fullmatch(item.name) for item in listed]
        numbered = [
            (int(match["id"]), replace(item, name=match["name"].strip()))
            for item, match in zip(listed, found, strict=True)
            if match
        ]
        names = {item.name for _, item in numbered}
        if not least <= len(listed) == len(numbered) == len(names):
            continue
        numbered.sort(key=lambda pair: pair[0])
        for expected, (number, item) in enumerate(numbered):
            if number != expected:
                raise InputError(
                    f"{path}: line {item.line} has the id {number}; expected {expected}: list "
                    "every id from 0 on, and leave classes out by --ignore"
                )
        return [item for _, item in numbered]
    return listed


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
    listed_labels = labels.iterdir() if palette is None and labels.is_dir() else ()
    pictures = [each for each in listed_labels if each.suffix.lower() == ".png"]
    header = read_input(min(pictures))[:26] if pictures else b""
    are_colored = len(header) > 25 and header[25] in _RGB_TYPES
    if palette is None and not are_colored:
        return classes, {"label_ids": dict(enumerate(names))} if ignored else {}
    by_color = {_VOC_BORDER: IGNORED} if palette == "voc" else {}
    for name, color in zip(names, colors, strict=True):
        if color is None:
            raise InputError(
                f"{labels}: shows the classes in colours, and {path} does not state that of "
                f"{name}: write it behind the name, {name} 128 64 128, or give --palette"
            )
        key = ",".join(map(str, color))
        if by_color.setdefault(key, name) != name:
            raise InputError(
                f"{path}: {by_color[key]} and {name} have the colour {key}, in which labels cannot "
                "be told apart: give each its own"
            )
    return classes, {"label_colors": by_color}


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
