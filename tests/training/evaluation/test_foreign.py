"""Networks of others: scored through an adapter as they would be natively."""

import json
import re
import tomllib

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from layouts import virtual_kitti
from layouts.evaluation import run, score
from layouts.pictures import write
from models import CAMVID_CLASSES
from models.network import CLASS_STRIDE
from runtime.contract.model_file import load_model_file
from runtime.engine.bundled_models import find_model
from training.evaluation.adapter import NORMALIZATIONS, read_adapter

SIZE = 64, 128
NATIVE = "ssdnet-nano"
IMAGENET = NORMALIZATIONS["imagenet"]


def publish(path, *, inverse):
    """Write the bundled model as others publish theirs.

    A normalised image NCHW goes in, class scores on the network's own coarse grid and depth come
    out, and there is no metadata.
    """
    file = load_model_file(find_model(NATIVE))
    model = onnx.load_from_string(file.content)
    graph = model.graph
    del model.metadata_props[:], graph.input[:], graph.output[:]
    made_by = {name: node for node in graph.node for name in node.output}
    (decision,) = (node for node in graph.node if node.op_type == "ArgMax")
    scores = decision.input[0]
    while made_by[scores].op_type in ("Reshape", "Resize"):
        scores = made_by[scores].input[0]
    mean, std = (np.array(each, np.float32).reshape(1, 3, 1, 1) for each in IMAGENET)
    constants = {"mean_": mean, "std_": std, "channel_": np.array([1])}
    graph.initializer.extend(
        numpy_helper.from_array(each, name) for name, each in constants.items()
    )
    before = [
        helper.make_node("Mul", ["images", "std_"], ["centred_"]),
        helper.make_node("Add", ["centred_", "mean_"], ["colors_"]),
        helper.make_node("Round", ["colors_"], ["whole_"]),
        helper.make_node("Cast", ["whole_"], ["bytes_"], to=TensorProto.UINT8),
        helper.make_node("Transpose", ["bytes_"], ["rgb"], perm=[0, 2, 3, 1]),
        helper.make_node("Squeeze", ["lidar", "channel_"], ["sparse_depth"]),
    ]
    after = [
        helper.make_node("Identity", [scores], ["scores"]),
        helper.make_node("Reciprocal" if inverse else "Identity", ["depth"], ["distance"]),
    ]
    nodes = [*before, *graph.node, *after]
    del graph.node[:]
    graph.node.extend(nodes)
    for name, planes in (("images", 3), ("lidar", 1)):
        shape = [1, planes, "H", "W"]
        graph.input.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, shape))
    for name, shape in (("scores", [1, 11, "h", "w"]), ("distance", [1, "H", "W"])):
        graph.output.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, shape))
    onnx.save(model, path)
    return file.contract


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two labelled frames with depth, and the bundled model as two files of others."""
    root = tmp_path_factory.mktemp("foreign")
    variant = virtual_kitti.write_second_edition(root / "scenes", magnify=8)
    (variant / "intrinsic.txt").write_text("a b c d e f\n0 0 90 90 60 30\n1 0 90 90 60 30\n")
    for name in ("plain", "inverse"):
        publish(root / f"{name}.onnx", inverse=name == "inverse")
    return root


def adapter(folder, name, depth_is):
    contract = load_model_file(find_model(NATIVE)).contract
    lines = [
        'normalize = "imagenet"', 'sparse_depth = "lidar"', 'semantic = "scores"',
        f"classes = {[info.name for info in contract.classes]}", f"class_stride = {CLASS_STRIDE}",
        'depth = "distance"', f'depth_is = "{depth_is}"', f"max_depth_m = {contract.max_depth_m}",
        f"canonical_focal_px = {contract.canonical_focal_px}",
    ]  # fmt: skip
    (folder / f"{name}.toml").write_text("\n".join(lines))


def test_a_network_without_metadata_scores_as_natively(folder):
    """It answers metres or inverse depth, and class scores on a quarter of the image's grid."""
    adapter(folder, "plain", "depth")
    adapter(folder, "inverse", "inverse")
    data = f"rendered:{folder}/scenes,size={list(SIZE)}"
    models = (NATIVE, folder / "plain.onnx", folder / "inverse.onnx")
    rows, _ = score(*models, "--data", data, "--lidar", "64,none")
    for lidar in ("64", "none"):
        native, plain, inverse = (row["figures"] for row in rows if row["lidar"] == lidar)
        for key in ("miou", "accuracy", "mae_m", "rmse_m", "imae_per_km"):
            assert plain[key] == pytest.approx(native[key], rel=1e-5), key
            assert inverse[key] == pytest.approx(native[key], rel=1e-5), key
    adapter(folder, "inverse", "depth")  # a wrong adapter shows
    (wrong,), _ = score(folder / "inverse.onnx", "--data", data, "--lidar", "64")
    assert wrong["figures"]["mae_m"] > 2 * rows[0]["figures"]["mae_m"]


def test_a_missing_adapter_is_filled_in_from_the_file(folder, tmp_path):
    """Printed, or written where --adapter names it; nothing is scored by a guess."""
    data = ["--data", f"rendered:{folder}/scenes"]
    (tmp_path / "pub.onnx").write_bytes((folder / "plain.onnx").read_bytes())
    printed = run(tmp_path / "pub.onnx", *data)
    assert printed.exit_code == 1
    assert "pub.toml" in printed.output.splitlines()[-1]
    written = run(tmp_path / "pub.onnx", *data, "--adapter", tmp_path / "mine.toml")
    assert written.exit_code == 1
    text = (tmp_path / "mine.toml").read_text()
    assert text in printed.stdout
    assert tomllib.loads(text) == {
        "rgb": "images",
        "layout": "NCHW",
        "channels": "RGB",
        "normalize": "imagenet",
        "stride": 32,
        "sparse_depth": "lidar",
        "semantic": "scores",
        "classes": "camvid",  # eleven planes
        "depth": "distance",
        "depth_is": "depth",
        "depth_scale": 1.0,
    }
    assert read_adapter(tmp_path / "mine.toml").names == tuple(info.name for info in CAMVID_CLASSES)


def by_hand(path, *, shape, output, metadata=()):
    """A network that answers the red channel of its image, (1, 3, H, W) in 0..1, times 255."""
    image = helper.make_tensor_value_info("images", TensorProto.FLOAT, [1, 3, *shape])
    planes = helper.make_tensor_value_info("output0", output, [1, *shape])
    nodes = [
        helper.make_node("Gather", ["images", "first"], ["red"], axis=1),
        helper.make_node("Mul", ["red", "most"], ["scaled"]),
        helper.make_node("Round", ["scaled"], ["rounded"]),
        helper.make_node("Cast", ["rounded"], ["output0"], to=output),
    ]
    constants = [
        helper.make_tensor("first", TensorProto.INT64, [], [0]),
        helper.make_tensor("most", TensorProto.FLOAT, [], [255.0]),
    ]
    graph = helper.make_graph(nodes, "by_hand", [image], [planes], constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
    helper.set_model_props(model, dict(metadata))
    onnx.save(model, path)


def red(root):
    """A picture 32 x 64 whose red channel is the label: 1 in the left half, 2 in the right one."""
    ids = np.where(np.arange(64) < 32, np.ones((32, 64)), 2).astype(np.uint8)
    write(root / "images/a.png", np.stack([ids, 0 * ids, 9 + 0 * ids], axis=-1))
    write(root / "labels/a.png", ids)
    write(root / "depth/a.png", (ids.astype(np.uint16) * 256))
    return f'folders:{root},labels=labels,depth=depth,label_ids={{1="road",2="car"}}'


@pytest.mark.parametrize(("shape", "fit"), [((32, 64), "stretch"), ((96, 96), "pad")])
def test_ids_of_an_exporter_that_names_its_classes(tmp_path, shape, fit):
    """Float NCHW in, ids out: three lines, of which the file tells the classes for the printed."""
    data, path = red(tmp_path), tmp_path / "sem.onnx"
    facts = {"names": "{0: 'sky', 1: 'road', 2: 'car'}", "imgsz": "[32, 64]", "stride": "32"}
    by_hand(path, shape=shape, output=TensorProto.INT64, metadata=facts)
    text = run(path, "--data", data).stdout
    told = tomllib.loads("\n".join(re.findall(r"^[a-z]\w* = .*$", text, re.MULTILINE)))
    assert (told["semantic"], told["classes"]) == ("output0", ["sky", "road", "car"])
    assert (told["normalize"], told["fit"]) == ("0..1", "pad")
    lines = ['normalize = "0..1"', 'semantic = "output0"', 'classes = ["sky", "road", "car"]']
    path.with_suffix(".toml").write_text(
        "\n".join([*lines, f'fit = "{fit}"'][: 3 + (fit == "pad")])
    )
    (row,), _ = score(path, "--data", data, "--lidar", "none")
    assert row["figures"]["miou"] > (0.99 if fit == "stretch" else 0.9)


def test_numbers_are_no_names_of_classes(tmp_path):
    """An exporter writes the ids as names if its user gave none: their number tells the table."""
    path = tmp_path / "sem.onnx"
    names = str({number: str(number) for number in range(19)})
    by_hand(path, shape=(32, 64), output=TensorProto.INT64, metadata={"names": names})
    text = run(path, "--data", red(tmp_path)).stdout
    assert 'classes = "cityscapes"  # guessed by their number: check' in text


def test_depth_of_an_exporter_opens_with_three_lines(tmp_path):
    data, path = red(tmp_path), tmp_path / "depth.onnx"
    by_hand(path, shape=(32, 64), output=TensorProto.FLOAT)
    for scale, mae_m in ((1, 0), (2, 0.75)):
        lines = ['normalize = "0..1"', 'depth = "output0"', f"depth_scale = {scale}"]
        path.with_suffix(".toml").write_text("\n".join(lines))
        (row,), _ = score(path, "--data", data, "--lidar", "none")
        assert row["figures"]["mae_m"] == pytest.approx(mae_m)


@pytest.mark.parametrize(("lines", "text"), [
    ('semantic = "output0"', "classes: name them"), ('rgb = "images"', "semantic and depth"),
    ('depth = "output1"', "'output1'"),
    ('depth = "output0"\nrgb = "image"', "its inputs are images"),
    ('depth = "output0"\ncolour = 1', "unknown key colour"),
    ('semantic = "output0"\nclasses = ["road"]\nnormalize = "0..1"', "class id 2"),
    ("depth", "is not valid TOML"),
])  # fmt: skip
def test_adapters_that_do_not_fit_say_why(tmp_path, lines, text):
    data, path = red(tmp_path), tmp_path / "net.onnx"
    by_hand(path, shape=(32, 64), output=TensorProto.INT64)
    path.with_suffix(".toml").write_text(lines)
    result = run(path, "--data", data, "--lidar", "none")
    assert result.exit_code == 1
    assert text in result.output.splitlines()[-1]


FLOAT, BYTES = TensorProto.FLOAT, TensorProto.UINT8
ROAD = 'semantic = "y"\nclasses = ["a", "b", "c"]\n'


def others(path, *, fed=(1, 3, 32, 64), answer=(1, 3, 32, 64), kind=FLOAT, inputs=1, facts=()):
    """A network that answers values of -9 in a shape, whatever its inputs are."""
    fed = [helper.make_tensor_value_info(f"x{i}", kind, list(fed)) for i in range(inputs)]
    out = [helper.make_tensor_value_info("y", FLOAT, list(answer))]
    value = numpy_helper.from_array(np.full(answer, -9, np.float32), "c")
    graph = helper.make_graph([helper.make_node("Identity", ["c"], ["y"])], "g", fed, out, [value])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
    helper.set_model_props(model, dict(facts))
    onnx.save(model, path)


@pytest.mark.parametrize(("file", "lines", "text"), [
    ({"fed": (3, 4)}, None, "expected an image of four axes"),
    ({"inputs": 0}, None, "has 0 inputs (none)"),
    ({"inputs": 3}, None, "has 3 inputs ('x0': float"),
    ({"fed": (4, 3, 32, 64)}, ROAD, "export it with a batch of 1"),
    ({"fed": (1, 1, 32, 64)}, ROAD, "expected three channels"),
    ({"answer": (1, 1000)}, None, "is a map of the image ('y': float [1, 1000])"),
    ({"answer": (1, 32 * 64, 3)}, ROAD, "is no map of the image of 32 x 64"),  # flattened scores
    ({"answer": (1, 3, 64, 32)}, ROAD, "is no map of the image"),
    ({"answer": (1, 1, 32, 64)}, ROAD, "-9 to -9, which are no class ids"),
    ({"answer": (1, 1, 32, 64)}, 'semantic="y"\nclasses=["a"]\nsemantic_is="scores"', "one plane"),
    ({}, ROAD + "size = [64, 64]", "size = (64, 64) cannot be used"),
    ({}, ROAD + "stride = 32", "stride = 32 cannot be used"),
    ({}, ROAD + 'layout = "NHWC"', "layout = 'NHWC' cannot be used"),
    ({}, ROAD + "depth_scale = 100.0", "depth_scale: has no use without depth"),
    ({"kind": BYTES, "inputs": 2}, ROAD + 'sparse_depth = "x1"', "a map of LiDAR depth, of floats"),
])  # fmt: skip
def test_a_file_is_looked_at_before_it_is_run(tmp_path, file, lines, text):
    data, path = red(tmp_path), tmp_path / "net.onnx"
    others(path, **file)
    if lines is not None:
        path.with_suffix(".toml").write_text(lines)
    result = run(path, "--data", data, "--lidar", "none")
    assert result.exit_code == 1
    assert text in result.output.splitlines()[-1]


def test_no_normalisation_changes_bytes(tmp_path):
    """They are fed as they are, and it is said: floats cast to bytes would wrap around."""
    data, path = red(tmp_path), tmp_path / "net.onnx"
    others(path, kind=BYTES)
    path.with_suffix(".toml").write_text(ROAD + 'normalize = "imagenet"')
    _, output = score(path, "--data", data, "--lidar", "none")
    assert "takes bytes (uint8)" in output


def test_names_are_sorted_as_numbers(tmp_path):
    path, names = tmp_path / "net.onnx", [f"name{index}" for index in range(12)]
    for first, expected in ((0, names), (1, [])):  # ids that begin with 1 would be shifted
        table = json.dumps({str(first + index): name for index, name in enumerate(names)})
        others(path, answer=(1, 12, 32, 64), facts={"names": table, "stride": "[32]"})
        line = re.search("^classes = (.*?)(  #|$)", run(path, "--data", red(tmp_path)).stdout, re.M)
        assert json.loads(line[1]) == expected
