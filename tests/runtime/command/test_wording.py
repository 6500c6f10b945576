"""Messages of the library name keywords of Python, those of commands flags."""

import re
from pathlib import Path

import pytest

import runtime
from runtime.command.wording import with_flags


@pytest.mark.parametrize(("text", "printed"), [
    ("give `points=` or `registered=True`", "give --points or registered=true in --source"),
    ("replace it with `overwrite=True`", "replace it with --overwrite"),
    ("`camera=`, `scan_stamp=`, `max_skew_ms=`", "camera=, scan_stamp= in --source, --max-skew-ms"),
    ("try `depth_scale=0.5`", "try depth_scale=0.5 in --source"),
    ("the model without a size, `tolerances=`", "the model without a size, --tolerance"),
    ("points=3/rgb: `points`, `mine=1`, depth=", "points=3/rgb: `points`, `mine=1`, depth="),
])  # fmt: skip
def test_known_keywords_in_backticks_become_flags_and_nothing_else(text, printed):
    assert with_flags(text) == printed


def test_the_library_names_no_flag_and_no_keyword_that_commands_do_not_know():
    root = Path(runtime.__file__).parent
    rooms = "checks streams recordings alignment geometry files verification"
    for path in (path for room in rooms.split() for path in (root / room).rglob("*.py")):
        texts = re.sub(r'""".*?"""|#[^\n]*', "", path.read_text(), flags=re.DOTALL)
        texts = re.sub(r"ssdnet-\w+ --\w+", "", texts)
        assert "--" not in texts, path
        assert "`" not in with_flags(" ".join(re.findall(r"`\w+=[^`]*`", texts))), path
