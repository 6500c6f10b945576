"""HTML pages without external resources, made from templates."""

from collections.abc import Mapping
from typing import Any

from runtime.command.wording import with_flags


def render_template(package: str, template: str, values: Mapping[str, Any]) -> str:
    """Fill in a template; values are escaped, and a missing value is an error.

    Args:
        package: package whose folder `templates` holds the file. A template may include those of
            `runtime.command`: the style page.css and the line chart chart.html.
        template: name of the file.
        values: the values by the names in the template.
    """
    import jinja2  # imported here because only a page needs it

    templates = jinja2.Environment(
        loader=jinja2.ChoiceLoader(
            [jinja2.PackageLoader(each) for each in (package, "runtime.command")]
        ),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
    )
    templates.filters |= {"number": format, "ms": _milliseconds}
    return with_flags(templates.get_template(template).render(values))


def _milliseconds(value: float | None) -> str:
    if value is None:
        return "n/a"
    return format(value, ".2f" if value < 10 else ".1f" if value < 1000 else ",.0f")
