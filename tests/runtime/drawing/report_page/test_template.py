"""The page's templates show values as text; a value that is missing is an error."""

import jinja2
import pytest

from runtime.drawing.report_page.template import _templates, render


@pytest.mark.parametrize(
    ("template", "text"),
    [
        ("{{ name }}: {{ count|number(',') }}", "&lt;b&gt; {{ count }}: 1,234"),
        ("{{ small|ms }} {{ large|ms }} {{ count|ms }} {{ nothing|ms }}", "1.50 15.0 1,234 n/a"),
    ],
)
def test_values_are_escaped_and_formatted(template, text):
    values = {
        "name": "<b> {{ count }}",
        "count": 1234,
        "nothing": None,
        "small": 1.5,
        "large": 15.0,
    }
    assert _templates().from_string(template).render(values) == text


def test_a_missing_value_is_an_error():
    with pytest.raises(jinja2.UndefinedError, match="bars"):
        render("strip.html", {})
