"""The documents are true: README's commands are those of CI, links and pictures exist."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CARD = ROOT / "runtime" / "assets" / "MODEL_CARD.md"
PAGES = sorted((*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), CARD))
PICTURES = sorted((*ROOT.glob("docs/*.jpg"), *ROOT.glob("docs/*.png")))
FENCED = re.compile(r"^```.*?^```", flags=re.MULTILINE | re.DOTALL)


def commands_of_ci():
    script = (ROOT / ".ci" / "run").read_text()
    return dict(re.findall(r"^(COMMAND_[12])='(.*)'$", script, flags=re.MULTILINE))


def shell_blocks():
    readme = (ROOT / "README.md").read_text()
    blocks = re.findall(r"^```bash\n(.*?)^```", readme, flags=re.MULTILINE | re.DOTALL)
    return [block.strip() for block in blocks]


def links(page):
    """(path, anchor) of each relative link and picture of a page, the path from the page."""
    text = FENCED.sub("", page.read_text())
    targets = re.findall(r"\]\(([^)]+)\)", text) + re.findall(r'<img src="([^"]+)"', text)
    relative = [target for target in targets if not target.startswith(("http://", "https://"))]
    return [(target.partition("#")[0], target.partition("#")[2]) for target in relative]


def anchors(page):
    """The anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", FENCED.sub("", page.read_text()), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_first_two_shell_blocks_are_what_ci_runs():
    commands = commands_of_ci()
    assert shell_blocks()[:2] == [commands["COMMAND_1"], commands["COMMAND_2"]]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_relative_link_leads_somewhere(page):
    assert links(ROOT / "README.md")
    for path, anchor in links(page):
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), f"{page.name}: no file {path}"
        assert not anchor or anchor in anchors(target), f"{page.name}: no heading {path}#{anchor}"


@pytest.mark.parametrize("picture", PICTURES, ids=lambda picture: picture.name)
def test_every_picture_is_shown_by_a_page(picture):
    shown = {(page.parent / path).resolve() for page in PAGES for path, _ in links(page) if path}
    assert picture in shown


def test_embedding_example_runs():
    pytest.importorskip("onnxruntime")
    readme = (ROOT / "README.md").read_text()
    (example,) = re.findall(r"^```python\n(.*?)^```", readme, flags=re.MULTILINE | re.DOTALL)
    scope: dict[str, object] = {}
    exec(example, scope)
    assert scope["prediction"].valid
