"""The trunk in half precision and in 8-bit integers."""

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper
from typer.testing import CliRunner

from export.errors import ExportError
from export.exporter import export_checkpoint
from export.half import to_half
from export.precision import Precision
from export.probe_frames import probe_frames, recorded_frames
from export.quantize import measure_ranges, quantize, strides
from export.trunk import trunk
from runtime.app.tools.verify import app as verify_app
from runtime.contract.agreement import compare
from runtime.engine.session import open_session
from training.weights.initial_weights import find_weights

SIZE = (64, 96)


def run(model, feeds):
    """The answers to each feed, by the names of the outputs."""
    session = open_session(model.SerializeToString(), threads=1)
    names = [output.name for output in session.get_outputs()]
    return [dict(zip(names, session.run(names, feed), strict=True)) for feed in feeds]


@pytest.fixture(scope="module")
def feeds():
    frames = probe_frames(SIZE, max_depth_m=100.0)
    return [{"rgb": f.rgb[None], "sparse_depth": f.sparse_depth[None]} for f in frames[1:3]]


@pytest.fixture(scope="module")
def expected(lite_model, feeds):
    return run(lite_model, feeds)


@pytest.fixture(scope="module")
def ranges(lite_model, feeds):
    return measure_ranges(lite_model, feeds)


def test_the_trunk_is_what_lies_between_the_sensors_and_the_answers(lite_model):
    graph = lite_model.graph
    names = set(trunk(lite_model))
    inside = [node for node in graph.node if node.name in names]
    widths = {weight.name: weight.dims for weight in graph.initializer}
    convolutions = [node for node in graph.node if node.op_type == "Conv"]

    def is_wide(node):
        """Return whether a convolution has 16 channels or more: not the first, nor the last."""
        groups = next((item.i for item in node.attribute if item.name == "group"), 1)
        written, read = widths[node.input[1]][:2]
        return min(written, groups * read) >= 16

    wide = {node.name for node in convolutions if is_wide(node)}
    heads = {node.name for node in convolutions if widths[node.input[1]][0] < 16}
    assert wide
    assert heads
    assert not heads & names
    assert {node.name for node in inside if node.op_type == "Conv"} == wide
    assert {node.op_type for node in inside} == {"Conv", "Relu", "Clip", "Add", "Mul", "Resize"}
    read = {name for node in inside for name in node.input}
    for node in inside:
        assert node.op_type in ("Conv", "Relu") or node.output[0] in read
    assert not {output.name for output in graph.output} & {node.output[0] for node in inside}


def test_half_precision_keeps_inputs_outputs_and_answers(lite_model, feeds, expected):
    half = to_half(lite_model)
    onnx.checker.check_model(half, full_check=True)
    assert list(half.graph.input) == list(lite_model.graph.input)
    assert list(half.graph.output) == list(lite_model.graph.output)
    assert half.ir_version == lite_model.ir_version
    assert half.ByteSize() < 0.7 * lite_model.ByteSize()
    kinds = {weight.name: weight.data_type for weight in half.graph.initializer}
    inside = set(trunk(lite_model))
    for node in half.graph.node:
        if node.op_type == "Conv":
            kind = TensorProto.FLOAT16 if node.name in inside else TensorProto.FLOAT
            assert kinds[node.input[1]] == kind
    for found, right in zip(run(half, feeds), expected, strict=True):
        assert compare("semantic", found["semantic"], right["semantic"])["agreement"] > 0.99
        assert compare("depth", found["depth"], right["depth"])["mean_abs_m"] < 0.1
        assert not np.array_equal(found["depth"], right["depth"])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ssdnet-nano", "ssdnet-lite"])
def test_the_bundled_weights_pass_in_half_precision(name, tmp_path):
    """Their choice between two surfaces differs in single pixels, by more than half a metre."""
    path = tmp_path / "half.onnx"
    report = export_checkpoint(
        find_weights(name),
        path,
        size=(96, 160),
        precision=Precision.FP16,
        record_dir=tmp_path / "r",
    )
    assert report.contract.precision == "fp16"
    assert report.parity["depth"].figures["share_beyond"] < 0.01
    with pytest.warns(RuntimeWarning, match="fp32 gives the same answers faster"):
        verified = CliRunner().invoke(verify_app, [str(tmp_path / "r")])
    assert verified.exit_code == 0, verified.output


@pytest.mark.usefixtures("traced")
def test_half_precision_that_answers_otherwise_is_refused(lite_checkpoint, tmp_path, monkeypatch):
    def coarse(model):
        half = to_half(model)
        for weight in half.graph.initializer:
            if weight.data_type == TensorProto.FLOAT16:
                values = numpy_helper.to_array(weight) * np.float16(1.05)
                weight.CopyFrom(numpy_helper.from_array(values, weight.name))
        return half

    monkeypatch.setattr("export.exporter.to_half", coarse)
    monkeypatch.setattr("export.exporter.recorded_frames", lambda size: recorded_frames(size)[:1])
    with pytest.raises(ExportError, match="leave out --precision fp16"):
        export_checkpoint(
            lite_checkpoint, tmp_path / "half.onnx", size=SIZE, precision=Precision.FP16
        )
    assert list(tmp_path.iterdir()) == []


def test_quantised_answers_are_close_to_the_float_ones(lite_model, feeds, expected, ranges):
    quantized = quantize(lite_model, ranges)
    onnx.checker.check_model(quantized, full_check=True)
    assert quantized.ir_version == lite_model.ir_version
    # A Clip in float between two 8-bit convolutions would cost more than they gain.
    names = set(trunk(lite_model))
    clips = {n.name for n in lite_model.graph.node if n.op_type == "Clip"} & names
    assert clips
    assert not clips & {n.name for n in quantized.graph.node if n.op_type == "Clip"}
    for found, right in zip(run(quantized, feeds), expected, strict=True):
        assert compare("semantic", found["semantic"], right["semantic"])["agreement"] > 0.9
        assert compare("depth", found["depth"], right["depth"])["mean_abs_m"] < 1.0


def test_what_is_large_on_few_frames_is_uneven():
    """The range of all frames decides the scale, so one frame must not take it from the others."""
    values = [1.0, 2.0, 3.0, 40.0]
    weights = numpy_helper.from_array(np.eye(16, dtype=np.float32)[:, :, None, None], "w")
    nodes = [onnx.helper.make_node("Conv", ["x", "w"], ["y"], "conv")]
    shape = [1, 16, 1, 1]
    inputs, outputs = (
        [onnx.helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)] for name in "xy"
    )
    graph = onnx.helper.make_graph(nodes, "graph", inputs, outputs, [weights])
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 17)])
    model.ir_version = 8
    feeds = [{"x": np.full(shape, value, np.float32)} for value in values]
    for count, uneven in ((3, set()), (4, {"x", "y"})):
        ranges = measure_ranges(model, feeds[:count])
        assert ranges.uneven & {"x", "y"} == uneven
        assert [float(edge) for edge in ranges.data["y"].range_value] == [1.0, values[count - 1]]


def test_convolutions_named_stay_in_float(lite_model, ranges):
    names = set(trunk(lite_model))
    kept, *_ = [n.name for n in lite_model.graph.node if n.name in names and n.op_type == "Conv"]
    quantized = quantize(lite_model, ranges, keep_float=[kept])
    weights = {weight.name for weight in quantized.graph.initializer}
    in_float = {
        n.name for n in quantized.graph.node if n.op_type == "Conv" and n.input[1] in weights
    }
    assert kept in in_float
    assert {name for name in in_float if name in names} == {kept}


def test_the_stride_of_a_grid_that_is_resized_to_another_grid():
    """As in the paper's networks, whose decoders take the size of a grid of the encoder."""
    nodes = [
        helper.make_node("Conv", ["rgb", "kernel"], ["half"], strides=[2, 2]),
        helper.make_node("Conv", ["half", "kernel"], ["quarter"], strides=[2, 2]),
        helper.make_node("Shape", ["half"], ["size"]),
        helper.make_node("Resize", ["quarter", "", "", "size"], ["large"]),
        helper.make_node("Conv", ["large", "kernel"], ["found"]),
    ]
    rgb = helper.make_tensor_value_info("rgb", TensorProto.FLOAT, [1, 1, "height", "width"])
    kernel = numpy_helper.from_array(np.ones((1, 1, 1, 1), np.float32), "kernel")
    graph = helper.make_graph(nodes, "graph", [rgb], [helper.make_empty_tensor_value_info("found")])
    graph.initializer.append(kernel)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    found = strides(model, {"rgb": np.zeros((1, 1, 33, 33), np.float32)})
    assert found == {"rgb": 1, "half": 2, "quarter": 4, "large": 2, "found": 2}


def test_8_bit_products_do_not_saturate_in_16_bits():
    """If the weights were larger, processors with AVX2 alone would answer half of the sum."""
    channels = 64
    weights = numpy_helper.from_array(np.ones((16, channels, 3, 3), np.float32), "weights")
    axes = ["batch", channels, "height", "width"]
    model = helper.make_model(
        helper.make_graph(
            [helper.make_node("Conv", ["x", "weights"], ["y"], "convolution")],
            "graph",
            [helper.make_tensor_value_info("x", TensorProto.FLOAT, axes)],
            [helper.make_tensor_value_info("y", TensorProto.FLOAT, ["batch", 16, "h", "w"])],
            [weights],
        ),
        opset_imports=[helper.make_opsetid("", 18)],
        ir_version=10,
    )
    feeds = [{"x": np.ones((1, channels, 16, 16), np.float32)}]
    quantized = quantize(model, measure_ranges(model, feeds))
    (found,), (right,) = run(quantized, feeds), run(model, feeds)
    np.testing.assert_allclose(found["y"], right["y"], rtol=0.01)
    for weight in quantized.graph.initializer:
        if weight.data_type == TensorProto.INT8:
            assert np.abs(numpy_helper.to_array(weight).astype(int)).max() <= 64
