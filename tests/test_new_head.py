"""A head that no code knows by name is one row of `HEADS`, and goes all the way."""

import json
import pickle
import subprocess
import sys

import cv2
import numpy as np
import pytest
import torch
import torch.nn.functional as F
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from torch import nn

from export.exporter import export_checkpoint
from models import Network, NetworkConfig, NetworkOutput, load_checkpoint, save_checkpoint
from models.blocks import pad_to_multiple
from models.registry import NETWORKS, Entry
from runtime import Predictor
from runtime.app.encode import ENCODERS
from runtime.app.tools.verification import verify
from runtime.contract.heads import HEADS, Difference, Head, Panel, Unit
from runtime.recordings.recording import read_recording
from training import task
from training.datasets.camvid import CamVidRecipe
from training.datasets.sample import Sample
from training.loading.augment import AugmentConfig
from training.loop import train
from training.losses import LossConfig
from training.losses.semantic import labelled_mean
from training.losses.terms import TERMS, head_term
from training.recipe import (
    DataRecipe,
    LoopRecipe,
    ModelRecipe,
    OptimizerRecipe,
    Recipe,
    ScheduleRecipe,
)

ROW = Head(
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
# Runs ssdnet-run with the row.
COMMAND = f"""
import pickle
from runtime.contract.heads import HEADS
HEADS["drivable"] = pickle.loads({pickle.dumps(ROW)!r})
from runtime.app.tools.commands import run
run()
"""
SIZE = (64, 96)


class Drivable(Network):
    """The new head alone, on half of the image's grid."""

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


@pytest.fixture
def frame():
    rng = np.random.default_rng(0)
    depth = np.where(rng.random(SIZE) < 0.1, 50 * rng.random(SIZE), 0).astype(np.float32)
    return rng.integers(0, 256, (*SIZE, 3), dtype=np.uint8), depth


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Holds the exported file `m.onnx` and the recording `exported`; the row is in the table."""
    folder = tmp_path_factory.mktemp("new-head")
    config = NetworkConfig("tiny-drivable", classes=())
    torch.manual_seed(0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(HEADS, "drivable", ROW)
        patch.setitem(NETWORKS, config.name, Entry(Drivable, config))
        save_checkpoint(folder / "c.pt", Drivable(config).eval(), training={})
        options = {"size": SIZE, "dynamic": True, "record_dir": folder / "exported"}
        report = export_checkpoint(folder / "c.pt", folder / "m.onnx", **options)
        assert report.heads == ("drivable",)
        assert report.parity["drivable"].figures["max_abs"] <= ROW.tolerance
        yield folder


def test_a_head_of_one_row_goes_all_the_way(folder, tmp_path, frame):
    rgb, depth = frame
    with Predictor(folder / "m.onnx") as predictor:
        assert predictor.heads == ("drivable",)
        prediction = predictor.predict(rgb, depth)
        recording = read_recording(folder / "exported")
        report = verify(predictor, recording, tolerances={})
        assert report.checks
        assert report.passed
    answer = prediction.heads["drivable"]
    assert prediction.valid
    assert (answer.shape, answer.dtype) == (SIZE, np.float32)
    assert 0 < answer.min() < answer.max() < 1

    with Predictor(folder / "m.onnx", size=32) as predictor:
        resized = predictor.predict(rgb, depth)
    assert resized.network_size == (32, 48)
    assert resized.heads["drivable"].shape == SIZE

    drawn = prediction.draw(rgb)[24:64, 96:192]  # below the title of the second panel
    np.testing.assert_allclose(drawn, np.repeat(answer[24:, :, None] * 255, 3, axis=2), atol=1)

    prediction.save(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as arrays:
        np.testing.assert_array_equal(arrays["drivable"], answer)
    encoded = np.frombuffer(ENCODERS[ROW.unit](answer), np.uint8)
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
    arguments = ["--demo", "--limit", "1", "--model", folder / "m.onnx", "--size", "64"]
    arguments += ["--out", out, "--record", recording]
    result = subprocess.run(
        [sys.executable, "-c", COMMAND, *arguments], capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr
    (saved,) = (out / "free-space").iterdir()
    assert cv2.imread(str(saved), cv2.IMREAD_UNCHANGED).shape == (256, 832)
    limits = json.loads((recording / "recording.json").read_text())["limits"]
    assert limits.keys() == {"drivable"}


class Streets:
    """Frames whose lower half is bright and free; a third of their columns is not labelled."""

    def __len__(self):
        return 4

    def __getitem__(self, index):
        rgb = np.random.default_rng(index).integers(0, 60, (*SIZE, 3), dtype=np.uint8)
        rgb[SIZE[0] // 2 :] += 180
        free = (rgb[..., 0] > 100).astype(np.float32)
        free[:, : SIZE[1] // 3] = np.nan
        return Sample(rgb, {"drivable": free}, None, str(index), weights={"drivable": 0.5})


def drivable_loss(logits, labels, weights):
    known = ~labels.isnan()
    errors = F.binary_cross_entropy_with_logits(logits[:, 0], labels.nan_to_num(), reduction="none")
    return labelled_mean((errors * known).sum(dim=(1, 2)), known.sum(), weights)


def test_a_row_and_a_loss_train_it(tmp_path, monkeypatch):
    config = NetworkConfig("tiny-drivable", classes=())
    monkeypatch.setitem(HEADS, "drivable", ROW)
    monkeypatch.setitem(NETWORKS, config.name, Entry(Drivable, config))
    monkeypatch.setitem(TERMS, "drivable", head_term("drivable", drivable_loss))
    monkeypatch.setattr(task, "open_dataset", lambda *_, **__: Streets())
    recipe = Recipe(
        model=ModelRecipe(config.name),
        data=DataRecipe(
            (CamVidRecipe(path="streets"),),
            augment=AugmentConfig(crop=(32, 48), scale=(0.5, 1.0)),
            batch_size=4,
            workers=0,
        ),
        loss=LossConfig(weights={"drivable": 2.0}),
        schedule=ScheduleRecipe(steps=5),
        optimizer=OptimizerRecipe(learning_rate=0.03),
        loop=LoopRecipe(ema_decay=0.0, log_every=1),
    )
    trained = load_checkpoint(train(recipe, data=[], out=tmp_path / "run")).model
    events = EventAccumulator(str(tmp_path / "run" / "tensorboard"))
    events.Reload()
    shown = {
        name: [item.value for item in events.Scalars(name)] for name in events.Tags()["scalars"]
    }
    assert {name for name in shown if name.startswith("loss/")} == {"loss/drivable", "loss/total"}
    assert shown["loss/total"] == pytest.approx([2 * value for value in shown["loss/drivable"]])
    assert shown["loss/drivable"][-1] < 0.8 * shown["loss/drivable"][0]
    rgb = torch.from_numpy(Streets()[0].rgb).permute(2, 0, 1)[None].float()
    with torch.no_grad():
        answer = trained(rgb, torch.zeros(1, 1, *SIZE)).others["drivable"][0, 0]
    assert answer[SIZE[0] // 2 :].mean() > answer[: SIZE[0] // 2].mean()
