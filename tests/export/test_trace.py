"""What the traced file looks like and what the bare graph answers."""

from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from onnx import TensorProto, helper
from torch import nn

from export.deploy import DeployGraph
from export.errors import ExportError
from export.parity import reference
from export.probe_frames import probe_frames
from export.trace import check_standard, trace
from models import NetworkOutput
from models.blocks import pad_to_multiple, upsample_nearest
from runtime.engine.session import open_session

HEIGHT, WIDTH = 64, 96  # a multiple of the small network's stride, which is 8


def open_model(model):
    return open_session(model.SerializeToString(), threads=1)


def run(session, frames):
    feed = {
        "rgb": np.stack([frame.rgb for frame in frames]),
        "sparse_depth": np.stack([frame.sparse_depth for frame in frames]),
    }
    names = [tensor.name for tensor in session.get_outputs()]
    return dict(zip(names, session.run(names, feed), strict=True))


@pytest.fixture(scope="module")
def dynamic_session(dynamic_model):
    return open_model(dynamic_model)


def test_tensors_are_those_of_the_contract(dynamic_network, dynamic_session):
    free = ["batch", "height", "width"]
    inputs = {t.name: (t.type, t.shape) for t in dynamic_session.get_inputs()}
    assert inputs == {
        "rgb": ("tensor(uint8)", [*free, 3]),
        "sparse_depth": ("tensor(float)", free),
    }
    outputs = {t.name: (t.type, t.shape) for t in dynamic_session.get_outputs()}
    assert outputs == {
        "semantic": ("tensor(uint8)", free),
        **{head: ("tensor(float)", free) for head in dynamic_network.heads if head != "semantic"},
        "semantic_logits": ("tensor(float)", ["batch", 11, "height", "width"]),
    }


def test_the_ir_version_is_the_lowest_of_the_operator_set(dynamic_model):
    assert dynamic_model.ir_version == 8


def test_nothing_of_the_exporting_machine_is_in_the_file(dynamic_model):
    content = dynamic_model.SerializeToString()
    assert b".py" not in content
    assert b"stack_trace" not in content


def test_the_encoder_is_convolutions_clips_and_sums(lite_model):
    """Strided convolutions pad by themselves: no Pad stands between, only a first normalisation."""
    nodes = lite_model.graph.node
    made_by = {name: node.op_type for node in nodes for name in node.output}
    encoder = [n for n in nodes if n.op_type == "Conv" and ".encoder." in n.input[1]]
    read = Counter(made_by[node.input[0]] for node in encoder)
    assert read == {"Clip": 32, "Add": 9, "Conv": 6, "BatchNormalization": 1}


@pytest.mark.parametrize("size", [(HEIGHT, WIDTH), (125, 63), (33, 414), (32, 32), (97, 128)])
def test_dynamic_graph_answers_at_every_size(dynamic_network, dynamic_session, size):
    for frame in probe_frames(size, max_depth_m=100.0)[
        1::3
    ]:  # with returns of a LiDAR, with faults
        answers = run(dynamic_session, [frame])
        expected = reference(dynamic_network, frame)
        assert answers["semantic"].shape == (1, *size)
        assert (answers["semantic"][0] == expected["semantic"]).mean() > 0.999
        np.testing.assert_allclose(answers["depth"][0], expected["depth"], atol=2e-3)
        assert (np.abs(answers["boundary"][0] - expected["boundary"]) < 1e-4).mean() > 0.995
        np.testing.assert_allclose(
            answers["semantic_logits"][0], expected["semantic_logits"], atol=1e-3, rtol=1e-3
        )


def test_two_frames_at_once_answer_as_one_by_one(dynamic_session):
    frames = probe_frames((45, 77), max_depth_m=100.0)[:2]
    together = run(dynamic_session, frames)
    for index, frame in enumerate(frames):
        for head, answer in run(dynamic_session, [frame]).items():
            np.testing.assert_allclose(together[head][index], answer[0], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(
    ("values", "read_as"), [((np.nan, np.inf, -np.inf, -1.0, 250.5), 0.0), ((249.5,), 200.0)]
)
def test_faults_are_no_measurement_and_far_returns_are_clipped(dynamic_session, values, read_as):
    """The graph does so itself, without the engine."""
    rng = np.random.default_rng(0)
    frame = probe_frames((64, 96), max_depth_m=100.0)[1]
    spoiled, clean = frame.sparse_depth.copy(), frame.sparse_depth.copy()
    hit = rng.random(spoiled.shape) < 0.3
    spoiled[hit] = rng.choice(np.array(values, np.float32), int(hit.sum()))
    clean[hit] = read_as
    answers = run(dynamic_session, [replace(frame, sparse_depth=spoiled)])
    expected = run(dynamic_session, [replace(frame, sparse_depth=clean)])
    for head, answer in answers.items():
        assert np.isfinite(answer).all()
        np.testing.assert_array_equal(answer, expected[head])


class Halved(nn.Module):
    """The colours of every second pixel as scores, padded to an even size."""

    config = SimpleNamespace(name="by-hand", max_depth_m=80.0)
    heads = ("semantic",)
    semantic_stride = 2

    def predict_coarse(self, rgb, sparse_depth):
        x = pad_to_multiple(rgb + 0 * sparse_depth, 2)
        return NetworkOutput(semantic_logits=x[:, :, ::2, ::2])

    def join_rows(self, scores):
        return scores


def count_pads_and_cuts(graph):
    heads = {head.name for head in graph.output}
    cuts = [n for n in graph.node if n.op_type == "Slice" and n.output[0] in heads]
    return sum(node.op_type == "Pad" for node in graph.node), len(cuts)


def test_a_fixed_size_that_fits_the_stride_needs_no_pad_and_no_cut(lite_model):
    assert count_pads_and_cuts(lite_model.graph) == (5, 0)  # of the surfaces, none of the image


def test_another_fixed_size_is_padded_and_cut():
    rows = HEIGHT - 1
    model = trace(DeployGraph(Halved(), with_logits=True), size=(rows, WIDTH))
    assert count_pads_and_cuts(model.graph) == (1, 2)
    frame = probe_frames((rows, WIDTH), max_depth_m=80.0)[0]
    logits = run(open_model(model), [frame])["semantic_logits"][0]
    rgb = torch.from_numpy(frame.rgb).permute(2, 0, 1)[None].float()
    answer = upsample_nearest(rgb[:, :, ::2, ::2], 2)[0, :, :rows]
    np.testing.assert_allclose(logits, answer, atol=1e-3)


def test_fixed_graph_takes_several_frames_of_its_size_only(lite_model):
    session = open_model(lite_model)
    assert session.get_inputs()[0].shape == ["batch", HEIGHT, WIDTH, 3]
    frames = probe_frames((HEIGHT, WIDTH), max_depth_m=100.0)[:3]
    assert run(session, frames)["semantic"].shape == (3, HEIGHT, WIDTH)
    with pytest.raises(Exception, match=r"(?i)dimension"):
        run(session, probe_frames((HEIGHT, WIDTH + 16), max_depth_m=100.0)[:1])


def test_unknown_opset_is_refused(lite):
    with pytest.raises(ExportError, match="opset must be 18 to"):
        trace(DeployGraph(lite), size=(HEIGHT, WIDTH), opset=9)


@pytest.mark.parametrize(
    ("op_type", "opsets", "text"),
    [
        ("FusedConv", {"": 18, "com.microsoft": 1}, "com.microsoft"),
        ("NoSuchOperator", {"": 18}, "not valid ONNX"),
        ("Relu", {"": 19}, "opset 18 was requested"),
    ],
)
def test_what_is_not_standard_is_refused(op_type, opsets, text):
    tensors = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1]) for name in "xy"]

    def check(op_type, opsets):
        nodes = [helper.make_node(op_type, ["x"], ["y"], domain=list(opsets)[-1])]
        graph = helper.make_graph(nodes, "tiny", tensors[:1], tensors[1:])
        imports = [helper.make_opsetid(*item) for item in opsets.items()]
        check_standard(helper.make_model(graph, opset_imports=imports), opset=18)

    check("Relu", {"": 18})
    with pytest.raises(ExportError, match=text):
        check(op_type, opsets)
