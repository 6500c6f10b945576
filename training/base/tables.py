"""Tables as TOML has them: merged, built as strictly typed dataclasses, and read from options."""

import contextlib
import json
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from runtime.base.arguments import shown
from runtime.base.errors import InputError

T = TypeVar("T")

# Tags that pydantic adds to the location of an error: the member of a union that it tried. A module
# that defines such a union adds its tags.
TAGS: dict[str, type] = {}


def merge(base: Mapping[str, Any], changes: Mapping[str, Any], place: str = "") -> dict[str, Any]:
    """Merge tables key by key; other values are replaced.

    Raises:
        InputError: for a key of a list of tables: which one of them is not known.
    """
    merged = dict(base)
    for key, value in changes.items():
        below = merged.get(key)
        if isinstance(below, list | tuple) and isinstance(value, Mapping):
            raise InputError(
                f"{place}{key} is a list of {len(below)} and has no key {next(iter(value), '')}: "
                f"edit the file of the recipe, or replace the whole list, --set "
                f"'{place}{key}=[{{...}}]'"
            )
        merged[key] = (
            merge(below, value, f"{place}{key}.")
            if isinstance(below, Mapping) and isinstance(value, Mapping)
            else value
        )
    return merged


def build(kind: type[T], table: object, where: str = "") -> T:
    """Build `kind` from a TOML table, strictly; InputError names the wrong key, after `where`."""
    try:
        # Through JSON: there a list may be a tuple, and "3" is not 3.
        return TypeAdapter(kind).validate_json(json.dumps(table))
    except TypeError as error:  # dates and times
        raise InputError(f"{where}{error}: write text, numbers, true or false") from error
    except ValidationError as error:
        errors = error.errors(include_url=False)
        unknown = [item for item in errors if item["type"] == "unexpected_keyword_argument"]
        raise InputError(where + _describe((unknown or errors)[0], kind)) from error


def parse_pairs(option: str, text: str, kind: Callable[[str], type]) -> tuple[str, dict[str, Any]]:
    """Read HEAD[,KEY=VALUE...]; return the head, and the values as `build` takes them.

    Args:
        option: the option of the command, for messages.
        text: its value.
        kind: head -> the dataclass whose fields are the keys.

    Raises:
        InputError: for a key that is given twice.
    """
    # Commas inside brackets belong to a value.
    head, *pairs = re.split(r",(?=[a-z]\w*=)", text)
    types = {item.name: item.type for item in fields(kind(head))}
    table: dict[str, Any] = {}
    for pair in pairs:
        key, _, value = pair.partition("=")
        if key in table or key in ("kind", "path"):
            raise InputError(f"{option} {text!r}: {key} is given twice: leave one out")
        table[key] = _read_value(value, types.get(key))
    return head, table


def _read_value(text: str, kind: Any) -> Any:
    """Return a value of --data: text if its key takes text, else as TOML reads it."""
    with contextlib.suppress(ValidationError):
        return TypeAdapter(kind).validate_python(text.strip("\"'"))
    with contextlib.suppress(tomllib.TOMLDecodeError):
        return tomllib.loads(f"value = {text}")["value"]
    return text


def quoted(value: Any) -> str:
    """Return a text, a number, a truth value, a list or a table as TOML in a line."""
    if isinstance(value, Mapping):
        pairs = (f"{_key(name)} = {quoted(item)}" for name, item in value.items())
        return f"{{ {', '.join(pairs)} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(quoted, value))}]"
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _key(name: object) -> str:
    return str(name) if re.fullmatch(r"[\w-]+", str(name), re.ASCII) else quoted(str(name))


def to_toml(table: Mapping[str, Any], place: str = "") -> str:
    """Return a table of TOML as text; comments are lost."""
    lines: list[str] = []
    inner: list[str] = []
    for name, value in table.items():
        path = f"{place}{_key(name)}"
        if isinstance(value, Mapping):
            inner += ["", f"[{path}]", to_toml(value, f"{path}.")]
        elif isinstance(value, list) and value and all(isinstance(i, Mapping) for i in value):
            for item in value:
                inner += ["", f"[[{path}]]", *(f"{_key(k)} = {quoted(v)}" for k, v in item.items())]
        else:
            lines.append(f"{_key(name)} = {quoted(value)}")
    return "\n".join((*lines, *inner))


def _describe(error: Mapping[str, Any], kind: Any) -> str:
    """Return the message of an error of pydantic, with its key as in the recipe."""
    place = error["loc"]
    key = _join(place)
    match error["type"]:
        case "unexpected_keyword_argument":
            known = ", ".join(item.name for item in fields(_table_at(kind, place[:-1])))
            return f"unknown key {key}; known here: {known}: correct its name"
        case "registered":  # the keys of another package's data set, checked by `build`
            return f"{key}: {error['ctx']['text']}"
        case "missing":
            return f"missing key {key}: add it"
        case "value_error" if isinstance(error["input"], dict):  # its text starts with the key
            return f"{key + '.' * bool(key)}{error['ctx']['error']}"
        case _:
            return f"{key} = {shown(error['input'], 200)}: {error['msg']}"


def _table_at(kind: Any, place: Sequence[str | int]) -> Any:
    """Return the dataclass of the table at a location below `kind`."""
    for part in place:
        if part in TAGS:
            kind = TAGS[str(part)]
        elif isinstance(part, str):
            kind = next(item.type for item in fields(kind) if item.name == part)
    return kind


def _join(place: Sequence[str | int]) -> str:
    """Return a location as in the recipe, data.source[0].split, without tags of unions."""
    # Of some unions the tags are types, tuple[constrained-int, constrained-int].
    parts = [
        part
        for part in place
        if isinstance(part, int) or (part.isidentifier() and part not in TAGS)
    ]
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in parts)
    return text.removeprefix(".")
