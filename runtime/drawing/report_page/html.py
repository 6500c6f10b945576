"""HTML from the fragments of page.html."""

import re
from functools import cache
from html import escape
from importlib import resources
from string import Template


class Html(str):
    """Text that is HTML: `fill` does not escape it."""

    def __add__(self, other: str) -> "Html":
        return Html(str.__add__(self, other))


def fill(fragment: str, **values: object) -> Html:
    """Return a fragment of page.html with its $names replaced by values.

    Values are escaped, except `Html` and lists of it, which are joined.
    """
    texts = {name: _text(value) for name, value in values.items()}
    return Html(_fragments()[fragment].substitute(texts))


def read_resource(name: str) -> str:
    """Return the text of a file of this package."""
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")


def _text(value: object) -> str:
    if isinstance(value, Html):
        return value
    return "".join(value) if isinstance(value, list) else escape(str(value))


@cache
def _fragments() -> dict[str, Template]:
    parts = re.split(r"(?m)^<!--(\w+)-->\n", read_resource("page.html"))[1:]
    return {
        name: Template(text.removesuffix("\n"))
        for name, text in zip(parts[::2], parts[1::2], strict=True)
    }
