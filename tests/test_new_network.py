"""A package of one's own adds a network, a loss and a data set by entry points, without a fork."""

import sys

import pytest

from export.exporter import export_checkpoint
from models import create_model, list_models, load_checkpoint
from runtime import InputError, Predictor
from training import train
from training.chosen_recipe import read_stages
from training.datasets.any_source import parse_data

LAB = '''
from typing import Literal
from pathlib import Path
import numpy as np
import torch
from pydantic.dataclasses import dataclass
from torch import nn
from models import Network, NetworkConfig, NetworkOutput
from models.registry import Entry
from training.datasets.sample import Sample, make_frame
from training.datasets.source_recipe import SourceRecipe
from training.limits import STRICT, Positive
from training.losses.terms import Term


class Flat(Network):
    """Depth from the image, on half of its grid."""

    heads, stride, depth_stride = ("depth",), 2, 2

    def __init__(self, config):
        super().__init__(config)
        self.layer = nn.Conv2d(3, 1, 2, stride=2)

    def predict_coarse(self, rgb, sparse_depth):
        height, width = (size + size % 2 for size in rgb.shape[2:])
        padded = nn.functional.pad(
            self.normalise_rgb(rgb), (0, width - rgb.shape[3], 0, height - rgb.shape[2])
        )
        return NetworkOutput(depths=(torch.sigmoid(self.layer(padded)),))


FLAT = Entry(Flat, NetworkConfig("lab-flat", classes=()))
#: Pulls the depth to half of the range.
HALF = Term(frozenset({"depth"}), "depth", lambda c: (c.heads["depth"] - 0.5).square().mean(), 0.0)


class Distances:
    def __init__(self, files, unit_m):
        self.files, self.unit_m = files, unit_m

    def __len__(self):
        return len(self.files)

    def __getitem__(self, index):
        depth = np.full((40, 64), float(self.files[index].read_text()) * self.unit_m, np.float32)
        rgb = np.full((40, 64, 3), 128, np.uint8)
        return Sample(make_frame(rgb, self.files[index].stem), {"depth": depth})


@dataclass(frozen=True, kw_only=True, config=STRICT)
class DistancesRecipe(SourceRecipe):
    kind: Literal["lab-distances"] = "lab-distances"
    unit_m: Positive = 1.0

    def open(self, folder, classes):
        return Distances(sorted(Path(folder).glob("*.txt")), self.unit_m)
'''
ENTRY_POINTS = """
[ssdnet.networks]
lab-flat = lab:FLAT
lab-broken = lab:nothing
lab-wrong = lab:HALF
[ssdnet.losses]
lab-half = lab:HALF
[ssdnet.datasets]
lab-distances = lab:DistancesRecipe
"""
RECIPE = """
model.name = "lab-flat"
[data]
batch_size = 2
workers = 0
augment.crop = [32, 32]
source = [{ kind = "lab-distances", path = "far", unit_m = 2.0 }]
[loss.weights]
lab-half = 0.5
[schedule]
steps = 1
"""


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """The folder of a package that is installed beside this one, as pip leaves it."""
    folder = tmp_path_factory.mktemp("lab")
    (folder / "lab.py").write_text(LAB)
    info = folder / "lab-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: lab\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(ENTRY_POINTS)
    (folder / "far").mkdir()
    (folder / "far" / "a.txt").write_text("20")
    (folder / "recipe.toml").write_text(RECIPE)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        yield folder
    sys.modules.pop("lab", None)


def test_what_a_package_registers_is_trained_and_exported(lab):
    path = train(lab / "recipe.toml", data=lab, out=lab / "run").path
    checkpoint = load_checkpoint(path)
    assert checkpoint.model.config.name == "lab-flat"
    assert checkpoint.facts.recipe["loss"]["weights"]["lab-half"] == 0.5
    assert checkpoint.facts.recipe["data"]["source"][0]["unit_m"] == 2.0
    export_checkpoint(path, lab / "m.onnx", size=(48, 64))
    with Predictor(lab / "m.onnx", warmup=0, threads=1) as predictor:
        assert predictor.heads == ("depth",)
    assert "lab-flat" in list_models()
    assert parse_data("lab-distances:far,unit_m=3").unit_m == 3


@pytest.mark.parametrize(("change", "text"), [
    ("data.source = [{kind = 'lab-distances', path = 'far', unit_m = 0.0}]", "unit_m = 0.0: "),
    ("data.source = [{kind = 'lab-distances', path = 'far', unit = 1}]", "unknown key unit;"),
    ("loss.weights.lab-third = 1", "loss.weights.lab-third: unknown term; known: depth,"),
])  # fmt: skip
def test_its_keys_are_checked_like_those_of_the_package(lab, change, text):
    with pytest.raises(InputError, match=text):
        read_stages(str(lab / "recipe.toml"), [change])


@pytest.mark.parametrize(("name", "text"), [
    ("lab-none", "unknown model 'lab-none'; known: ssdnet.*, lab-flat"),
    ("lab-broken", "ssdnet.networks: lab-broken = lab:nothing: .*no attribute 'nothing'"),
    ("lab-wrong", "lab-wrong = lab:HALF is a Term; expected one of the type Entry"),
])  # fmt: skip
@pytest.mark.usefixtures("lab")
def test_what_cannot_be_loaded_is_named(name, text):
    with pytest.raises(ValueError, match=text):
        create_model(name)
