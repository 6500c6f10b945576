"""Checkpoint to file: what is left on disk, and what is not."""

import copy
import hashlib
from dataclasses import replace

import numpy as np
import onnx
import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode
from typer.testing import CliRunner

import export
from export import build
from export.cli import app
from export.errors import ExportError
from export.exporter import export_checkpoint
from export.options import ExportOptions
from export.parity import measure_parity
from export.precision import Precision
from export.probe_frames import probe_frames
from models import CAMVID_CLASSES, load_checkpoint, save_checkpoint
from models.checkpoint import FINAL, RECIPE
from runtime import InputError, OutputError, Predictor
from runtime.contract.model_file import with_contract

SIZE = (64, 96)
FIXED = ("--height", "64", "--width", "96")


def run(checkpoint, path, *options):
    return CliRunner().invoke(app, [str(checkpoint), str(path), *options])


def test_contract_says_how_much_work_a_frame_is(lite, exported):
    with FlopCounterMode(display=False) as counter, torch.no_grad():
        lite(torch.zeros(1, 3, *SIZE), torch.zeros(1, 1, *SIZE))
    assert exported.contract.giga_macs == pytest.approx(counter.get_total_flops() / 2e9)


def test_contract_says_where_the_file_comes_from(exported, lite_checkpoint):
    assert list(exported.path.parent.iterdir()) == [exported.path]
    assert exported.num_bytes == exported.path.stat().st_size
    with Predictor(exported.path, warmup=0) as predictor:
        contract = predictor.contract
        assert predictor.size == contract.native_size == SIZE
    assert contract.model_name == "ssdnet-lite"
    assert contract.classes == CAMVID_CLASSES
    assert contract.max_depth_m == 200.0
    assert contract.stride == 32
    assert contract.precision == "fp32"
    assert contract.training == {"data": ["made-up frames"], "terms": "none"}
    assert contract.versions["opset"] == "18"
    assert contract.versions["torch"] == torch.__version__
    digest = hashlib.sha256(lite_checkpoint.read_bytes()).hexdigest()
    assert contract.checkpoint_sha256 == digest
    assert set(contract.parity) == {"semantic", "depth", "boundary", "depth_uncertainty"}
    assert contract.parity["semantic"]["agreement"] > 0.9995
    assert 0 < contract.parity["depth"]["max_abs_m"] < 0.005


def test_a_recording_that_exists_is_refused_before_any_work(lite_checkpoint, tmp_path, monkeypatch):
    monkeypatch.setattr(build, "trace", lambda *_, **__: pytest.fail("traced first"))
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken/file").touch()
    result = run(lite_checkpoint, tmp_path / "m.onnx", "--record", str(tmp_path / "taken"))
    assert (result.exit_code, [path.name for path in tmp_path.iterdir()]) == (1, ["taken"])
    assert str(tmp_path / "taken") in result.output.splitlines()[-1]


@pytest.mark.usefixtures("traced")
@pytest.mark.parametrize(("name", "expected"), [(None, "van-7"), ("bus-8", "bus-8")])
def test_what_a_run_knows_goes_into_the_file(lite_checkpoint, tmp_path, name, expected):
    """The folder of a run is exported, and names the model unless a name is given."""
    network, run = load_checkpoint(lite_checkpoint).model, tmp_path / "van-7"
    network.config = replace(network.config, canonical_focal_px=721.5)
    save_checkpoint(run / FINAL, network, training={"trained_height": 375})
    (run / RECIPE).touch()
    report = export_checkpoint(run, tmp_path / "m.onnx", size=SIZE, name=name)
    contract = report.contract
    assert contract.model_name == expected
    assert (contract.trained_height, contract.canonical_focal_px) == (375, 721.5)


def test_a_file_of_any_size_is_verified_at_the_frames_own(traced_for_any_size, tmp_path):
    """Frames far above the trained height would be shrunk, and differ from PyTorch's answers."""
    model = load_checkpoint(traced_for_any_size).model
    save_checkpoint(tmp_path / "c.pt", model, training={"trained_height": 40})
    report = export_checkpoint(
        tmp_path / "c.pt", tmp_path / "m.onnx", size=SIZE, dynamic=True, with_logits=True
    )
    assert report.parity["depth"].passed
    with Predictor(report.path, warmup=0) as predictor:
        assert predictor.network_size(SIZE) == (40, 60)


@pytest.mark.parametrize("arguments", [(), ("--dynamic", *FIXED)], ids=["default", "dynamic"])
def test_a_file_takes_any_size_unless_one_is_fixed(
    traced_for_any_size, tmp_path, monkeypatch, arguments
):
    monkeypatch.setattr("export.options.DEFAULT_SIZE", SIZE)
    result = run(traced_for_any_size, tmp_path / "m.onnx", "--with-logits", *arguments)
    assert result.exit_code == 0, result.output
    assert "any size accepted" in result.output
    with Predictor(tmp_path / "m.onnx", warmup=0) as predictor:
        assert (predictor.size, predictor.contract.native_size) == (None, SIZE)


@pytest.mark.usefixtures("traced")
def test_a_fixed_size_is_the_only_one(lite_checkpoint, tmp_path):
    result = run(lite_checkpoint, tmp_path / "m.onnx", *FIXED)
    assert result.exit_code == 0, result.output
    assert "any size accepted" not in result.output
    with Predictor(tmp_path / "m.onnx", warmup=0) as predictor:
        assert predictor.size == predictor.contract.native_size == SIZE


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "heads", "dynamic"),
    [
        ("ssdnet", ("semantic", "depth", "boundary"), False),
        ("ssdnet-sem", ("semantic", "boundary"), False),
        ("ssdnet-dep-d", ("depth", "boundary"), True),
        ("ssdnet-dep-rgb", ("depth", "boundary"), True),
    ],
)
def test_every_variant_exports_with_both_inputs(name, heads, dynamic, small_model, tmp_path):
    save_checkpoint(tmp_path / "c.pt", small_model(name))
    report = export_checkpoint(
        tmp_path / "c.pt", tmp_path / "m.onnx", size=(45, 61), dynamic=dynamic
    )
    with Predictor(report.path, warmup=0) as predictor:  # refuses a file without both inputs
        assert predictor.heads == report.heads == heads
        assert predictor.contract.model_name == name
        assert predictor.size == (None if dynamic else (45, 61))


@pytest.mark.parametrize(
    "part", ["encoder.stem.0.0", "encoder.stride8.0.project.0", "surface_depth.guess"]
)
@pytest.mark.parametrize("factor", [1.01, float("nan")])
def test_parity_notices_a_small_change_of_the_weights(lite, exported, part, factor):
    """Unchanged weights pass on the same frames, or `exported` would not exist."""
    changed = copy.deepcopy(lite)
    with torch.no_grad():
        changed.get_submodule(part).weight.mul_(factor)
    frames = probe_frames(SIZE, max_depth_m=exported.contract.max_depth_m)[:3:2]  # returns, none
    parity = measure_parity(changed, exported.path, frames)
    assert not all(head.passed for head in parity.values())


def test_parity_notices_a_graph_that_takes_what_is_no_measurement(lite, exported, tmp_path):
    """The predictor hides it: it cleans a depth map before the graph sees it."""
    model = onnx.load(exported.path)
    del model.metadata_props[:]
    for node in model.graph.node:
        node.input[:] = ["filled" if name == "sparse_depth" else name for name in node.input]
    model.graph.initializer.append(onnx.numpy_helper.from_array(np.float32(7), "seven"))
    model.graph.node.insert(0, onnx.helper.make_node("IsNaN", ["sparse_depth"], ["is_nan"]))
    fill = onnx.helper.make_node("Where", ["is_nan", "seven", "sparse_depth"], ["filled"])
    model.graph.node.insert(1, fill)
    path = tmp_path / "m.onnx"
    path.write_bytes(with_contract(model.SerializeToString(), exported.contract))
    *_, faulty = probe_frames(SIZE, max_depth_m=100.0)
    assert not measure_parity(lite, path, [faulty])["depth"].passed


@pytest.mark.usefixtures("traced")
def test_a_file_that_differs_is_not_left_on_disk(lite, tmp_path):
    perturbed = copy.deepcopy(lite)
    with torch.no_grad():
        perturbed.semantic_head.bias[0] += 2.0
    save_checkpoint(tmp_path / "c.pt", perturbed)
    old = tmp_path / "m.onnx"
    old.write_bytes(b"an older model")
    result = run(tmp_path / "c.pt", old, *FIXED, "--overwrite")
    assert result.exit_code == 1
    assert "differ from PyTorch" in result.output
    assert "semantic {'agreement'" in result.output
    assert "depth" not in result.output  # only what differs is named
    assert old.read_bytes() == b"an older model"
    assert {path.name for path in tmp_path.iterdir()} == {"c.pt", old.name}


@pytest.mark.usefixtures("traced")
def test_existing_file_is_replaced_only_on_demand(lite_checkpoint, tmp_path):
    path = tmp_path / "m.onnx"
    path.write_bytes(b"an older model")
    with pytest.raises(OutputError, match="exists"):
        export_checkpoint(lite_checkpoint, path, size=SIZE)
    assert path.read_bytes() == b"an older model"
    result = run(lite_checkpoint, path, *FIXED, "--overwrite")
    assert result.exit_code == 0, result.output
    assert "max_abs_m" in result.output
    onnx.checker.check_model(str(path))


@pytest.mark.parametrize(
    ("name", "value"), [("semantic_head.bias", float("nan")), ("rgb_mean", -float("inf"))]
)
def test_weights_that_are_not_finite_are_refused(lite, tmp_path, name, value):
    damaged = copy.deepcopy(lite)
    damaged.state_dict()[name].view(-1)[1] = value
    save_checkpoint(tmp_path / "c.pt", damaged)
    with pytest.raises(ExportError, match=f"NaN or Inf in {name}, so nothing"):
        export_checkpoint(tmp_path / "c.pt", tmp_path / "m.onnx", size=SIZE)
    assert [path.name for path in tmp_path.iterdir()] == ["c.pt"]


@pytest.mark.parametrize(
    ("source", "target", "options", "exit_code", "message"),
    [
        ("c.pt", "m.pt", (), 2, "m.onnx"),
        ("c.pt", "m.onnx", ("--height", "64"), 2, "--width"),
        ("c.pt", "m.onnx", (), 1, "not an ssdnet checkpoint"),
        (".", "m.onnx", (), 1, "model.pt: no such checkpoint"),  # the folder of a run
    ],
)
def test_wrong_arguments_are_an_error_with_text(
    tmp_path, source, target, options, exit_code, message
):
    (tmp_path / "c.pt").write_bytes(b"not a checkpoint")
    result = run(tmp_path / source, tmp_path / target, *options)
    assert result.exit_code == exit_code
    assert message in "".join(result.output.split()) or message in result.output
    assert "Traceback" not in result.output
    assert [path.name for path in tmp_path.iterdir()] == ["c.pt"]


def test_what_cannot_be_written_is_refused(lite_checkpoint, tmp_path):
    for size in ((16, 64), (64, 16_385), (16_384, 16_384)):
        with pytest.raises(InputError, match="size"):
            export_checkpoint(lite_checkpoint, tmp_path / "m.onnx", size=size)
    with pytest.raises(InputError, match="name"):
        export_checkpoint(lite_checkpoint, tmp_path / "m.onnx", name="")
    (tmp_path / "link.onnx").symlink_to(lite_checkpoint)
    before = lite_checkpoint.read_bytes()
    for target, message in (
        (tmp_path / "missing" / "m.onnx", "is not a folder"),
        (tmp_path, "is a folder"),
        (lite_checkpoint, "is the checkpoint itself"),
        (tmp_path / "link.onnx", "is the checkpoint itself"),
    ):
        with pytest.raises(OutputError, match=message):
            export_checkpoint(lite_checkpoint, target, overwrite=True)
    assert lite_checkpoint.read_bytes() == before


def test_probe_frames_hold_what_they_are_named_after():
    frames = {f.name: f for f in probe_frames((65, 96), max_depth_m=50.0)}
    assert not frames["empty"].sparse_depth.any()
    full = frames["full"].sparse_depth
    assert 0 < full.min() <= full.max() <= 50.0
    lines = frames["scan lines 0"].sparse_depth
    assert 0.02 < (lines > 0).mean() < 0.3
    faulty = frames["faulty"].sparse_depth
    for kind in (np.isnan, np.isposinf, np.isneginf, lambda d: d == -5, lambda d: d == 500):
        assert 0 < kind(faulty).mean() < 0.05
    assert frames["full"].rgb.std() > 20


def test_a_precision_may_be_a_text(tmp_path):
    options = ExportOptions(
        checkpoint_path=tmp_path, onnx_path=tmp_path / "m.onnx", precision="fp16"
    )
    assert options.precision is Precision.FP16
    with pytest.raises(InputError, match="'fp8' is unknown: give one of fp32, fp16, int8"):
        ExportOptions(checkpoint_path=tmp_path, onnx_path=tmp_path / "m.onnx", precision="fp8")


def test_what_an_export_takes_and_returns_is_importable_from_the_package():
    assert all(getattr(export, name).__name__ == name for name in export.__all__)
