"""docs/comparison.md shows code that works: its network and its method go through the tools."""

import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch

from comparison import read_plan, recipe_of
from models import create_model
from models.registry import NETWORKS
from models.registry import Entry as Registered
from training.chosen_recipe import read_stages
from training.evaluation.classical import METHODS
from training.evaluation.scored_model import open_method
from training.network import build_network

PAGE = Path(__file__).parents[1] / "docs" / "comparison.md"


@pytest.fixture
def run_block(monkeypatch):
    """Give a function that runs one of the page's Python blocks as a module."""

    def run(number):
        module = ModuleType(f"block_{number}")
        monkeypatch.setitem(sys.modules, module.__name__, module)  # dataclasses look it up
        exec(blocks("python")[number], module.__dict__)
        return module

    return run


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE.read_text(), re.MULTILINE | re.DOTALL)


def test_the_network_is_built_by_its_name_and_recipe(run_block, tmp_path, monkeypatch):
    module = run_block(0)
    entry = Registered(module.TwoLayers, module.TwoLayersConfig())
    monkeypatch.setitem(NETWORKS, "two-layers", entry)
    assert '"two-layers": Entry(TwoLayers, TwoLayersConfig()),' in PAGE.read_text()
    output = create_model("two-layers").eval()(torch.zeros(1, 3, 40, 50), torch.ones(1, 1, 40, 50))
    assert output.depths[0].shape == (1, 1, 40, 50)
    assert output.semantic_logits is None

    change = re.search(r"ssdnet-train comparison-depth --set '(.*)' --data", PAGE.read_text())
    recipe = read_stages("comparison-depth", [change[1]])[0].recipe
    assert build_network(recipe.model, None).config.channels == 16
    (entry_text,) = blocks("toml")
    (tmp_path / "plan.toml").write_text(entry_text)
    plan = read_plan(tmp_path / "plan.toml", [], None)
    model = recipe_of(plan.entries[0], plan).model
    assert build_network(model, None).config.channels == 32


def test_the_method_is_run_by_its_name(run_block, monkeypatch):
    monkeypatch.setitem(METHODS, "median", run_block(1).Median)
    sparse_depth = np.zeros((40, 50), np.float32)
    sparse_depth[0, :5] = 1, 2, 3, 4, 50
    rgb = np.zeros((40, 50, 3), np.uint8)
    answer = open_method("median").predict(rgb, sparse_depth, None)
    np.testing.assert_array_equal(answer.depth, 3)


def test_every_method_and_link_of_the_page_is_there():
    text = PAGE.read_text()
    named = re.findall(r"^\| `([a-z-]+)` \|", text, re.MULTILINE)
    assert named == list(METHODS)
    for link in re.findall(r"\]\((?!https?://)([^)#]+)", text):
        assert (PAGE.parent / link).exists(), link
