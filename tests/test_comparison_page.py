"""docs/comparison.md shows a network that works, and names every classical method."""

import re
import sys
from pathlib import Path
from types import ModuleType

import torch

from models import create_model
from models.registry import NETWORKS
from models.registry import Entry as Registered
from training.chosen_recipe import read_stages
from training.evaluation.classical import METHODS
from training.network import build_network

PAGE = (Path(__file__).parents[1] / "docs" / "comparison.md").read_text()


def test_the_network_is_built_by_its_name_and_recipe(monkeypatch):
    (code,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    module = ModuleType("two_layers")
    monkeypatch.setitem(sys.modules, module.__name__, module)  # dataclasses look it up
    exec(code, module.__dict__)
    entry = Registered(module.TwoLayers, module.TwoLayersConfig())
    monkeypatch.setitem(NETWORKS, "two-layers", entry)
    assert '"two-layers": Entry(TwoLayers, TwoLayersConfig()),' in PAGE
    output = create_model("two-layers").eval()(torch.zeros(1, 3, 40, 50), torch.ones(1, 1, 40, 50))
    assert output.depths[0].shape == (1, 1, 40, 50)
    assert output.semantic_logits is None

    change = re.search(r"ssdnet-train comparison-depth --set '(.*)' --data", PAGE)
    recipe = read_stages("comparison-depth", [change[1]])[0].recipe
    assert build_network(recipe.model, None).config.channels == 16


def test_the_table_names_every_method():
    assert re.findall(r"^\| `([a-z-]+)` \|", PAGE, re.MULTILINE) == list(METHODS)
