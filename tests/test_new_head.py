"""A package of one's own adds a head, a network, a loss and a data set by entry points.

No code knows the head by name, and it goes all the way.
"""

import csv
import json
import os
import subprocess
import sys

import cv2
import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from export.exporter import export_checkpoint
from models import create_model, list_models, load_checkpoint, save_checkpoint
from runtime import ContractError, InputError, Predictor
from runtime.contract.heads import HEADS
from runtime.drawing.encode import ENCODERS
from runtime.verification.reference import read_reference
from runtime.verification.verify import verify
from training import evaluate, train
from training.datasets.any_source import parse_data
from training.recipes.chosen_recipe import read_stages

# The row alone, which the engine needs: it imports no torch.
ROW = """
from runtime.contract.heads import Difference, Head, Panel, Unit

DRIVABLE = Head(
    "drivable",
    "float32",
    Unit.PROBABILITY,
    resize="bilinear",
    difference=Difference.ABSOLUTE,
    tolerance=4e-4,
    least=0.0,
    most=1.0,
    saved_as="free-space",
    panel=Panel.GRAY,
)
"""
LAB = """
from pathlib import Path
from typing import Literal

import numpy as np
import torch
import torch.nn.functional as F
from pydantic.dataclasses import dataclass
from torch import nn

from models import Network, NetworkConfig, NetworkOutput
from models.blocks import pad_to_multiple
from models.registry import Entry
from training.datasets.sample import Sample, make_frame
from training.datasets.source_recipe import SourceRecipe
from training.base.limits import STRICT, Positive
from training.losses.semantic import labelled_mean
from training.losses.terms import head_term

SIZE = (64, 96)


class Drivable(Network):
    # The new head alone, on half of the image's grid.

    heads = ("drivable",)
    stride = 2
    drivable_stride = 2

    def __init__(self, config):
        super().__init__(config)
        self.layer = nn.Conv2d(4, 1, 3, stride=2, padding=1)

    def predict_coarse(self, rgb, sparse_depth):
        depth, _ = self.normalise_depth(sparse_depth)
        inputs = torch.cat((self.normalise_rgb(rgb), depth), dim=1)
        return NetworkOutput(others={"drivable": self.layer(pad_to_multiple(inputs, 2))})


class Streets:
    # Frames whose lower half is bright and free; a third of their columns is not labelled.
    def __init__(self, count):
        self.count = count

    def __len__(self):
        return self.count

    def __getitem__(self, index):
        rgb = np.random.default_rng(index).integers(0, 60, (*SIZE, 3), dtype=np.uint8)
        rgb[SIZE[0] // 2 :] += 180
        free = (rgb[..., 0] > 100).astype(np.float32)
        free[:, : SIZE[1] // 3] = np.nan
        return Sample(make_frame(rgb, str(index)), {"drivable": free}, weights={"drivable": 0.5})


@dataclass(frozen=True, kw_only=True, config=STRICT)
class StreetsRecipe(SourceRecipe):
    kind: Literal["lab-streets"] = "lab-streets"
    count: Positive = 1.0

    def open(self, folder, classes):
        return Streets(int(self.count))


def drivable_loss(logits, labels, weights):
    known = ~labels.isnan()
    errors = F.binary_cross_entropy_with_logits(logits[:, 0], labels.nan_to_num(), reduction="none")
    return labelled_mean((errors * known).sum(dim=(1, 2)), known.sum(), weights)


NETWORK = Entry(Drivable, NetworkConfig("lab-drivable", classes=()))
LOSS = head_term("drivable", drivable_loss)
"""
ENTRY_POINTS = """
[ssdnet.heads]
drivable = lab_head:DRIVABLE
misnamed = lab_head:DRIVABLE
[ssdnet.networks]
lab-drivable = lab_parts:NETWORK
lab-broken = lab_parts:nothing
lab-wrong = lab_parts:LOSS
[ssdnet.losses]
drivable = lab_parts:LOSS
[ssdnet.datasets]
lab-streets = lab_parts:StreetsRecipe
"""
RECIPE = """
model.name = "lab-drivable"
optimizer.learning_rate = 0.03
schedule = { steps = 5 }
loop = { ema_decay = 0.0, log_every = 1 }
loss.weights.drivable = 2.0
[data]
batch_size = 4
workers = 0
augment = { crop = [32, 48], scale = [0.5, 1.0] }
source = [{ kind = "lab-streets", path = ".", count = 4 }]
[validation]
source = [{ kind = "lab-streets", path = ".", name = "streets", count = 4 }]
lidar = "none"
best = "streets/mean_error_drivable"
"""
SIZE = (64, 96)


@pytest.fixture
def frame():
    rng = np.random.default_rng(0)
    depth = np.where(rng.random(SIZE) < 0.1, 50 * rng.random(SIZE), 0).astype(np.float32)
    return rng.integers(0, 256, (*SIZE, 3), dtype=np.uint8), depth


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Holds the package, the exported file `m.onnx` and the recording `exported`."""
    folder = tmp_path_factory.mktemp("new-head")
    (folder / "lab_head.py").write_text(ROW)
    (folder / "lab_parts.py").write_text(LAB)
    (folder / "recipe.toml").write_text(RECIPE)
    info = folder / "lab_head-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-head\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(ENTRY_POINTS)
    torch.manual_seed(0)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        save_checkpoint(folder / "c.pt", create_model("lab-drivable").eval(), training={})
        options = {"size": SIZE, "record_dir": folder / "exported"}
        report = export_checkpoint(folder / "c.pt", folder / "m.onnx", **options)
        assert report.heads == ("drivable",)
        assert report.parity["drivable"].figures["max_abs"] <= HEADS["drivable"].tolerance
        HEADS.pop("drivable")  # the engine finds it, too
        yield folder
    HEADS.pop("drivable", None)
    for name in ("lab_head", "lab_parts"):
        sys.modules.pop(name, None)


def test_its_row_is_enough_for_the_engine(folder, tmp_path, frame):
    rgb, depth = frame
    with Predictor(folder / "m.onnx") as predictor:
        assert predictor.heads == ("drivable",)
        prediction = predictor.predict(rgb, depth)
        recording = read_reference(folder / "exported")
        report = verify(predictor, recording, tolerances={})
        assert report.figures
        assert report.passed
        resized = predictor.predict(rgb[:48, :72], depth[:48, :72])
    assert resized.network_size == SIZE
    assert resized.heads["drivable"].shape == (48, 72)
    answer = prediction.heads["drivable"]
    assert prediction.valid
    assert (answer.shape, answer.dtype) == (SIZE, np.float32)
    assert 0 < answer.min() < answer.max() < 1

    drawn = prediction.draw(rgb)[24:64, 96:192]  # below the title of the second panel
    np.testing.assert_allclose(drawn, np.repeat(answer[24:, :, None] * 255, 3, axis=2), atol=1)

    prediction.save(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as arrays:
        np.testing.assert_array_equal(arrays["drivable"], answer)
    encoded = np.frombuffer(ENCODERS[HEADS["drivable"].unit](answer), np.uint8)
    png = cv2.imdecode(encoded, cv2.IMREAD_UNCHANGED)
    np.testing.assert_allclose(png / 255, answer, atol=0.5 / 255 + 1e-6)


def test_a_broken_answer_of_it_is_invalid(folder, frame, change_run):
    rgb, depth = frame
    with Predictor(folder / "m.onnx") as predictor:
        for bad, reason in ((np.nan, "drivable_not_finite"), (1.1, "drivable_out_of_range")):
            change_run(lambda run, feed, bad=bad: [np.full_like(each, bad) for each in run()])
            prediction = predictor.predict(rgb, depth)
            assert not prediction.valid
            assert prediction.degraded[-1] == reason


def test_ssdnet_run_saves_and_records_it(folder, tmp_path):
    out, recording = tmp_path / "out", tmp_path / "r"
    arguments = ["--demo", "--limit", "1", "--model", folder / "m.onnx"]
    arguments += ["--out", out, "--record", recording]
    command = "from runtime.app.tools.commands import run; run()"
    result = subprocess.run(
        [sys.executable, "-c", command, *arguments],
        env=os.environ | {"PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stderr
    (saved,) = (out / "free-space").iterdir()
    assert cv2.imread(str(saved), cv2.IMREAD_UNCHANGED).shape == (256, 832)
    limits = json.loads((recording / "recording.json").read_text())["limits"]
    assert limits.keys() == {"drivable"}


def test_it_is_trained_and_scored(folder, tmp_path):
    run = tmp_path / "run"
    checkpoint = load_checkpoint(train(folder / "recipe.toml", data=folder, out=run).path)
    recipe, trained = checkpoint.facts.recipe, checkpoint.model
    assert recipe["loss"]["weights"]["drivable"] == 2.0
    assert recipe["data"]["source"][0]["count"] == 4
    assert "lab-drivable" in list_models()
    assert parse_data("lab-streets:far,count=3").count == 3
    events = EventAccumulator(str(run / "tensorboard"))
    events.Reload()
    shown = {
        name: [item.value for item in events.Scalars(name)] for name in events.Tags()["scalars"]
    }
    assert {name for name in shown if name.startswith("loss/")} == {"loss/drivable", "loss/total"}
    assert shown["loss/total"] == pytest.approx([2 * value for value in shown["loss/drivable"]])
    assert shown["loss/drivable"][-1] < 0.8 * shown["loss/drivable"][0]
    with (run / "scores.csv").open() as file:
        *_, scores = csv.DictReader(file)
    rgb = torch.full((1, 3, *SIZE), 30.0)
    rgb[:, :, SIZE[0] // 2 :] = 210
    with torch.no_grad():
        answer = trained(rgb, torch.zeros(1, 1, *SIZE)).others["drivable"][0, 0].sigmoid().numpy()
    error = np.concatenate([answer[: SIZE[0] // 2], 1 - answer[SIZE[0] // 2 :]]).mean()
    assert float(scores["mean_error_drivable"]) == pytest.approx(error, abs=0.05)
    (row,) = evaluate([run]).rows
    assert row.figures["mean_error_drivable"] == pytest.approx(
        float(scores["mean_error_drivable"]), abs=1e-6
    )


@pytest.mark.parametrize(("change", "text"), [
    ("data.source = [{kind = 'lab-streets', path = '.', count = 0.0}]", "count = 0.0: "),
    ("data.source = [{kind = 'lab-streets', path = '.', counts = 1}]", "unknown key counts;"),
    ("loss.weights.lab-third = 1", "loss.weights.lab-third: unknown term; known: depth,"),
])  # fmt: skip
def test_its_keys_are_checked_like_those_of_this_package(folder, change, text):
    with pytest.raises(InputError, match=text):
        read_stages(str(folder / "recipe.toml"), [change])


@pytest.mark.parametrize(("name", "text"), [
    ("lab-none", "unknown model 'lab-none'; known: ssdnet.*, lab-drivable"),
    ("lab-broken", "ssdnet.networks: lab-broken = lab_parts:nothing: .*no attribute 'nothing'"),
    ("lab-wrong", "lab-wrong = lab_parts:LOSS is a Term; expected one of the type Entry"),
])  # fmt: skip
@pytest.mark.usefixtures("folder")
def test_what_cannot_be_loaded_is_named(name, text):
    with pytest.raises(ValueError, match=text):
        create_model(name)


def test_a_package_that_cannot_be_imported_is_named(folder, monkeypatch):
    monkeypatch.delitem(HEADS, "drivable", raising=False)
    monkeypatch.setitem(sys.modules, "lab_head", None)
    with pytest.raises(ContractError, match=r"drivable = lab_head:DRIVABLE: .*: inst"):
        Predictor(folder / "m.onnx")


@pytest.mark.usefixtures("folder")
def test_names_that_no_package_registers_are_no_heads():
    assert "lab-none" not in HEADS
    with pytest.raises(ValueError, match="misnamed has the head 'drivable': rename one"):
        HEADS["misnamed"]
