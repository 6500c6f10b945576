"""README says what is true: its commands are the ones that CI runs."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def commands_of_ci():
    script = (ROOT / ".ci" / "run").read_text()
    return dict(re.findall(r"^(COMMAND_[12])='(.*)'$", script, flags=re.MULTILINE))


def shell_blocks():
    readme = (ROOT / "README.md").read_text()
    blocks = re.findall(r"^```bash\n(.*?)^```", readme, flags=re.MULTILINE | re.DOTALL)
    return [block.strip() for block in blocks]


def test_first_two_shell_blocks_are_what_ci_runs():
    commands = commands_of_ci()
    assert shell_blocks()[:2] == [commands["COMMAND_1"], commands["COMMAND_2"]]


def test_every_relative_link_leads_somewhere():
    readme = (ROOT / "README.md").read_text()
    links = re.findall(r"\]\((?!https?://|#)([^)#]+)", readme)
    assert links
    missing = [link for link in links if not (ROOT / link).exists()]
    assert not missing


def test_embedding_example_runs():
    pytest.importorskip("onnxruntime")
    readme = (ROOT / "README.md").read_text()
    (example,) = re.findall(r"^```python\n(.*?)^```", readme, flags=re.MULTILINE | re.DOTALL)
    scope: dict[str, object] = {}
    exec(example, scope)
    assert scope["prediction"].valid
