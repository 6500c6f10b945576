"""Text from a template of this package."""

import re
import string
from collections.abc import Mapping
from functools import cache
from html import escape
from importlib import resources
from typing import Any

_TAG = re.compile(
    r"""
    {{>(?P<file>[\w.]+)}}
    | {{\#(?P<names>[\w, ]+)[ ]in[ ](?P<items>[\w.[\]]+)}}(?P<each>.*?){{/(?P=names)}}
    | {{(?P<sign>[?!])(?P<condition>[\w.[\]]+)}}(?P<then>.*?){{/(?P=condition)}}
    | {{(?P<value>[\w.[\]]+(?::[^}]+)?)}}
    """,
    re.DOTALL | re.VERBOSE,
)


class _Formatter(string.Formatter):
    """Joins lists, and formats milliseconds by `ms`."""

    def format_field(self, value: Any, format_spec: str) -> str:
        if isinstance(value, list | tuple):
            return ", ".join(map(str, value))
        if format_spec != "ms":
            return format(value, format_spec)
        if value is None:
            return "n/a"
        return format(value, ".2f" if value < 10 else ".1f" if value < 1000 else ",.0f")


_FORMATTER = _Formatter()


def render(template: str, values: Mapping[str, Any]) -> str:
    """Fill in a template.

    - `{{name}}`, `{{name.attribute}}`, `{{name[key]}}`, `{{name:format}}`: a value as of
      `str.format`, escaped. A list is joined by commas; `ms` formats milliseconds.
    - `{{#name in names}}...{{/name}}`: what is between for each item; `{{#key, value in pairs}}`
      for each pair of a mapping, or each tuple of a list.
    - `{{?name}}...{{/name}}`: what is between if the value is true, `{{!name}}...{{/name}}` if not.
    - `{{>file}}`: another template.
    """
    return _fill(_read(template), values)


def _fill(text: str, values: Mapping[str, Any]) -> str:
    def look_up(path: str) -> Any:
        return _FORMATTER.get_field(path, (), values)[0]

    def fill(tag: re.Match[str]) -> str:
        if tag["file"]:
            return render(tag["file"], values)
        if tag["value"]:
            return escape(_FORMATTER.vformat(f"{{{tag['value']}}}", (), values))
        if tag["condition"]:
            shown = bool(look_up(tag["condition"])) == (tag["sign"] == "?")
            return _fill(tag["then"], values) if shown else ""
        items, names = look_up(tag["items"]), tag["names"].split(", ")
        rows = items.items() if isinstance(items, Mapping) else items
        named = (zip(names, row if len(names) > 1 else [row], strict=True) for row in rows)
        return "".join(_fill(tag["each"], {**values, **dict(pairs)}) for pairs in named)

    return _TAG.sub(fill, text)


@cache
def _read(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")
