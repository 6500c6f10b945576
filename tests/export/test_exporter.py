"""Checkpoint to file: what is left on disk, and what is not."""

import copy
import hashlib
import sys
from dataclasses import replace

import numpy as np
import onnx
import pytest
import torch
from typer.testing import CliRunner

from export import exporter
from export.cli import app
from export.errors import ExportError
from export.exporter import export_checkpoint
from export.parity import measure_parity
from export.probe_frames import probe_frames
from models import CAMVID_CLASSES, load_checkpoint, save_checkpoint
from runtime import ContractError, InputError, OutputError, Predictor
from runtime.contract import SCHEMA_VERSION
from runtime.errors import CheckpointError
from runtime.model_file import with_contract

SIZE = (64, 96)


def test_contract_says_where_the_file_comes_from(exported, lite_checkpoint):
    with Predictor(exported.path, warmup=0) as predictor:
        contract = predictor.contract
        assert predictor.size == SIZE
    assert contract.model_name == "ssdnet-lite"
    assert contract.classes == CAMVID_CLASSES
    assert contract.max_depth_m == 200.0
    assert contract.native_size == SIZE
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


@pytest.mark.usefixtures("traced")
def test_what_it_was_trained_for_goes_from_the_checkpoint_into_the_file(lite_checkpoint, tmp_path):
    network = load_checkpoint(lite_checkpoint).model
    network.config = replace(network.config, canonical_focal_px=721.5)
    trained = tmp_path / "trained.pt"
    save_checkpoint(trained, network, training={"trained_height": 375})
    for path, height, focal in ((trained, 375, 721.5), (lite_checkpoint, None, None)):
        model = path.with_suffix(".onnx")
        export_checkpoint(path, model, size=SIZE)
        with Predictor(model, warmup=0) as predictor:
            assert predictor.contract.trained_height == height
            assert predictor.contract.canonical_focal_px == focal
        model.unlink()


def test_a_damaged_file_is_refused(exported, tmp_path):
    """Nothing but ContractError, and always: it was exported whole, so every byte counts."""
    whole = exported.path.read_bytes()
    assert Predictor(exported.path, warmup=0).contract.schema_version == SCHEMA_VERSION
    random = np.random.default_rng(0)
    damages = []
    for _ in range(60):
        damaged = bytearray(whole)
        damaged[random.integers(len(whole))] ^= int(random.integers(1, 256))
        damages.append(damaged)
    for _ in range(20):
        damaged = bytearray(whole)
        start = int(random.integers(len(whole) - 4096))
        damaged[start : start + 4096] = bytes(4096)
        damages.append(damaged)
    damages.append(bytearray(whole + whole[-700:]))
    path = tmp_path / "damaged.onnx"
    for damaged in damages:
        path.write_bytes(damaged)
        with pytest.raises(ContractError, match=r"damaged|changed after"):
            Predictor(path, warmup=0)


def test_a_file_of_any_size_is_verified_at_the_frames_own(
    lite_checkpoint, dynamic_model, tmp_path, monkeypatch
):
    """Frames far above the trained height would be shrunk, and differ from PyTorch's answers."""
    trained = tmp_path / "trained.pt"
    model = load_checkpoint(lite_checkpoint).model
    save_checkpoint(trained, model, training={"trained_height": 40})
    monkeypatch.setattr(exporter, "trace", lambda *_, **__: copy.deepcopy(dynamic_model))
    report = export_checkpoint(
        trained, tmp_path / "lite.onnx", size=SIZE, dynamic=True, with_logits=True
    )
    assert report.parity["depth"].passed
    with Predictor(report.path, warmup=0) as predictor:
        assert predictor.network_size(SIZE) == (40, 60)


@pytest.mark.parametrize(
    ("arguments", "size"),
    [
        (["--with-logits"], None),
        (["--with-logits", "--dynamic", "--height", "64", "--width", "96"], None),
        (["--height", "64", "--width", "96"], SIZE),
    ],
    ids=["default", "dynamic", "fixed"],
)
def test_a_file_takes_any_size_unless_one_is_fixed(
    lite_checkpoint, dynamic_model, exported, tmp_path, monkeypatch, arguments, size
):
    def trace(*_, dynamic, **__):
        return copy.deepcopy(dynamic_model) if dynamic else onnx.load(exported.path)

    monkeypatch.setattr(exporter, "trace", trace)
    monkeypatch.setattr(exporter, "DEFAULT_SIZE", SIZE)
    path = tmp_path / "m.onnx"
    result = CliRunner().invoke(app, [str(lite_checkpoint), str(path), *arguments])
    assert result.exit_code == 0, result.output
    assert ("any size accepted" in result.output) == (size is None)
    with Predictor(path, warmup=0) as predictor:
        assert (predictor.size, predictor.contract.native_size) == (size, SIZE)


def test_only_the_one_file_is_left(exported):
    assert list(exported.path.parent.iterdir()) == [exported.path]
    assert exported.num_bytes == exported.path.stat().st_size


def test_frame_of_another_size_is_resized_by_the_engine(exported):
    frame = probe_frames((75, 141), max_depth_m=100.0, seeds=(1,))[0]
    with Predictor(exported.path, warmup=0) as predictor:
        prediction = predictor.predict(frame.rgb, frame.sparse_depth)
    assert prediction.valid
    assert prediction.depth.shape == (75, 141)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "heads", "dynamic"),
    [
        ("ssdnet", ("semantic", "depth", "boundary"), False),
        ("ssdnet-sem", ("semantic", "boundary"), False),
        ("ssdnet-dep", ("depth", "boundary"), False),
        ("ssdnet-dep-d", ("depth", "boundary"), True),
        ("ssdnet-dep-rgb", ("depth", "boundary"), True),
    ],
)
def test_every_variant_exports_with_both_inputs(name, heads, dynamic, small_model, tmp_path):
    model = small_model(name)
    save_checkpoint(tmp_path / "c.pt", model)
    report = export_checkpoint(
        tmp_path / "c.pt", tmp_path / "m.onnx", size=(45, 61), dynamic=dynamic
    )
    assert report.heads == heads
    with Predictor(report.path, warmup=0) as predictor:  # refuses a file without both inputs
        assert predictor.heads == heads
        assert predictor.contract.model_name == name
        assert predictor.size == (None if dynamic else (45, 61))
    if dynamic:
        sizes = [(33, 32), (57, 80), (64, 61)]
        frames = [f for size in sizes for f in probe_frames(size, max_depth_m=100.0, seeds=(4,))]
        assert all(head.passed for head in measure_parity(model, report.path, frames).values())


@pytest.mark.parametrize(
    "part", ["encoder.stem.0.0", "encoder.stride8.0.project.0", "surface_depth.guess"]
)
def test_parity_notices_a_small_change_of_the_weights(lite, exported, part):
    perturbed = copy.deepcopy(lite)
    with torch.no_grad():
        perturbed.get_submodule(part).weight.mul_(1.01)
    frames = probe_frames(SIZE, max_depth_m=100.0)
    assert all(head.passed for head in measure_parity(lite, exported.path, frames).values())
    parity = measure_parity(perturbed, exported.path, frames)
    assert not all(head.passed for head in parity.values())


def test_parity_notices_outputs_that_are_not_finite(lite, exported):
    broken = copy.deepcopy(lite)
    with torch.no_grad():
        broken.surface_depth.guess.bias.fill_(float("nan"))
    frames = probe_frames(SIZE, max_depth_m=100.0)[:1]
    assert not measure_parity(broken, exported.path, frames)["depth"].passed


def test_parity_notices_a_graph_that_takes_what_is_no_measurement(lite, exported, tmp_path):
    """The predictor hides it: it cleans a depth map before the graph sees it."""
    model = onnx.load(exported.path)
    with Predictor(exported.path, warmup=0) as predictor:
        contract = predictor.contract
    del model.metadata_props[:]
    for node in model.graph.node:
        node.input[:] = ["filled" if name == "sparse_depth" else name for name in node.input]
    model.graph.initializer.append(onnx.numpy_helper.from_array(np.float32(7), "seven"))
    model.graph.node.insert(0, onnx.helper.make_node("IsNaN", ["sparse_depth"], ["is_nan"]))
    fill = onnx.helper.make_node("Where", ["is_nan", "seven", "sparse_depth"], ["filled"])
    model.graph.node.insert(1, fill)
    path = tmp_path / "m.onnx"
    path.write_bytes(with_contract(model.SerializeToString(), contract))
    frames = probe_frames(SIZE, max_depth_m=100.0)
    assert not measure_parity(lite, path, frames)["depth"].passed


@pytest.mark.usefixtures("traced")
def test_a_file_that_differs_is_not_left_on_disk(lite, tmp_path):
    perturbed = copy.deepcopy(lite)
    with torch.no_grad():
        perturbed.semantic_head.bias[0] += 2.0
    save_checkpoint(tmp_path / "c.pt", perturbed)
    old = tmp_path / "m.onnx"
    old.write_bytes(b"an older model")
    arguments = [str(tmp_path / "c.pt"), str(old), "--height", "64", "--width", "96", "--overwrite"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 1
    assert "differ from PyTorch" in result.output
    assert "semantic {'agreement'" in result.output
    assert "depth" not in result.output  # only what differs is named
    assert old.read_bytes() == b"an older model"
    assert {path.name for path in tmp_path.iterdir()} == {"c.pt", old.name}


@pytest.mark.usefixtures("traced")
def test_a_full_disk_leaves_the_old_file_and_nothing_else(lite_checkpoint, mount_disk):
    target = mount_disk(64) / "m.onnx"
    target.write_bytes(b"the old one")
    with pytest.raises(OutputError, match=r"cannot write .*m\.onnx .*No space left"):
        export_checkpoint(lite_checkpoint, target, size=SIZE, overwrite=True)
    assert target.read_bytes() == b"the old one"
    assert list(target.parent.iterdir()) == [target]


@pytest.mark.usefixtures("traced")
def test_existing_file_is_replaced_only_on_demand(lite_checkpoint, tmp_path):
    path = tmp_path / "m.onnx"
    path.write_bytes(b"an older model")
    with pytest.raises(OutputError, match="exists"):
        export_checkpoint(lite_checkpoint, path, size=SIZE)
    assert path.read_bytes() == b"an older model"
    arguments = [str(lite_checkpoint), str(path), "--height", "64", "--width", "96", "--overwrite"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert "max_abs_m" in result.output
    onnx.checker.check_model(str(path))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("semantic_head.bias", float("nan")),
        ("encoder.stem.0.1.running_var", float("inf")),
        ("rgb_mean", -float("inf")),
    ],
)
def test_weights_that_are_not_finite_are_refused(lite, tmp_path, name, value):
    damaged = copy.deepcopy(lite)
    damaged.state_dict()[name].view(-1)[1] = value
    save_checkpoint(tmp_path / "c.pt", damaged)
    with pytest.raises(ExportError, match=f"NaN or Inf in {name}: "):
        export_checkpoint(tmp_path / "c.pt", tmp_path / "m.onnx", size=SIZE)
    assert [path.name for path in tmp_path.iterdir()] == ["c.pt"]


@pytest.mark.parametrize("name", ["m", "m.pt"])
def test_a_name_without_its_suffix_is_refused_with_the_right_one(tmp_path, name):
    result = CliRunner().invoke(app, [str(tmp_path / "c.pt"), str(tmp_path / name)])
    assert result.exit_code == 2
    text = "".join(result.output.split())
    assert f"give{tmp_path / 'm.onnx'}" in text
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("content", "text"), [(b"not a checkpoint", "not an ssdnet checkpoint"), (None, "no such")]
)
def test_foreign_checkpoint_is_an_error_with_text(tmp_path, content, text):
    path = tmp_path / "c.pt"
    if content is not None:
        path.write_bytes(content)
    before = list(tmp_path.iterdir())
    result = CliRunner().invoke(app, [str(path), str(tmp_path / "m.onnx")])
    assert result.exit_code == 1
    assert text in result.output
    assert "Traceback" not in result.output
    assert list(tmp_path.iterdir()) == before


def test_wrong_arguments_are_refused(lite_checkpoint, tmp_path):
    for size in ((16, 64), (64, 16_385), (16_384, 16_384)):
        with pytest.raises(InputError, match="size"):
            export_checkpoint(lite_checkpoint, tmp_path / "m.onnx", size=size)
    with pytest.raises(OutputError, match="is not a folder"):
        export_checkpoint(lite_checkpoint, tmp_path / "missing" / "m.onnx")
    with pytest.raises(OutputError, match="is a folder"):
        export_checkpoint(lite_checkpoint, tmp_path, overwrite=True)
    before = lite_checkpoint.read_bytes()
    (tmp_path / "link.onnx").symlink_to(lite_checkpoint)
    for target in (lite_checkpoint, tmp_path / "link.onnx"):
        with pytest.raises(OutputError, match="is the checkpoint itself"):
            export_checkpoint(lite_checkpoint, target, overwrite=True)
    assert lite_checkpoint.read_bytes() == before
    result = CliRunner().invoke(app, [str(lite_checkpoint), "m.onnx", "--height", "64"])
    assert result.exit_code == 2


@pytest.fixture
def export_in_another_process(lite_checkpoint, exported, start_process):
    """Start an export that waits for a line while it verifies what it wrote."""

    def start(target):
        program = (
            "import sys, onnx; from export import exporter\n"
            f"exporter.trace = lambda *_, **__: onnx.load({str(exported.path)!r})\n"
            "verify = exporter.measure_parity\n"
            "def wait_and_verify(*arguments, **options):\n"
            "    print('verifying', flush=True); sys.stdin.readline()\n"
            "    return verify(*arguments, **options)\n"
            "exporter.measure_parity = wait_and_verify\n"
            f"exporter.export_checkpoint({str(lite_checkpoint)!r}, {str(target)!r}, size={SIZE})\n"
        )
        process = start_process(sys.executable, "-c", program)
        assert process.stdout.readline() == "verifying\n", process.communicate()[1]
        return process

    return start


@pytest.mark.slow
@pytest.mark.usefixtures("traced")
def test_a_killed_export_leaves_nothing_to_the_next(
    lite_checkpoint, tmp_path, export_in_another_process
):
    target = tmp_path / "m.onnx"
    process = export_in_another_process(target)
    process.kill()  # SIGKILL: nothing can be tidied up
    process.communicate()
    assert len(list(tmp_path.iterdir())) == 1
    assert not target.exists()
    export_checkpoint(lite_checkpoint, target, size=SIZE)
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.slow
@pytest.mark.usefixtures("traced")
def test_of_two_exports_to_one_path_one_succeeds(
    lite_checkpoint, tmp_path, export_in_another_process
):
    target = tmp_path / "m.onnx"
    process = export_in_another_process(target)
    with pytest.raises(OutputError, match="another process is writing it"):
        export_checkpoint(lite_checkpoint, target, size=SIZE)
    _, error = process.communicate("go on\n")
    assert process.returncode == 0, error
    assert list(tmp_path.iterdir()) == [target]
    assert Predictor(target, warmup=0).size == SIZE


@pytest.mark.usefixtures("traced")
def test_a_file_that_appears_during_an_export_stays(lite_checkpoint, tmp_path, monkeypatch):
    target = tmp_path / "m.onnx"

    def somebody_else(*arguments, **options):
        target.write_bytes(b"somebody else's model")
        return measure_parity(*arguments, **options)

    monkeypatch.setattr(exporter, "measure_parity", somebody_else)
    with pytest.raises(OutputError, match="exists"):
        export_checkpoint(lite_checkpoint, target, size=SIZE)
    assert target.read_bytes() == b"somebody else's model"
    assert list(tmp_path.iterdir()) == [target]


def test_checkpoint_of_another_project_is_a_checkpoint_error(tmp_path):
    torch.save({"weights": torch.zeros(1)}, tmp_path / "c.pt")
    with pytest.raises(CheckpointError, match="not an ssdnet checkpoint"):
        export_checkpoint(tmp_path / "c.pt", tmp_path / "m.onnx")
    assert [path.name for path in tmp_path.iterdir()] == ["c.pt"]


def test_probe_frames_hold_what_they_are_named_after():
    frames = {f.name: f for f in probe_frames((65, 96), max_depth_m=50.0, seeds=(0,))}
    assert not frames["empty"].sparse_depth.any()
    full = frames["full"].sparse_depth
    assert full.min() > 0
    assert full.max() <= 50.0
    lines = frames["scan lines 0"].sparse_depth
    assert 0.02 < (lines > 0).mean() < 0.3
    faulty = frames["faulty"].sparse_depth
    for kind in (np.isnan, np.isposinf, np.isneginf, lambda d: d == -5, lambda d: d == 500):
        assert kind(faulty).any()
    assert frames["full"].rgb.std() > 20
