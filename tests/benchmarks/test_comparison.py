"""The comparison: its queue from the command line, and its tables."""

import json
import shutil

import numpy as np
import pytest

import comparison
from layouts import camvid, kitti_streets, virtual_kitti
from runtime.engine.bundled_models import find_model

# A network that is quickly trained, a bundled one, one that is only timed, and a method.
PLAN = """
recipe = "comparison-semantics"
set = ["data.batch_size = 2", "data.augment.crop = [32, 64]", "schedule.warmup_steps = 0"]
[[entry]]
name = "shipped"
onnx = "ssdnet-nano"
published_miou = 51.0
[[entry]]
name = "thin one"
recipe = "comparison-depth"
set = [
    'model.name = "sparse-conv"',
    "data.source = [{ kind = 'rendered', path = 'rendered/val' }]",
]
[[entry]]
name = "big"
network = "sparse-conv"
[[entry]]
name = "filling"
method = "nearest"
"""


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    root = tmp_path_factory.mktemp("data")
    label = np.full((40, 72), 3, np.uint8)
    label[:20] = 1
    rgb = np.full((*label.shape, 3), 90, np.uint8)
    camvid.write_frame(root / "camvid", rgb, label, split="val")
    kitti_streets.write_streets(root / "kitti_streets", (83,), magnify=5)
    virtual_kitti.write_second_edition(root / "rendered" / "val", magnify=5)
    return root


@pytest.fixture
def plan_file(tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text(PLAN)
    return path


@pytest.fixture
def export_nano(monkeypatch):
    """Replace the export, which takes long, by the bundled network; give the list of exports."""
    exports = []

    def export(checkpoint, onnx, *, size, dynamic, overwrite):
        assert dynamic
        assert overwrite
        exports.append(checkpoint)
        shutil.copy(find_model("ssdnet-nano"), onnx)

    monkeypatch.setattr(comparison, "export_checkpoint", export)
    return exports


def run(verb, plan, *options, steps=2):
    runs = plan.parent / "runs"
    command = [verb, "--plan", plan, "--runs", runs, "--threads", 1]
    comparison.main(list(map(str, [*command, "--set", f"schedule.steps = {steps}", *options])))
    return runs


def test_the_queue_trains_scores_times_and_prints(
    data, plan_file, export_nano, monkeypatch, capsys, model_file, bench_in_threads
):
    runs = run("train", plan_file, "--data", data, "--limit", 1)
    assert export_nano == [runs / "thin-one" / "model.pt"]
    # No simulated line meets a scene as small as this: its frames are scored without LiDAR.
    scored = {"streets 64", "streets 16", "rendered none"}
    for name in ("thin-one", "filling"):
        assert json.loads((runs / name / "scores.json").read_text())["figures"].keys() == scored
    assert not (runs / "big").exists()

    model = model_file(contract=None).read_bytes()
    monkeypatch.setattr(comparison, "export_graph", lambda graph: model)
    monkeypatch.setattr(comparison, "SIZES", [(64, 96)])
    run("time", plan_file, "--rounds", 1)
    capsys.readouterr()
    run("table", plan_file)
    lines = capsys.readouterr().out.splitlines()
    semantics, depth = (
        lines.index(f"**{title}**") for title in ("Semantics", "Depth completion, MAE / RMSE in mm")
    )
    shipped = lines[semantics + 4].split(" | ")
    assert shipped[:2] == ["| shipped", "as it ships"]
    assert 0 <= float(shipped[2]) <= 100
    rows = {line.split(" | ")[0]: line.split(" | ") for line in lines[depth:]}
    assert all(" / " in cell for cell in rows["| thin one"][2:4])
    assert rows["| big"][1:6] == ["not trained here", "", "", "", ""]
    assert float(rows["| filling"][8].rstrip(" |")) >= 0
