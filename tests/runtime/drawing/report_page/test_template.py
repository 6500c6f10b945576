"""A template shows its values as text, in loops and under conditions."""

from types import SimpleNamespace

import pytest

from runtime.drawing.report_page.template import _fill


@pytest.mark.parametrize(
    ("template", "text"),
    [
        ("{{name}}: {{count:,}}", "&lt;b&gt; {{count}}: 1,234"),
        ("{{frame.size}} {{rows[a]}}", "2, 3 1"),
        ("{{#each in pair}}({{each}}){{/each}}", "(x)(y)"),
        (
            "{{#key, n in rows}}{{#each in pair}}{{key}}{{each}}{{n}} {{/each}}{{/key, n}}",
            "ax1 ay1 ",
        ),
        ("{{?count}}some{{/count}}{{!count}}none{{/count}}", "some"),
        ("{{?nothing}}some{{/nothing}}{{!nothing}}none{{/nothing}}", "none"),
        ("{{small:ms}} {{large:ms}} {{count:ms}} {{nothing:ms}}", "1.50 15.0 1,234 n/a"),
    ],
)
def test_a_template_is_filled_in(template, text):
    values = {
        "name": "<b> {{count}}",
        "count": 1234,
        "frame": SimpleNamespace(size=(2, 3)),
        "rows": {"a": 1},
        "pair": ["x", "y"],
        "nothing": None,
        "small": 1.5,
        "large": 15.0,
    }
    assert _fill(template, values) == text
