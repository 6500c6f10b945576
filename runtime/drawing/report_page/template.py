"""The templates of this package."""

from collections.abc import Mapping
from functools import cache
from typing import Any

import jinja2


def render(template: str, values: Mapping[str, Any]) -> str:
    """Fill in a template; values are escaped. `|number(".1f")` formats as of `format`."""
    return _templates().get_template(template).render(values)


@cache
def _templates() -> jinja2.Environment:
    templates = jinja2.Environment(
        loader=jinja2.PackageLoader("runtime.drawing", "report_page"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
    )
    templates.filters |= {"number": format, "ms": _milliseconds}
    return templates


def _milliseconds(value: float | None) -> str:
    if value is None:
        return "n/a"
    return format(value, ".2f" if value < 10 else ".1f" if value < 1000 else ",.0f")
