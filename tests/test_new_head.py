"""The example of a package of your own adds a head, a network, a loss and a data set.

No code knows the head by name, and it goes all the way.
"""

import csv
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

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
from training.base.tables import build
from training.datasets.registry import AnySource, parse_data
from training.recipes.chosen_recipe import read_stages

PACKAGE = Path(__file__).parents[1] / "examples/own_package"
# Entry points that cannot be used, of another package.
BROKEN = """
[ssdnet.heads]
misnamed = own_package.head:DRIVABLE
[ssdnet.networks]
own-broken = own_package.loss:nothing
own-wrong = own_package.loss:LOSS
enet = own_package.network:NETWORK
[ssdnet.datasets]
own-labelled = broken_package:Labelled
camvid = broken_package:Labelled
"""
DATA_SET = """
from typing import ClassVar
from own_package.data import StreetsRecipe

class Labelled(StreetsRecipe):
    labelled: ClassVar[str] = "camvids"
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
    shutil.copytree(PACKAGE, folder / "source")  # building leaves files behind
    install = ["pip", "install", "-q", "--no-deps", "--no-build-isolation", "--no-index"]
    command = [sys.executable, "-m", *install, "--target", folder / "site", folder / "source"]
    subprocess.run(command, check=True, capture_output=True)
    info = folder / "site/broken-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(BROKEN)
    (folder / "site/broken_package.py").write_text(DATA_SET)
    torch.manual_seed(0)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder / "site"))
        save_checkpoint(folder / "c.pt", create_model("own-network").eval(), training={})
        options = {"size": SIZE, "record_dir": folder / "exported"}
        report = export_checkpoint(folder / "c.pt", folder / "m.onnx", **options)
        assert report.heads == ("drivable",)
        assert report.parity["drivable"].figures["max_abs"] <= HEADS["drivable"].tolerance
        HEADS.pop("drivable")  # the engine finds it, too
        yield folder
    HEADS.pop("drivable", None)
    for name in [name for name in sys.modules if name.startswith("own_package")]:
        sys.modules.pop(name)


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
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(folder / "site"), *sys.path])},
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stderr
    (saved,) = (out / "free-space").iterdir()
    assert cv2.imread(str(saved), cv2.IMREAD_UNCHANGED).shape == (256, 832)
    limits = json.loads((recording / "reference.json").read_text())["limits"]
    assert limits.keys() == {"drivable"}


def test_it_is_trained_and_scored(folder, tmp_path, capsys):
    run = tmp_path / "run"
    checkpoint = load_checkpoint(train(PACKAGE / "recipe.toml", data=folder, out=run).path)
    assert "step 5: streets/mean_error_drivable 0." in capsys.readouterr().err
    recipe, trained = checkpoint.facts.recipe, checkpoint.model
    assert recipe["loss"]["weights"]["drivable"] == 2.0
    assert recipe["data"]["source"][0]["count"] == 4
    assert "own-network" in list_models()
    assert parse_data("own-streets:far,count=3").count == 3
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
    ("data.source = [{kind = 'own-streets', path = '.', count = 0.0}]", "count = 0.0: "),
    ("data.source = [{kind = 'own-streets', path = '.', counts = 1}]", "unknown key counts;"),
    ("loss.weights.own-third = 1", "loss.weights.own-third: unknown term; known: depth,"),
])  # fmt: skip
def test_its_keys_are_checked_like_those_of_this_package(folder, change, text):
    with pytest.raises(InputError, match=text):
        read_stages(str(PACKAGE / "recipe.toml"), [change])


@pytest.mark.parametrize(("name", "text"), [
    ("own-none", "unknown model 'own-none'; known: ssdnet.*, own-network"),
    ("own-broken", "networks: own-broken = own_package.loss:nothing: .*no attribute 'nothing'"),
    ("enet", "enet is a name of this package and own_package.network:NETWORK: rename it"),
    ("own-wrong", "own-wrong = own_package.loss:LOSS is a Term; expected one of the type Entry"),
])  # fmt: skip
@pytest.mark.usefixtures("folder")
def test_what_cannot_be_loaded_is_named(name, text):
    with pytest.raises(ValueError, match=text):
        create_model(name)


@pytest.mark.parametrize(("kind", "text"), [
    ("own-street", "unknown kind of data set 'own-street': give one of camvid, .*, own-streets"),
    ("own-labelled", "own-labelled has labelled = 'camvids'; expected one of camvid, "),
    ("camvid", "camvid is a name of this package and broken_package:Labelled"),
])  # fmt: skip
@pytest.mark.usefixtures("folder")
def test_a_data_set_that_cannot_be_used_is_named(kind, text):
    with pytest.raises(InputError, match=text):
        build(AnySource, {"kind": kind, "path": "."})


def test_a_package_that_cannot_be_imported_is_named(folder, monkeypatch):
    monkeypatch.delitem(HEADS, "drivable", raising=False)
    monkeypatch.setitem(sys.modules, "own_package.head", None)
    with pytest.raises(ContractError, match=r"drivable = own_package.head:DRIVABLE: .*: inst"):
        Predictor(folder / "m.onnx")


@pytest.mark.usefixtures("folder")
def test_names_that_no_package_registers_are_no_heads():
    assert "own-none" not in HEADS
    with pytest.raises(ValueError, match="misnamed has the head 'drivable': rename one"):
        HEADS["misnamed"]
