"""A network is one file and one line: tiny ones go through every tool."""

import json

import pytest
import torch
from torch import nn
from typer.testing import CliRunner

from export.exporter import export_checkpoint
from layouts import virtual_kitti
from models import (
    Network,
    NetworkConfig,
    NetworkOutput,
    create_model,
    list_models,
    load_checkpoint,
    save_checkpoint,
)
from models.answers import head_maps
from models.blocks import ConvBNReLU, pad_to_multiple
from models.classes import numbered_classes
from models.registry import NETWORKS, Entry
from runtime.base.errors import CheckpointError
from runtime.contract.contract import ClassInfo
from training.commands.train import app
from training.evaluation import cli as evaluation_cli
from training.run.network import ModelRecipe, build_network
from training.weights.initial_weights import read_weights

FEATURES = 16


class TinySemantic(Network):
    """Classes from RGB alone, on a quarter of the picture's grid."""

    heads = ("semantic",)
    stride = 4
    semantic_stride = 4

    def __init__(self, config):
        super().__init__(config)
        self.layer = ConvBNReLU(3, FEATURES, stride=4)
        self.semantic_head = nn.Conv2d(FEATURES, config.num_classes, 1)

    def predict_coarse(self, rgb, sparse_depth):
        x = pad_to_multiple(self.normalise_rgb(rgb), self.stride)
        return NetworkOutput(semantic_logits=self.semantic_head(self.layer(x)))


class TinyDepth(Network):
    """Depth from the sparse depth alone, at full size."""

    heads = ("depth",)
    stride = 1

    def __init__(self, config):
        super().__init__(config)
        self.layer = ConvBNReLU(2, FEATURES)
        self.depth_head = nn.Conv2d(FEATURES, 1, 1)

    def predict_coarse(self, rgb, sparse_depth):
        depth, valid_mask = self.normalise_depth(sparse_depth)
        features = self.layer(torch.cat((depth, valid_mask.to(depth.dtype)), dim=1))
        return NetworkOutput(depths=(torch.sigmoid(self.depth_head(features)),))


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    monkeypatch.setitem(
        NETWORKS, "tiny-semantic", Entry(TinySemantic, NetworkConfig("tiny-semantic"))
    )
    monkeypatch.setitem(
        NETWORKS, "tiny-depth", Entry(TinyDepth, NetworkConfig("tiny-depth", classes=()))
    )


RECIPE = """
terms = "for tests"
[model]
name = "{name}"
[data]
batch_size = 4
workers = 0
source = [{{ kind = "rendered", path = "rendered" }}]
[data.augment]
crop = [32, 64]
scale = [1.0, 1.2]
[schedule]
steps = 10
[loop]
ema_decay = 0.5
log_every = 1
[release]
logit_adjustment = 0.5
[validation]
every = 5
source = [{{ kind = "rendered", path = "rendered" }}]
"""


@pytest.mark.slow
def test_a_network_of_one_head_goes_through_every_tool(tmp_path):
    """It predicts classes alone; test_new_head.py has a network of another head alone."""
    name = "tiny-semantic"
    virtual_kitti.write_second_edition(tmp_path / "rendered", magnify=5)
    recipe = tmp_path / "tiny.toml"
    recipe.write_text(RECIPE.format(name=name))
    run = [str(recipe), "--data", str(tmp_path), "--out", str(tmp_path / "run")]
    result = CliRunner().invoke(app, run)
    assert result.exit_code == 0, result.output
    path = tmp_path / "run/model.pt"
    network = load_checkpoint(path).model
    assert type(network) is NETWORKS[name].network

    report = export_checkpoint(path, tmp_path / "m.onnx", size=(47, 62), dynamic=True)
    assert report.heads == ("semantic",)
    assert report.contract.model_name == "run", "named by the folder of the run"

    data = f"rendered:{tmp_path / 'rendered'}"
    models = [str(path), str(tmp_path / "m.onnx")]
    arguments = [*models, "--data", data, "--json", str(tmp_path / "scores.json")]
    result = CliRunner().invoke(evaluation_cli.app, arguments)
    assert result.exit_code == 0, result.output
    rows = json.loads((tmp_path / "scores.json").read_text())
    of_network, of_file = (row["figures"] for row in rows)
    assert of_network["miou"] == pytest.approx(of_file["miou"], rel=1e-3)
    assert not any(key.startswith("boundary") for key in of_network)


def test_a_loss_of_which_no_term_has_a_head_is_refused(tmp_path):
    virtual_kitti.write_second_edition(tmp_path / "rendered", magnify=5)
    (tmp_path / "tiny.toml").write_text(RECIPE.format(name="tiny-depth"))
    arguments = ["--data", str(tmp_path), "--out", str(tmp_path / "run")]
    arguments += ["--set", "loss.weights.depth = 0.0"]
    result = CliRunner().invoke(app, [str(tmp_path / "tiny.toml"), *arguments])
    assert result.exit_code == 1
    assert "no loss term with a weight above 0 applies to the heads of 'tiny-" in result.output
    assert not (tmp_path / "run").exists()


class OtherSemantic(TinySemantic):
    """The same layers, read in another way."""


def test_weights_of_another_network_are_not_taken_over(tmp_path, monkeypatch):
    monkeypatch.setitem(NETWORKS, "tiny-other", Entry(OtherSemantic, NetworkConfig("tiny-other")))
    save_checkpoint(tmp_path / "other.pt", create_model("tiny-other"))
    with pytest.raises(CheckpointError, match="none of its layers fits the recipe's 'tiny-sem"):
        build_network(ModelRecipe("tiny-semantic"), read_weights(tmp_path / "other.pt"))


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        ("ssd", {}, "ssdnet-lite"),
        ("tiny-semantic", {"boundary_gating": False}, "network 'tiny-semantic': boundary_gating"),
        ("tiny-depth", {"classes": numbered_classes(4)}, "exactly when there is a semantic head"),
    ],
)
def test_what_create_model_cannot_build_is_named(name, changes, message):
    with pytest.raises(ValueError, match=message):
        create_model(name, **changes)


def test_create_model_changes_the_configuration():
    assert create_model("tiny-depth", max_depth_m=60).config.max_depth_m == 60
    network = create_model("ssdnet-lite", classes=numbered_classes(19))
    assert network.semantic_head.out_channels == 19


@pytest.mark.parametrize("name", list_models())
def test_every_network_meets_the_contract_of_the_base(name):
    """A network has the heads that it names, and its class scores come from semantic_head."""
    with torch.device("meta"):
        model = create_model(name).eval()
        output = model(torch.empty(1, 3, 65, 97), torch.empty(1, 1, 65, 97))
    maps = head_maps(output)
    assert maps.keys() == set(model.heads)
    assert all(answer.shape[-2:] == (65, 97) for answer in maps.values())
    if "semantic" in maps:
        assert model.semantic_head.bias.shape == (model.config.num_classes,)
    assert type(model.config).from_dict(model.config.to_dict()) == model.config


@pytest.mark.parametrize(("classes", "text"), [
    (("road", "car"), r"classes\[0\] must be a ClassInfo"), (3, "classes must be a sequence"),
    ("road", "classes must be a sequence"),
    ((ClassInfo("Car", (1, 2, 3)), ClassInfo("car", (1, 2, 4))), "names that differ beyond case"),
    ((ClassInfo("STRASSE", (1, 2, 3)), ClassInfo("straße", (1, 2, 4))), "differ beyond case"),
], ids=str)  # fmt: skip
def test_classes_of_another_kind_are_refused(classes, text):
    with pytest.raises(ValueError, match=text):
        create_model("ssdnet-nano", classes=classes)
