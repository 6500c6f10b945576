"""`ssdnet-eval`: the same inputs and figures for a checkpoint and the file exported from it."""

import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from export.exporter import export_checkpoint
from layouts import camvid, kitti_streets
from models import create_model, load_checkpoint, save_checkpoint
from runtime.bundled_models import find_model
from runtime.contract import ClassInfo
from training.evaluation.cli import app
from training.evaluation.scored_model import open_method, open_model

#: Few layers: tracing one for every size takes long.
SMALL = {
    "encoder_channels": (8,),
    "encoder_blocks": (1,),
    "decoder_channels": (8,),
    "boundary_channels": 4,
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two rendered-layout frames, a CamVid frame, a checkpoint and its export."""
    root = tmp_path_factory.mktemp("eval")
    rng = np.random.default_rng(0)
    variant = root / "scenes" / "Scene01" / "clone"
    for kind in ("rgb", "depth", "classSegmentation"):
        (variant / "frames" / kind / "Camera_0").mkdir(parents=True)
    (variant / "colors.txt").write_text("Category r g b\nRoad 100 60 100\nCar 0 9 9\n")
    (variant / "intrinsic.txt").write_text("frame cam a b c d\n0 0 90 90 48 30\n1 0 90 90 48 30\n")
    for index in range(2):
        label = np.full((64, 96, 3), (100, 60, 100), np.uint8)
        label[:, :40] = (9, 9, 0)
        depth = rng.integers(400, 8000, (64, 96)).astype(np.uint16)
        depth[:10] = 65535
        image = rng.integers(0, 255, (64, 96, 3), dtype=np.uint8)
        frames = variant / "frames"
        cv2.imwrite(str(frames / "rgb" / "Camera_0" / f"rgb_{index:05d}.jpg"), image)
        cv2.imwrite(str(frames / "depth" / "Camera_0" / f"depth_{index:05d}.png"), depth)
        classes = frames / "classSegmentation" / "Camera_0" / f"classgt_{index:05d}.png"
        cv2.imwrite(str(classes), label)
    for name, pixels in (("val", image), ("valannot", np.full((64, 96), 3, np.uint8))):
        (root / "camvid" / name).mkdir(parents=True)
        cv2.imwrite(str(root / "camvid" / name / "a.png"), pixels)
    torch.manual_seed(0)
    network = create_model("ssdnet", canonical_focal_px=150.0, **SMALL).eval()
    save_checkpoint(root / "lite.pt", network, training={"trained_height": 40})
    export_checkpoint(root / "lite.pt", root / "lite.onnx", size=(64, 96), dynamic=True)
    return root


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in (*arguments, "--threads", 1)])


def test_checkpoint_and_export_score_alike_on_every_lidar_and_fault(folder, tmp_path):
    out = tmp_path / "rows.json"
    result = run(
        folder / "lite.pt",
        folder / "lite.onnx",
        "nearest",
        *("--data", f"rendered:{folder}/scenes", "--data", f"camvid:{folder}/camvid,split=val"),
        *("--lidar", "64,random:0.05,none", "--faults", "nan"),
        *("--size", "frame"),
        *("--json", out),
    )
    assert result.exit_code == 0, result.output
    rows = json.loads(out.read_text())
    # Two models and a method: two LiDARs with and without the fault, none; CamVid feeds nothing.
    assert len(rows) == 3 * ((2 * 2 + 1) + 1)
    by_key = {(r["model"], r["data"], r["lidar"], r["fault"]): r for r in rows}
    for (model, data, lidar, fault), row in by_key.items():
        if model == "lite.pt":
            twin = by_key["lite.onnx", data, lidar, fault]
            assert row["engine"] == "torch on cpu"
            assert twin["engine"] == "onnxruntime on cpu"
            assert row["figures"].keys() == twin["figures"].keys()
            for name, value in row["figures"].items():
                if value is not None:
                    assert twin["figures"][name] == pytest.approx(value, rel=1e-3, abs=2e-3), name
    figures = by_key["lite.pt", "scenes", "64", "none"]["figures"]
    wanted = {"miou", "fwiou", "category_miou", "iou_car", "mae_m", "mae_m_0_20", "rmse_m_0_50"}
    assert wanted | {"imae_per_km", "boundary_f", "boundary_recall"} <= figures.keys()
    nearest = [by_key["nearest", "scenes", lidar, "none"] for lidar in ("64", "none")]
    assert nearest[0]["figures"]["mae_m"] < nearest[1]["figures"]["mae_m"]
    camvid = [row for row in rows if row["data"] == "camvid split=val"]
    assert [(row["lidar"], row["fault"], row["frames"]) for row in camvid] == 3 * [
        ("none", "none", 1)
    ]
    assert "mae_m" not in camvid[0]["figures"]
    assert "miou" in camvid[0]["figures"]
    assert "| lite.onnx" in result.output


def test_checkpoint_and_export_run_at_one_size(folder, tmp_path):
    """Frames of 64 rows for a network trained on 40: shrunk for both, unless asked otherwise.

    It works in canonical depth: both take the focal length of the scenes, at the size they run at.
    """
    data = ["--data", f"rendered:{folder}/scenes", "--json", tmp_path / "rows.json"]
    figures = {}
    for size in ("auto", "frame", "40", "48x80"):
        result = run(folder / "lite.pt", folder / "lite.onnx", *data, "--size", size)
        assert result.exit_code == 0, result.output
        torch_row, file_row = json.loads((tmp_path / "rows.json").read_text())
        assert file_row["figures"]["mae_m"] == pytest.approx(torch_row["figures"]["mae_m"], 1e-4)
        assert file_row["figures"]["miou"] == pytest.approx(torch_row["figures"]["miou"], 1e-2)
        figures[size] = torch_row["figures"]
    assert figures["auto"] == figures["40"]
    assert figures["auto"]["mae_m"] != figures["frame"]["mae_m"] != figures["48x80"]["mae_m"]
    network = load_checkpoint(folder / "lite.pt").model
    network.config = replace(network.config, canonical_focal_px=None)
    save_checkpoint(tmp_path / "plain.pt", network)
    plain = run(tmp_path / "plain.pt", *data, "--size", "frame")
    assert plain.exit_code == 0, plain.output
    (row,) = json.loads((tmp_path / "rows.json").read_text())
    assert row["figures"]["mae_m"] != pytest.approx(figures["frame"]["mae_m"], 1e-2)


def test_methods_are_scored_by_name_and_need_no_model(folder, tmp_path):
    out, data = tmp_path / "rows.json", f"rendered:{folder}/scenes"
    names = ["tgv", "ip-basic", "mrf", "ip-basic-multiscale", "nearest"]
    result = run(*names, "--data", data, "--lidar", "random:0.05,none", "--json", out)
    assert result.exit_code == 0, result.output
    rows = json.loads(out.read_text())
    assert [(row["model"], row["lidar"]) for row in rows] == [
        (name, lidar) for name in names for lidar in ("random:0.05", "none")
    ]
    for row in rows:
        assert row["engine"] == "no network"
        assert "miou" not in row["figures"]
    mae = {(row["model"], row["lidar"]): row["figures"]["mae_m"] for row in rows}
    # Without a return the answer is 0 whatever the method: what is scored is the mean depth.
    assert len({mae[name, "none"] for name in names}) == 1
    assert all(mae[name, "random:0.05"] < mae[name, "none"] for name in names)


def test_a_name_of_nothing_lists_models_and_methods(folder):
    result = run("ip_basic", "--data", f"rendered:{folder}/scenes")
    assert result.exit_code == 1
    assert "ssdnet-lite" in result.output
    assert (
        "Classical methods: nearest, linear, planes, ip-basic, ip-basic-multiscale, mrf, tgv"
        in result.output
    )


def write_folders(root, count=2):
    """Pictures with recorded returns beside them, without ground truth."""
    rng = np.random.default_rng(0)
    (root / "images").mkdir()
    (root / "returns").mkdir()
    for number in range(count):
        returns = np.zeros((40, 64), np.uint16)
        returns.flat[rng.choice(returns.size, 200, replace=False)] = rng.integers(512, 9999, 200)
        cv2.imwrite(str(root / f"images/{number}.png"), np.full((40, 64, 3), 90, np.uint8))
        cv2.imwrite(str(root / f"returns/{number}.png"), returns)
    return f"folders:{root},sparse_depth=returns"


def test_a_lidar_that_is_the_truth_is_refused(tmp_path):
    """Its answer would be free of errors, whatever the model."""
    data = f"{write_folders(tmp_path)},depth=returns"
    for lidar in ("own", "none,random:1"):
        result = run("nearest", "--data", data, "--lidar", lidar)
        assert result.exit_code == 1
        assert f"with the LiDAR {lidar.split(',')[-1]!r} the input is the depth to score" in (
            result.output
        )
        assert "random:0.5" in result.output
    result = run("nearest", "--data", data, "--lidar", "random:0.5,none")
    assert result.exit_code == 0, result.output


def test_depth_of_models_and_methods_is_saved_without_ground_truth(tmp_path):
    data, save = write_folders(tmp_path), tmp_path / "depth"
    models = ["nearest", "ssdnet-nano"]
    result = run(*models, "--data", data, "--lidar", "own,none", "--save", save)
    assert result.exit_code == 0, result.output
    for model in ("nearest", "ssdnet-nano.onnx"):
        text = f"{model} on {tmp_path.name} sparse_depth=returns, LiDAR own: nothing to score"
        assert text in result.output
    assert "|" not in result.output.splitlines()[0]
    files = sorted(path.relative_to(save) for path in save.rglob("*") if path.is_file())
    set_name = f"{tmp_path.name}_sparse_depth_returns"
    assert files == sorted(
        Path(model, set_name, lidar, tmp_path.name, f"{frame}.png")
        for model in ("nearest", "ssdnet-nano.onnx")
        for lidar in ("own", "none")
        for frame in (0, 1)
    )
    returns = cv2.imread(str(tmp_path / "returns/1.png"), cv2.IMREAD_UNCHANGED)
    with open_model(find_model("ssdnet-nano")) as network:
        for name, model in (("nearest", open_method("nearest")), ("ssdnet-nano.onnx", network)):
            rgb = np.full((40, 64, 3), 90, np.uint8)
            depth = model.predict(rgb, (returns / 256).astype(np.float32), None).depth
            path = save / name / set_name / "own" / tmp_path.name / "1.png"
            written = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            np.testing.assert_array_equal(written, np.rint(depth * 256))


def test_saved_depth_is_replaced_only_when_asked(tmp_path):
    data, save = write_folders(tmp_path, 1), tmp_path / "depth"
    command = ["nearest", "--data", data, "--save", save]
    assert run(*command).exit_code == 0
    (path,) = save.rglob("*.png")
    content = path.read_bytes()
    path.write_bytes(b"old")
    (save / "notes.txt").write_text("mine")
    result = run(*command)
    assert result.exit_code == 1
    assert f"{save} is not empty" in result.output
    assert "--overwrite" in result.output
    assert path.read_bytes() == b"old"
    assert run(*command, "--overwrite").exit_code == 0
    assert path.read_bytes() == content
    assert (save / "notes.txt").read_text() == "mine"
    for place, reason in ((path, "is not a folder"), (path / "a", "Not a directory")):
        result = run("nearest", "--data", data, "--save", place)
        assert result.exit_code == 1
        assert reason in result.output


def test_frames_of_one_place_count_as_one_in_the_mean_over_places(tmp_path):
    """Errors of 0 m in two frames of one place, of 10 m in a frame of another."""
    kitti_streets.write_streets(tmp_path, (72, 73, 83))
    far = np.zeros((kitti_streets.HEIGHT, kitti_streets.WIDTH), np.uint16)
    far[:, : kitti_streets.WIDTH // 2] = 2 * 256  # 20 m
    cv2.imwrite(str(tmp_path / "disp_occ_0/000083.png"), far)
    out = tmp_path / "rows.json"
    command = ["nearest", "--lidar", "64", "--json", out, "--data"]
    result = run(*command, f"kitti-streets:{tmp_path}")
    assert result.exit_code == 0, result.output
    (row,) = json.loads(out.read_text())
    assert row["figures"]["mae_m"] == pytest.approx(10 / 3)
    assert row["figures_over_places"]["mae_m"] == pytest.approx(5)
    assert {place: figures["mae_m"] for place, figures in row["places"].items()} == {
        "000072": pytest.approx(0),
        "000083": pytest.approx(10),
    }
    assert "mean over 2 places" in result.output.splitlines()[-2]
    for last in (71, 73):  # no place is known of the first, and the others show one
        kitti_streets.write_streets(tmp_path, (last - 2,))
        assert run(*command, f"kitti-streets:{tmp_path},last={last}").exit_code == 0
        (row,) = json.loads(out.read_text())
        assert (row["places"], row["figures_over_places"]) == ({}, {})


def test_errors_say_what_to_do(folder, tmp_path):
    data = f"rendered:{folder}/scenes"
    for arguments, text in (
        ([folder / "lite.pt", "--data", "camvid"], "KIND:FOLDER"),
        ([folder / "lite.pt", "--data", f"lyft:{folder}"], "lyft"),
        ([folder / "lite.pt", "--data", f"rendered:{folder}/nothing"], "no folder"),
        (
            [folder / "lite.pt", "--data", f"{data},split=val"],
            "unknown key split; known here: kind, path, weight",
        ),
        ([folder / "lite.pt", "--data", data, "--lidar", "5"], "divides 64"),
        ([folder / "lite.pt", "--data", data, "--faults", "rain"], "known: nan"),
        ([folder / "lite.pt", "--data", f"{data},name=a,name=b"], "name is given twice"),
        ([folder / "lite.pt", "--data", f"{data},path=b"], "path is given twice"),
        *(
            ([model, "--data", data, "--device", device], f"unknown device '{device}'")
            for model in (folder / "lite.pt", folder / "lite.onnx", "linear")
            for device in ("gpu", "mps", "CUDA", "meta", "cuda:", "cuda:x", "cpu:0")
        ),
        ([tmp_path / "x.tflite", "--data", data], "expected a checkpoint"),
        ([tmp_path / "x.pt", "--data", data], "x.pt"),
    ):
        result = run(*arguments)
        assert result.exit_code == 1, arguments
        assert result.output.splitlines()[-1].startswith("error: ")
        assert text in result.output, (text, result.output)


def test_one_row_where_no_lidar_could_be_fed(folder, tmp_path):
    """Whatever was asked for: CamVid has no depth."""
    out, data = tmp_path / "rows.json", f"camvid:{folder}/camvid,split=val"
    for lidar in ("own", "64,16,random:0.05", "none", "none, none"):
        result = run(
            *(folder / "lite.pt", "--data", data, "--lidar", lidar, "--faults", "nan,shift"),
            *("--json", out),
        )
        assert result.exit_code == 0, result.output
        (row,) = json.loads(out.read_text())
        assert (row["lidar"], row["fault"]) == ("none", "none")


def test_data_without_ground_truth_says_what_to_give(tmp_path):
    """And what is given then is scored, under the set's own name."""
    rgb, label = np.full((40, 64, 3), 90, np.uint8), np.full((40, 64), 3, np.uint8)
    camvid.write_frame(tmp_path, rgb, label)
    data = f"folders:{tmp_path},rgb=train"
    lacks = "none of the 1 frames has {0} as ground truth; .*folders:DIR,{0}=FOLDER"
    result = run("ssdnet-nano", "--data", data, "--limit", 1)
    assert result.exit_code == 0, result.output
    assert re.search(lacks.format("labels"), result.output)
    assert re.search(lacks.format("depth"), result.output)
    result = run("ssdnet-nano", "--data", f"{data},labels=trainannot,name=street")
    assert result.exit_code == 0, result.output
    assert "has labels to score" not in result.output
    assert re.search("street: " + lacks.format("depth"), result.output)
    assert "| street |" in result.output


def test_truth_that_is_not_scored_is_counted(tmp_path):
    """Depth beyond 100 m, as of a wrong unit, pixels without a class, and classes not shown."""
    data = f"folders:{tmp_path},labels=labels,depth=depth,sparse_depth=lidar,name=2011-09-26"

    def write(folder, values):
        (tmp_path / folder).mkdir(exist_ok=True)
        values = np.array(values, np.uint8 if folder in ("images", "labels") else np.uint16)
        values = values.repeat(40, 0).repeat(64 // values.size, 1)
        cv2.imwrite(str(tmp_path / folder / "a.png"), values)

    def scored():
        result = run("ssdnet-nano", "--data", data)
        assert result.exit_code == 0, result.output
        return result.output

    for folder, value in (("images", 90), ("labels", 3), ("depth", 120 * 256), ("lidar", 5 * 256)):
        write(folder, [[value]])
    output = scored()
    assert "2011-09-26: 100 % of the depth is beyond 100 m and not scored" in output
    assert "as ground truth" not in output
    assert re.search(r"ssdnet-nano\S* on 2011-09-26: mIoU over \d of 11 classes", output)
    write("depth", [[5000, 5000, 5000, 30_000]])
    write("labels", [[3, 255]])
    output = scored()
    assert "25 % of the depth is beyond" in output
    assert "50 % of the labelled images has no class" in output


def write_halves(root):
    """A picture whose left half is red, with labels: 7 in the left half, 3 in the right, 9 above.

    A quarter of the right half is red, too.
    """
    rgb, label = np.full((40, 64, 3), (20, 10, 20), np.uint8), np.full((40, 64), 3, np.uint8)
    rgb[:, :32, 0] = rgb[:10, 32:, 0] = 200
    label[:, :32] = 7
    label[:4] = 9
    for name, values in (("images", rgb[..., ::-1]), ("labels", label)):
        (root / name).mkdir()
        cv2.imwrite(str(root / name / "a.png"), values)
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
    out = tmp_path / "rows.json"
    one, other = named_model("one.onnx", "road", "car"), named_model("other.onnx", "road", "tree")
    result = run(one, "--data", data, "--json", out)
    assert result.exit_code == 0, result.output
    (row,) = json.loads(out.read_text())
    assert row["figures"]["iou_road"] == pytest.approx(30 / 36)  # 6 of 36 rows are called car
    assert row["figures"]["iou_car"] == pytest.approx(36 / 42)
    assert row["figures"]["miou"] == pytest.approx((30 / 36 + 36 / 42) / 2)
    assert "iou_sky" not in row["figures"]
    why = "halves: left out of the mean, as a class must be one of the set and of every model: "
    assert f"{why}sky (halves)" in result.output.splitlines()
    result = run(one, other, "--data", data, "--json", out)
    assert result.exit_code == 0, result.output
    rows = json.loads(out.read_text())
    for row in rows:  # a car or a tree is no road
        assert row["figures"]["miou"] == row["figures"]["iou_road"] == pytest.approx(30 / 36)
        assert row["figures"]["accuracy"] == pytest.approx(30 / 36)
        assert "category_miou" not in row["figures"]
    lines = [line for line in result.output.splitlines() if "left out" in line]
    assert lines == [f"{why}car, sky (halves); car (one.onnx); tree (other.onnx)"]


def test_a_model_of_its_own_classes_is_scored_on_camvid(named_model, tmp_path):
    """Its class 0 is a road, CamVid's is the sky."""
    out, rgb = tmp_path / "rows.json", np.full((40, 64, 3), (20, 10, 20), np.uint8)
    rgb[:, :32, 0] = 200
    label = np.where(rgb[..., 0] == 200, 8, 3).astype(np.uint8)  # CamVid's car and road
    camvid.write_frame(tmp_path, rgb, label)
    command = [named_model("own.onnx", "road", "car"), "--data", f"camvid:{tmp_path}"]
    result = run(*command, "--json", out)
    assert result.exit_code == 0, result.output
    (row,) = json.loads(out.read_text())
    assert {key: v for key, v in row["figures"].items() if key.startswith("iou_")} == {
        "iou_road": 1,
        "iou_car": 1,
    }
    assert row["labelled"] == {"road": [40 * 32, 1], "car": [40 * 32, 1]}


def test_numbers_without_names_are_no_classes_of_several_models(named_model, tmp_path):
    models = named_model("one.onnx", "road", "car"), named_model("other.onnx", "car", "road")
    result = run(*models, "--data", write_halves(tmp_path))
    assert result.exit_code == 1
    assert "its labels are numbers, and the models have different classes" in result.output
    assert "(one.onnx: road, car; other.onnx: car, road)" in result.output
    assert "label_ids={0 = " in result.output


@pytest.mark.parametrize(
    ("name", "text"), [("no/x.json", "no folder"), ("", "is a folder"), (300 * "x", "too long")]
)
def test_a_bad_path_is_refused_before_any_work(tmp_path, name, text):
    result = run("no.pt", "--data", "camvid:nowhere", "--json", tmp_path / name)
    assert result.exit_code == 1
    assert str(tmp_path / name) in result.output
    assert text in result.output
