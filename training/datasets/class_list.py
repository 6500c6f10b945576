"""Lists of classes as people and tools write them: the name of a class a line, in the order of ids.

A line may also have the id before or behind the name, and the colour in which labels show the
class, before or behind both: `road`, `0 road`, `road 128 64 128`, `road,128,64,128`, or
`road:128,64,128::` as in CVAT's labelmap.txt. `drivable = road, pavement` names the classes that a
class unites. Lines that begin with "#" are comments, and a header of a CSV is skipped.
"""

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from runtime.base.arguments import shown
from runtime.base.errors import InputError
from runtime.files.read_input import read_text

Color = tuple[int, int, int]

_GAP = r"\s*[\s,:;]\s*"
_RGB = rf"(\d+){_GAP}(\d+){_GAP}(\d+)"
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
    named, channels = found["name"].strip(), [part for part in found.groups() if part is not None]
    channels.remove(found["name"])
    if not channels:
        return replace(item, name=named)
    red, green, blue = (int(channel[:9]) for channel in channels)
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
