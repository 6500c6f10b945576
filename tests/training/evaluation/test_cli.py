"""`ssdnet-eval`: the same inputs and figures for a checkpoint and the file exported from it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from export.exporter import export_checkpoint
from layouts import camvid, kitti_streets, virtual_kitti
from layouts.evaluation import run, score
from layouts.pictures import read, write
from models import create_model, load_checkpoint, save_checkpoint
from runtime.contract.contract import ClassInfo
from training.evaluation.classical import METHODS
from training.evaluation.open_model import open_method

# Few layers: tracing one for every size takes long.
SMALL = {
    "encoder_channels": (8,),
    "encoder_blocks": (1,),
    "decoder_channels": (8,),
    "boundary_channels": 4,
}
GREY, ROAD = np.full((40, 64, 3), 90, np.uint8), np.full((40, 64), 3, np.uint8)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two rendered-layout frames, a CamVid frame, a checkpoint and its export."""
    root = tmp_path_factory.mktemp("eval")
    variant = virtual_kitti.write_second_edition(root / "scenes", magnify=8)
    (variant / "intrinsic.txt").write_text("a b c d e f\n0 0 90 90 60 30\n1 0 90 90 60 30\n")
    camvid.write_frame(root / "camvid", GREY, ROAD, split="val")
    torch.manual_seed(0)
    network = create_model("ssdnet", canonical_focal_px=150.0, **SMALL).eval()
    save_checkpoint(root / "lite.pt", network, training={"trained_height": 40})
    export_checkpoint(root / "lite.pt", root / "lite.onnx", size=(64, 96), dynamic=True)
    return root


def test_checkpoint_and_export_score_alike_on_every_lidar_and_fault(folder):
    rows, output = score(
        *(folder / "lite.pt", folder / "lite.onnx", "nearest", "--size", "frame"),
        *("--data", f"rendered:{folder}/scenes", "--data", f"camvid:{folder}/camvid,split=val"),
        *("--lidar", "64,random:0.05,none,none", "--faults", "nan,black"),
    )
    # Two models and a method: two LiDARs with and without the faults, none with those of the
    # camera; CamVid feeds nothing.
    assert len(rows) == 3 * ((2 * 3 + 2) + 2)
    by_key = {(r["model"], r["data"], r["lidar"], r["fault"]): r for r in rows}
    for (model, *key), row in by_key.items():
        if model == "lite.pt":
            twin = by_key["lite.onnx", *key]
            assert (row["engine"], twin["engine"]) == ("torch on cpu", "onnxruntime on cpu")
            # A class that neither has is None in both.
            expected = {k: v or 0 for k, v in row["figures"].items()}
            figures = {k: v or 0 for k, v in twin["figures"].items()}
            assert figures == pytest.approx(expected, rel=1e-3, abs=2e-3)
    figures = by_key["lite.pt", "scenes", "64", "none"]["figures"]
    wanted = {"miou", "fwiou", "category_miou", "iou_car", "mae_m", "mae_m_0_20", "rmse_m_0_50"}
    assert wanted | {"imae_per_km", "boundary_f", "boundary_recall"} <= figures.keys()
    for fault in ("nan", "black"):
        assert by_key["lite.pt", "scenes", "64", fault]["figures"]["mae_m"] != figures["mae_m"]
    alone = by_key["lite.pt", "camvid split=val", "none", "none"]
    assert alone["frames"] == 1
    assert "miou" in alone["figures"]
    assert "mae_m" not in alone["figures"]
    assert "| lite.onnx" in output


def test_checkpoint_and_export_run_at_one_size(folder, tmp_path):
    """Frames of 64 rows for a network trained on 40: shrunk for both, unless asked otherwise.

    It works in canonical depth: both take the focal length of the scenes, at the size they run at.
    """
    data = ["--data", f"rendered:{folder}/scenes", "--limit", 1]
    mae_m = {}
    for size in ("auto", "frame", "40", "48x80"):
        rows, _ = score(folder / "lite.pt", folder / "lite.onnx", *data, "--size", size)
        ours, exported = (row["figures"] for row in rows)
        assert exported["mae_m"] == pytest.approx(ours["mae_m"], 1e-4)
        assert exported["miou"] == pytest.approx(ours["miou"], 1e-2)
        mae_m[size] = ours["mae_m"]
    assert mae_m["auto"] == mae_m["40"]
    assert len(set(mae_m.values())) == 3
    network = load_checkpoint(folder / "lite.pt").model
    network.config = replace(network.config, canonical_focal_px=None)
    save_checkpoint(tmp_path / "plain.pt", network)
    ((plain,), _) = score(tmp_path / "plain.pt", *data, "--size", "frame")
    assert plain["figures"]["mae_m"] != pytest.approx(mae_m["frame"], 1e-2)


def test_methods_are_scored_by_name_and_need_no_model(folder):
    names = ["tgv", "ip-basic", "mrf", "ip-basic-multiscale", "nearest"]
    data = ["--data", f"rendered:{folder}/scenes"]
    rows, _ = score(*names, *data, "--lidar", "random:0.05,none", "--limit", 1)
    by_key = {(row["model"], row["lidar"]): row for row in rows}
    assert list(by_key) == [(name, lidar) for name in names for lidar in ("random:0.05", "none")]
    assert {row["engine"] for row in rows} == {"no network"}
    mae_m = {key: row["figures"]["mae_m"] for key, row in by_key.items()}
    # Without a return the answer is 0 whatever the method: what is scored is the mean depth.
    assert [mae_m[name, "none"] for name in names] == [pytest.approx(12.34, abs=0.01)] * 5
    assert all(mae_m[name, "random:0.05"] < 3 for name in names)
    unknown = run("ip_basic", *data)
    assert unknown.exit_code == 1
    assert all(name in unknown.output for name in ("ssdnet-lite", *METHODS))


def test_a_document_is_printed_alone_or_written_and_never_replaced_unasked(folder, tmp_path):
    command = ["nearest", "--data", f"rendered:{folder}/scenes", "--limit", 1, "--json"]
    (row,) = json.loads(run(*command, "-").stdout)
    file = tmp_path / "rows.json"
    assert run(*command, file).exit_code == 0
    assert json.loads(file.read_text())[0]["figures"] == row["figures"]
    file.write_text("mine")
    assert run(*command, file).exit_code == 1
    assert file.read_text() == "mine"


def write_folders(root):
    """Pictures with recorded returns beside them, without ground truth."""
    rng = np.random.default_rng(0)
    for number in range(2):
        returns = np.zeros((40, 64), np.uint16)
        returns.flat[rng.choice(returns.size, 200, replace=False)] = rng.integers(512, 9999, 200)
        write(root / f"images/{number}.png", GREY)
        write(root / f"returns/{number}.png", returns)
    return f"folders:{root},sparse_depth=returns"


def test_a_lidar_that_is_the_truth_is_refused(tmp_path):
    """Every model would answer without errors."""
    data = f"{write_folders(tmp_path)},depth=returns"
    for lidar in ("own", "none,random:1"):
        result = run("nearest", "--data", data, "--lidar", lidar)
        assert result.exit_code == 1
        assert repr(lidar.split(",")[-1]) in result.output
    assert run("nearest", "--data", data, "--lidar", "random:0.5,none").exit_code == 0


def test_depth_is_saved_without_ground_truth_and_replaced_when_asked(tmp_path):
    data, save = write_folders(tmp_path), tmp_path / "depth"
    command = ["nearest", "ssdnet-nano", "--data", data, "--lidar", "own,none", "--save", save]
    result = run(*command)
    assert result.exit_code == 0, result.output
    models = ("nearest", "ssdnet-nano.onnx")
    name = f"{tmp_path.name} sparse_depth=returns"
    assert all(f"{m} on {name}, LiDAR own: nothing to score" in result.output for m in models)
    written = {path.relative_to(save): path for path in save.rglob("*.png")}
    assert written.keys() == {
        Path(model, name.translate({32: "_", 61: "_"}), lidar, tmp_path.name, f"{frame}.png")
        for model in models
        for lidar in ("own", "none")
        for frame in (0, 1)
    }
    (path,) = (
        path for key, path in written.items() if key.parts[::2] == ("nearest", "own", "1.png")
    )
    returns = read(tmp_path / "returns/1.png")
    answer = open_method("nearest").predict(GREY, (returns / 256).astype(np.float32), None)
    np.testing.assert_array_equal(read(path), np.rint(answer.depth * 256))

    path.write_bytes(b"old")
    (save / "notes.txt").write_text("mine")
    result = run(*command)
    assert (result.exit_code, path.read_bytes()) == (1, b"old")
    assert "--overwrite" in result.output
    assert run(*command, "--overwrite").exit_code == 0
    np.testing.assert_array_equal(read(path), np.rint(answer.depth * 256))
    assert (save / "notes.txt").read_text() == "mine"
    for place in (path, path / "a"):
        result = run("no.pt", "--data", data, "--save", place)
        assert result.exit_code == 1
        assert str(path) in result.output


def test_frames_of_one_place_count_as_one_in_the_mean_over_places(tmp_path):
    """Errors of 0 m in two frames of one place, of 10 m in a frame of another."""
    kitti_streets.write_streets(tmp_path, (72, 73, 83))
    far = np.zeros((kitti_streets.HEIGHT, kitti_streets.WIDTH), np.uint16)
    far[:, : kitti_streets.WIDTH // 2] = 2 * 256  # 20 m
    write(tmp_path / "disp_occ_0/000083.png", far)
    command = ["nearest", "--lidar", "64", "--data"]
    (row,), output = score(*command, f"kitti-streets:{tmp_path}")
    assert row["figures"]["mae_m"] == pytest.approx(10 / 3)
    assert row["figures_over_places"]["mae_m"] == pytest.approx(5)
    assert {place: figures["mae_m"] for place, figures in row["places"].items()} == {
        "000072": pytest.approx(0),
        "000083": pytest.approx(10),
    }
    assert "mean over 2 places" in output.splitlines()[-2]
    for last in (71, 73):  # no place is known of the first, and the others show one
        kitti_streets.write_streets(tmp_path, (last - 2,))
        (row,), _ = score(*command, f"kitti-streets:{tmp_path},last={last}")
        assert (row["places"], row["figures_over_places"]) == ({}, {})


@pytest.mark.parametrize(("model", "options", "text"), [
    ("lite.pt", ["--data", "camvid"], "KIND:FOLDER"),
    ("lite.pt", ["--data", "rendered:nothing"], "'nothing'"), ("lite.pt", ["--lidar", "5"], "'5'"),
    ("lite.pt", ["--faults", "rain"], "give one of nan"),
    *((model, ["--device", "gpu"], "'gpu'") for model in ("lite.pt", "lite.onnx", "linear")),
    ("x.tflite", [], "x.tflite"), ("x.pt", [], "x.pt"),
    ("no.pt", ["--json", "no/x.json"], "no/x.json"),
])  # fmt: skip
def test_errors_name_what_is_wrong(folder, model, options, text):
    data = [] if "--data" in options else ["--data", f"rendered:{folder}/scenes"]
    result = run(model if model == "linear" else folder / model, *data, *options)
    assert result.exit_code == 1
    assert result.output.splitlines()[-1].startswith("error: ")
    assert text in result.output


def test_truth_that_is_missing_or_not_scored_is_counted(tmp_path):
    """Counted are depth beyond 100 m, pixels without a class, and classes that never occur."""
    write(tmp_path / "images" / "a.png", GREY)
    write(tmp_path / "lidar" / "a.png", np.full((40, 64), 5 * 256, np.uint16))
    write(tmp_path / "labels" / "a.png", np.where(np.arange(64) < 32, ROAD, 255).astype(np.uint8))
    depth = np.where(np.arange(64) < 48, np.full((40, 64), 5000), 30_000)
    write(tmp_path / "depth" / "a.png", depth.astype(np.uint16))
    data = f"folders:{tmp_path},name=2011-09-26,sparse_depth=lidar"
    _, output = score("ssdnet-nano", "--data", f"{data},labels=labels,depth=depth")
    assert "| 2011-09-26 |" in output
    assert "2011-09-26: 25 % of the depth is beyond 100 m" in output
    assert "50 % of the labelled pixels have no class" in output
    assert "as ground truth" not in output
    (row,), output = score("ssdnet-nano", "--data", data)
    assert row["figures"] == {}
    assert all(f"none of the 1 frames has {truth}" in output for truth in ("labels", "depth"))


def write_halves(root):
    """A picture whose left half is red, with labels: 7 in the left half, 3 in the right, 9 above.

    A quarter of the right half is red, too.
    """
    rgb, label = np.full((40, 64, 3), (20, 10, 20), np.uint8), ROAD.copy()
    rgb[:, :32, 0] = rgb[:10, 32:, 0] = 200
    label[:, :32] = 7
    label[:4] = 9
    write(root / "images" / "a.png", rgb)
    write(root / "labels" / "a.png", label)
    return f"folders:{root},name=halves,labels=labels"


@pytest.fixture
def named_model(model_file, contract):
    """Write a model that answers the second class where the picture is red, else the first."""

    def write(name, *classes):
        infos = tuple(ClassInfo(name, (index, 0, 0)) for index, name in enumerate(classes))
        return model_file(name, contract=replace(contract, classes=infos))

    return write


def test_classes_are_compared_by_name(named_model, tmp_path):
    """Two models of one table in the classes that both have, whatever their numbers."""
    data = write_halves(tmp_path) + ',label_ids={3="road",7="car",9="sky"}'
    one, other = named_model("one.onnx", "road", "car"), named_model("other.onnx", "road", "tree")
    (row,), output = score(one, "--data", data)
    ious = {"iou_road": 30 / 36, "iou_car": 36 / 42}  # 6 of 36 rows are called car
    assert {k: v for k, v in row["figures"].items() if k[:4] == "iou_"} == pytest.approx(ious)
    assert row["figures"]["miou"] == pytest.approx(sum(ious.values()) / 2)
    assert row["labelled"] == {"road": [36 * 32, 1], "car": [36 * 32, 1]}
    assert [line for line in output.splitlines() if line.endswith(": sky (halves)")]
    rows, output = score(one, other, "--data", data)
    for row in rows:  # a car or a tree is no road
        assert row["figures"]["miou"] == row["figures"]["iou_road"] == pytest.approx(30 / 36)
        assert row["figures"]["accuracy"] == pytest.approx(30 / 36)
        assert "category_miou" not in row["figures"]
    left_out = "car, sky (halves); car (one.onnx); tree (other.onnx)"
    assert [line for line in output.splitlines() if line.endswith(left_out)]


def test_numbers_without_names_are_no_classes_of_several_models(named_model, tmp_path):
    models = named_model("one.onnx", "road", "car"), named_model("other.onnx", "car", "road")
    result = run(*models, "--data", write_halves(tmp_path))
    assert result.exit_code == 1
    assert "(one.onnx: road, car; other.onnx: car, road)" in result.output
    assert "label_ids={0 = " in result.output
