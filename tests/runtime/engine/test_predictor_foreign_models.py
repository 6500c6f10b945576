"""Model files that are missing, damaged, foreign or too new: each a ContractError that says so."""

import hashlib
import os

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from runtime import ContractError, Predictor
from runtime.contract.model_file import with_contract


@pytest.mark.parametrize("content", [None, b"", b"\x89PNG\r\n", b"\0" * 100])
def test_a_file_that_is_no_model(tmp_path, content):
    if content is not None:
        (tmp_path / "model.onnx").write_bytes(content)
    with pytest.raises(ContractError, match=r"model\.onnx|ONNX"):
        Predictor(tmp_path / "model.onnx")


def test_a_pinned_file(model_file):
    path = model_file()
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    assert Predictor(path, sha256=digest.upper(), warmup=0).model.sha256 == digest
    for other in ("0" * 64, 7):
        with pytest.raises(ContractError, match=f"{digest}.*{other}"):
            Predictor(path, sha256=other)
    path.write_bytes(path.read_bytes()[:-1])  # another file is refused, whatever it is
    with pytest.raises(ContractError, match=f"SHA-256 .*{digest}"):
        Predictor(path, sha256=digest)


def test_a_truncated_file_at_every_length(model_file):
    path = model_file()
    whole = path.read_bytes()
    for length in range(1, len(whole), 31):
        path.write_bytes(whole[:length])
        with pytest.raises(ContractError, match=r"truncated|damaged|cannot be loaded"):
            Predictor(path)


def rename_input(graph):
    graph.input[0].name = "image"
    graph.node[0].input[0] = "image"


def rename_output(graph):
    graph.output[0].name = "red"


def drop_a_side(graph):
    del graph.input[1].type.tensor_type.shape.dim[2]


@pytest.mark.parametrize(("options", "named"), [
    ({"contract": None}, "ssdnet"), ({"contract": None, "metadata": "{"}, "damaged"),
    ({"opset": 999}, "newer"), ({"edit": rename_input}, "found .*image"),
    ({"edit": rename_output, "heads": ("depth",)}, "found .*red"),
    ({"rgb_type": TensorProto.FLOAT}, "found .*float"), ({"edit": drop_a_side}, "found .*2"),
])  # fmt: skip
def test_a_foreign_model_is_refused_with_its_fault(model_file, options, named):
    with pytest.raises(ContractError, match=named):
        Predictor(model_file(**options))


def test_an_unknown_further_output_does_no_harm(model_file):
    half = helper.make_tensor_value_info("half", TensorProto.FLOAT, [])
    Predictor(model_file(edit=lambda graph: graph.output.append(half)))


@pytest.mark.parametrize("smallest", [0, 1024])
def test_weights_outside_the_file_are_refused_even_if_they_are_there(
    model_file, tmp_path, monkeypatch, contract, smallest
):
    path = model_file(contract=None)
    model = onnx.load(path)
    model.graph.initializer.append(numpy_helper.from_array(np.ones(1000, np.float32), "weights"))
    model.graph.node.append(helper.make_node("ReduceSum", ["weights"], ["sum"]))
    weights = "weights.bin"
    onnx.save(model, path, save_as_external_data=True, location=weights, size_threshold=smallest)
    path.write_bytes(with_contract(path.read_bytes(), contract))
    assert (tmp_path / weights).exists()
    monkeypatch.chdir(tmp_path)  # where ONNX Runtime would look for them
    with pytest.raises(ContractError, match=r"outside its own file.*one file") as caught:
        Predictor(path)
    assert os.devnull not in str(caught.value), "where nobody keeps weights"


@pytest.mark.parametrize("warmup", [0, 1])
def test_a_model_whose_answer_to_an_empty_frame_is_not_finite_is_refused(model_file, warmup):
    """0 / 0 is found by the answer."""

    def edit(graph: onnx.GraphProto) -> None:
        (last,) = (node for node in graph.node if "depth" in node.output)
        last.output[0] = "metres"
        graph.node.append(helper.make_node("Sub", ["metres", "metres"], ["zero"]))
        graph.node.append(helper.make_node("Div", ["zero", "zero"], ["nan"]))
        graph.node.append(helper.make_node("Add", ["metres", "nan"], ["depth"]))

    with pytest.raises(ContractError, match="empty frame is not finite"):
        Predictor(model_file(edit=edit), warmup=warmup)
