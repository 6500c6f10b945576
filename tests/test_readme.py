"""The documents are true: commands, links, pictures, files and imports that they name exist."""

import ast
import importlib
import re
from pathlib import Path

import pytest

from training.evaluation.classical import METHODS
from training.recipes.chosen_recipe import read_stages
from training.recipes.registry import RECIPES

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


SET = re.compile(r"--set '([^']*)'")


def changed_recipes(page):
    """(recipe, changes) of each command with `--set` of a page; a paragraph is one command."""
    for paragraph in page.read_text().split("\n\n"):
        text = " ".join(paragraph.split())
        if not (changes := SET.findall(text)):
            continue
        trained = re.search(r"ssdnet-train (\S+)", text)
        assert trained, f"{page.name}: no recipe for {changes}"
        yield trained[1], changes


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


def test_the_card_which_is_in_the_wheel_has_no_links_out_of_it():
    assert links(CARD) == []


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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_file_that_a_page_names_is_there(page):
    folders = "models|training|export|runtime|tests|benchmarks|examples"
    named = re.findall(rf"\b(?:{folders})/[\w/.-]+\.(?:py|toml|pt)\b", page.read_text())
    named = [path for path in named if "NAME" not in path]
    assert [path for path in named if not (ROOT / path).exists()] == []
    assert named or page.name not in ("CONTRIBUTING.md", "performance.md")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_module_that_a_page_names_is_there(page):
    """A page may write only the end of a path, for example below the heading of its folder."""
    named = re.findall(r"`((?:[a-z_]\w*/)*\w+\.py)`", page.read_text())
    there = ["/" + path.relative_to(ROOT).as_posix() for path in ROOT.glob("*/**/*.py")]
    assert [name for name in named if not any(path.endswith(f"/{name}") for path in there)] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_what_the_code_of_a_page_imports_is_there(page):
    blocks = re.findall(r"^```python\n(.*?)^```", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    ours = ("runtime", "models", "training", "export")
    for block in blocks:
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.ImportFrom) and node.module.partition(".")[0] in ours:
                module = importlib.import_module(node.module)
                for name in node.names:
                    assert hasattr(module, name.name), f"{page.name}: {node.module}.{name.name}"


@pytest.mark.parametrize(
    ("recipe", "changes"),
    [
        pytest.param(name, changes, id=f"{page.stem}-{name}")
        for page in PAGES
        for name, changes in changed_recipes(page)
    ],
)
def test_changes_of_recipes_are_taken(recipe, changes):
    read_stages(recipe, changes)


def test_the_page_of_comparisons_names_every_method():
    page = (ROOT / "docs" / "comparison.md").read_text()
    assert re.findall(r"^\| `([a-z-]+)` \|", page, flags=re.MULTILINE) == list(METHODS)


def test_the_page_of_training_names_every_recipe():
    page = (ROOT / "docs" / "training.md").read_text().partition("\n## Recipes\n")[2]
    rows = re.findall(r"^\| (`.*?) \|", page.partition("\n## ")[0], flags=re.MULTILINE)
    named = re.findall(r"`([a-z-]+)`", " ".join(rows))
    assert sorted(named) == sorted(name for name in RECIPES if not name.startswith("ablation-"))
