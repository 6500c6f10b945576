"""`ssdnet-export --precision`: files that pass the gate on accuracy, and no others."""

import copy
import re
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import onnx
import pytest
from typer.testing import CliRunner

from export import accuracy, calibration_frames, gate, int8
from export.accuracy import without_folders
from export.cli import app
from export.exporter import export_checkpoint
from export.options import ExportOptions
from export.precision import Precision
from export.probe_frames import probe_frames
from export.quantize import Ranges
from runtime import InputError, Predictor
from runtime.app.tools.info import app as info_app
from runtime.app.tools.verify import app as verify_app
from runtime.contract.model_file import load_model_file
from runtime.verification.reference import read_reference

SIZE = (64, 96)


@pytest.fixture(scope="module")
def data(exported, tmp_path_factory):
    """Frames whose labels are the model's own, and whose depth is nearly so."""
    folder = tmp_path_factory.mktemp("a place") / "street"
    for name in ("images", "depth", "labels", "none"):
        (folder / name).mkdir(parents=True)
    with Predictor(exported.path) as predictor:
        for index, frame in enumerate(probe_frames(SIZE, max_depth_m=80.0)[:3]):
            name = f"{index}.png"
            answer = predictor.predict(frame.rgb, None)
            depth = np.rint(answer.depth * 256 * 1.05).astype(np.uint16)
            cv2.imwrite(str(folder / "images" / name), frame.rgb[..., ::-1])
            cv2.imwrite(str(folder / "depth" / name), depth)
            cv2.imwrite(str(folder / "labels" / name), answer.semantic)
            cv2.imwrite(str(folder / "none" / name), np.full(SIZE, 255, np.uint8))
    # Int8 is calibrated on other images than it is validated on: a copy would be found.
    others = folder.parent / "other" / "street" / "images"
    others.mkdir(parents=True)
    for path in (folder / "images").iterdir():
        image = cv2.imread(str(path))
        image[0, 0] = 255 - image[0, 0]
        cv2.imwrite(str(others / path.name), image)
    return folder


@pytest.fixture
def few(monkeypatch):
    """Three frames are enough: each takes time."""
    monkeypatch.setattr(calibration_frames, "LEAST_FRAMES", 3)


def run(checkpoint, data, folder, *options, target="depth=depth,labels=labels"):
    """Export to `folder`/lite.onnx in 8-bit integers."""
    words = [str(checkpoint), str(folder / "lite.onnx"), "--height", "64", "--width", "96"]
    words += ["--precision", "int8", "--calibrate", f"folders:{data.parent}/other/street"]
    words += ["--validate", f"folders:{data},{target}", *options]
    return CliRunner().invoke(app, words)


@pytest.fixture
def export_int8(lite_checkpoint, data, tmp_path, traced):
    return partial(run, lite_checkpoint, data, tmp_path)


@pytest.fixture(scope="module")
def quantised(lite_checkpoint, lite_model, data, tmp_path_factory):
    """What an export to int8 prints and writes: output, path, contract, and reference."""
    folder = tmp_path_factory.mktemp("int8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("export.build.trace", lambda *_, **__: copy.deepcopy(lite_model))
        patch.setattr(calibration_frames, "LEAST_FRAMES", 3)
        # No option limits these, and the small network has random weights.
        for name in ("MAX_DROP_CLASS_IOU", "MAX_DROP_BOUNDARY_F", "MAX_CHANGE_COVERAGE"):
            patch.setattr(gate, name, 1000.0)
        options = ["--max-drop-miou", "100", "--max-rise-mae", "1000"]
        options += ["--record", str(folder / "reference")]
        result = run(lite_checkpoint, data, folder, *options)
    assert result.exit_code == 0, result.output
    path = folder / "lite.onnx"
    contract = load_model_file(path).contract
    return SimpleNamespace(
        output=result.output, path=path, contract=contract, reference=folder / "reference"
    )


def test_too_few_frames_are_refused_before_any_work(export_int8, data, tmp_path, monkeypatch):
    monkeypatch.setattr("export.build.trace", lambda *_, **__: pytest.fail("traced first"))
    again = [f"folders:{data.parent}/other/street,name=again{number}" for number in range(33)]
    for options in ([], [word for text in again for word in ("--calibrate", text)]):
        result = export_int8(*options)
        assert result.exit_code == 1
        assert "--calibrate: 3 frames in all, expected 30 or more" in result.output
    monkeypatch.setattr(calibration_frames, "LEAST_FRAMES", 3)
    result = export_int8(target="depth=depth,first=1")
    assert "--validate: 2 frames in all, expected 3 or more" in result.output
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("few")
@pytest.mark.parametrize("same", ["{0},name=x", "{1}/street/../street", "{1}/link"])
def test_int8_is_not_validated_on_what_it_is_calibrated_on(export_int8, data, tmp_path, same):
    """The files are compared, because another spelling or a link leads to the same frames."""
    link = data.parent / "link"
    if not link.exists():
        link.symlink_to(data)
    result = export_int8("--calibrate", f"folders:{same.format(data, data.parent)}")
    assert result.exit_code == 1
    assert "int8 is calibrated and validated on 3 frames" in result.output
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("sizes", "counts"), [((367, 65), [64, 64]), ((10, 1000), [10, 118]), ((50, 60), [50, 60])]
)
def test_calibration_frames_are_from_every_set(sizes, counts):
    assert calibration_frames.share_frames(sizes, 128) == counts


def test_an_int8_file_is_smaller_and_says_so(quantised, exported):
    assert quantised.path.stat().st_size < exported.path.stat().st_size
    assert quantised.contract.precision == "int8"


def test_an_int8_file_states_its_calibration(quantised):
    facts = quantised.contract.quantization
    assert facts["calibration"] == ["folders:street"]
    assert facts["calibration_frames"] == 3
    listed = ", ".join(facts["float_convolutions"])
    assert listed
    assert f"convolutions left in float: {listed}" in quantised.output
    assert str(quantised.path.parent.parent) not in quantised.contract.to_json()


def test_an_int8_file_states_what_no_limit_holds(quantised):
    (rare,) = quantised.contract.quantization["not_gated"]
    assert rare.startswith("IoU of sky, building, pole")
    assert quantised.output.splitlines()[-1] == f"not gated: {rare}"
    assert rare in CliRunner().invoke(info_app, [str(quantised.path)]).output
    warning = "street labels=labels depth=depth has 3 frames, fewer than 100"
    assert warning in quantised.output


def test_an_int8_file_states_its_accuracy_before_and_after(quantised):
    accuracy = quantised.contract.accuracy
    assert {row["lidar"] for row in accuracy["rows"]} == {"random:0.05", "none"}
    assert accuracy["repeat"].startswith("ssdnet-eval MODEL --data folders:street,depth=depth")
    before, after = (
        next(row for row in rows if row["lidar"] == "none")
        for rows in (quantised.contract.quantization["accuracy_fp32"], accuracy["rows"])
    )
    assert before["frames"] == after["frames"] == 3
    assert before["miou"] == 1 > after["miou"] > 0.5
    assert 0 < before["mae_m"] != after["mae_m"] > 0
    assert re.search(r"tracing \S+, [\d.]+ M parameters, at \d+ x \d+", quantised.output)
    change = f"MAE {1000 * before['mae_m']:.4g} -> {1000 * after['mae_m']:.4g} mm"
    assert change in quantised.output


def test_an_int8_file_is_verified_within_what_was_measured_and_rounding(quantised):
    reference = read_reference(quantised.reference)
    measured, limits = quantised.contract.parity, reference.limits
    # Frames of a street: 8 bits choose other classes for what shows nothing.
    assert not any("scan lines" in frame.name for frame in reference.frames)
    relative, agreement = measured["depth"]["mean_relative"], measured["semantic"]["agreement"]
    assert limits["depth"] == {"mean_relative": pytest.approx(relative + 0.025)}
    assert limits["semantic"] == {"agreement": pytest.approx(agreement - 0.04)}
    verified = CliRunner().invoke(verify_app, [str(quantised.reference)])
    assert verified.exit_code == 0, verified.output


@pytest.mark.usefixtures("few")
def test_a_missed_gate_writes_nothing_and_names_the_head(export_int8, tmp_path, monkeypatch):
    """Whatever is left in float, the classes are worse than before."""
    measured, widths = [], []

    def measure(path, *options):
        if len(measured) < 2:  # in float, the second time with the LiDAR that the frames lack
            measured.append(accuracy.measure_accuracy(path, *options))
            return measured[-1]
        return [replace(row, miou=row.miou / 2) for row in measured[-1]]

    def measure_once(*arguments):
        if not widths:
            widths.append(accuracy.measure_widths(*arguments))
        return widths[0]

    monkeypatch.setattr(int8, "measure_accuracy", measure)
    monkeypatch.setattr(int8, "measure_widths", measure_once)
    monkeypatch.setattr(int8, "quantize", lambda model, *_, **__: model)
    monkeypatch.setattr(int8, "rank_convolutions", lambda model, alone, names, *_: list(names))
    result = export_int8("--max-rise-mae", "1000")
    assert result.exit_code == 1
    assert "semantic loses" in result.output
    assert "of mIoU on street" in result.output
    assert "convolutions in float, so nothing was written" in " ".join(result.output.split())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("head", ["depth", "semantic"])
def test_convolutions_are_ranked_by_what_each_alone_changes(monkeypatch, head):
    """8 bits add 1, 5 and 0.1 to the answer: by how much depths change, and how many classes."""
    errors = {"a": 1.0, "b": 5.0, "c": 0.1}
    kind = onnx.TensorProto.UINT8 if head == "semantic" else onnx.TensorProto.FLOAT
    x = onnx.helper.make_tensor_value_info("x", onnx.TensorProto.FLOAT, [4])

    def sum_of(keep_float):
        added = np.array([errors[n] for n in errors if n not in keep_float], np.float32).sum()
        nodes = [
            onnx.helper.make_node("Add", ["x", "added"], ["sum"]),
            onnx.helper.make_node("Cast", ["sum"], [head], to=kind),
        ]
        answer = onnx.helper.make_tensor_value_info(head, kind, [4])
        weight = onnx.numpy_helper.from_array(np.float32(added), "added")
        graph = onnx.helper.make_graph(nodes, "graph", [x], [answer], [weight])
        opset = onnx.helper.make_opsetid("", 18)
        return onnx.helper.make_model(graph, opset_imports=[opset], ir_version=8)

    monkeypatch.setattr(int8, "trunk", lambda model: list(errors))
    feeds = [{"x": np.array([0, 0.95, 2.5, 3], np.float32)}]
    ranked = int8.rank_convolutions(sum_of(errors), sum_of, ["c", "a", "b"], feeds, head)
    assert ranked == (["b", "a", "c"] if head == "depth" else ["a", "b", "c"])


def test_convolutions_on_fine_grids_are_left_in_float_before_any_is_ranked(monkeypatch, tmp_path):
    """Then those that the head that misses most depends on, half as many again each time."""
    convolutions = [f"c{index}" for index in range(20)]
    nodes = [
        onnx.helper.make_node("Conv", [above, "point" if name == "c3" else "dense"], [name], name)
        for above, name in pairwise(["x", *convolutions])
    ]
    shapes = {"dense": (16, 16, 3, 3), "point": (16, 16, 1, 1)}
    weights = [onnx.numpy_helper.from_array(np.zeros(dims), name) for name, dims in shapes.items()]
    model = onnx.helper.make_model(onnx.helper.make_graph(nodes, "graph", [], [], weights))
    tried, ranked = [], []

    def try_in_float(model, ranges, *, keep_float):
        tried.append(list(keep_float))
        return model

    def missed(before, after, options, widths=None):
        if len(tried) > 5:
            return {}
        return {"depth" if len(tried) > 4 else "boundary": "loses too much"}

    def rank(model, quantized, names, feeds, head):
        ranked.append(head)
        return list(reversed(names)) if head == "boundary" else ["c1", "c9", *names]

    for name, value in {
        "trunk": lambda model: convolutions,
        "measure_ranges": lambda model, feeds: Ranges(None, frozenset({"c5"})),
        "measure_accuracy": lambda *arguments: [],
        "quantize": try_in_float,
        "calibration_feeds": lambda path, options: [{}],
        "strides": lambda model, feed: {"x": 1, "c0": 2, **dict.fromkeys(convolutions[1:], 4)},
        "measure_widths": lambda *arguments: {},
        "find_missed": missed,
        "rank_convolutions": rank,
    }.items():
        monkeypatch.setattr(int8, name, value)
    found = int8.quantize_within(
        model,
        ExportOptions(checkpoint_path=Path("m.pt"), onnx_path=Path("m.onnx")),
        classes=[],
        write=lambda model, path: None,
    )
    # c0 and c1 are on a finer grid, c3 is not dense; c5 writes and c6 reads what is uneven.
    always = ["c0", "c1", "c3", "c5", "c6"]
    assert tried[:2] == [always, [*always, "c19"]]
    assert tried[4] == [*tried[1], "c18", "c17", "c16"]
    assert tried[5] == [*tried[4], "c9", "c2"]
    assert ranked == ["boundary", "depth"]
    assert found.facts["float_convolutions"] == tried[5]


@pytest.mark.usefixtures("traced")
def test_a_file_in_single_precision_states_its_accuracy(lite_checkpoint, data, tmp_path, exported):
    """A LiDAR that is the depth to score is not fed: an own car has no other depth."""
    path = tmp_path / "lite.onnx"
    words = [str(lite_checkpoint), str(path), "--height", "64", "--width", "96"]
    own = "depth=depth,sparse_depth=depth"
    result = CliRunner().invoke(app, [*words, "--validate", f"folders:{data},{own}"])
    assert result.exit_code == 0, result.output
    contract = load_model_file(path).contract
    assert contract.precision == "fp32"
    repeat = contract.accuracy["repeat"]
    assert repeat == f"ssdnet-eval MODEL --data folders:street,{own} --lidar none"
    assert contract.quantization is None
    (row,) = contract.accuracy["rows"]
    errors = []
    with Predictor(path) as predictor:
        for index in range(3):
            rgb = cv2.imread(str(data / "images" / f"{index}.png"))[..., ::-1]
            truth = cv2.imread(str(data / "depth" / f"{index}.png"), cv2.IMREAD_UNCHANGED) / 256
            answer = predictor.predict(np.ascontiguousarray(rgb), None).depth
            errors.append(np.abs(answer - truth)[truth > 0])
    assert row["mae_m"] == pytest.approx(np.concatenate(errors).mean(), rel=1e-3)
    assert row["miou"] is None
    assert f"none, 3 frames: MAE {1000 * row['mae_m']:.4g} mm" in result.output
    assert load_model_file(exported.path).contract.accuracy is None


@pytest.mark.usefixtures("few")
def test_sets_without_any_truth_are_refused_and_nothing_is_written(export_int8, tmp_path):
    result = export_int8(target="labels=none")
    assert result.exit_code == 1
    assert "neither labels of the model's classes nor depth" in result.output
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("given", "stored"),
    [
        ("folders:mine/val,depth=d,rgb=a=b", "folders:mine/val,depth=d,rgb=a=b"),
        ("folders:/home/me/mine/val,depth=d", "folders:val,depth=d"),
    ],
)
def test_a_file_names_the_sets_as_given_but_no_folder_of_the_machine(given, stored):
    assert without_folders(given) == stored


def test_int8_needs_data(lite_checkpoint, tmp_path):
    with pytest.raises(InputError, match="int8 needs data"):
        export_checkpoint(lite_checkpoint, tmp_path / "a.onnx", precision=Precision.INT8)
    with pytest.raises(InputError, match="`calibrate=` is for int8"):
        export_checkpoint(lite_checkpoint, tmp_path / "a.onnx", calibrate=["folders:x"])
    assert not (tmp_path / "a.onnx").exists()
    words = [str(lite_checkpoint), str(tmp_path / "a.onnx")]
    for given, missing in (("--precision int8", "calibrate"), ("--calibrate x", "precision")):
        result = CliRunner().invoke(app, [*words, *given.split(), "--validate", "folders:x"])
        assert result.exit_code == 2
        assert missing in result.output
    words += ["--precision", "int8", "--calibrate", "folders:x"]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 2
    assert "--validate" in result.output
