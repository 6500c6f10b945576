"""Model files that are missing, damaged, foreign or too new: each a ContractError that says so."""

import dataclasses
import json

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

import runtime.predictor
from runtime import ContractError, Predictor


def test_a_missing_file(tmp_path):
    with pytest.raises(ContractError, match=r"cannot read the model .*none\.onnx"):
        Predictor(tmp_path / "none.onnx")


def test_a_folder(tmp_path):
    with pytest.raises(ContractError, match="cannot read the model"):
        Predictor(tmp_path)


def test_a_missing_bundled_model(monkeypatch):
    monkeypatch.setattr(runtime.predictor, "BUNDLED_MODEL", "not-there.onnx")
    with pytest.raises(ContractError, match=r"bundled model .*not-there\.onnx.* is missing"):
        Predictor()


def test_an_empty_file(tmp_path):
    path = tmp_path / "empty.onnx"
    path.touch()
    with pytest.raises(ContractError, match="empty file"):
        Predictor(path)


def test_a_truncated_file_at_every_length(model_file):
    path = model_file()
    whole = path.read_bytes()
    for length in range(1, len(whole), 7):
        path.write_bytes(whole[:length])
        with pytest.raises(ContractError):
            Predictor(path)


@pytest.mark.parametrize("content", [b"\x89PNG\r\n", b"hello", b"\0" * 100, b"{}"])
def test_a_file_of_another_kind(tmp_path, content):
    path = tmp_path / "other.onnx"
    path.write_bytes(content)
    with pytest.raises(ContractError, match=r"cannot be loaded .* not ONNX"):
        Predictor(path)


def test_a_truncated_model_is_called_so(model_file):
    path = model_file()
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(ContractError, match="truncated or damaged; get it again"):
        Predictor(path)


def test_a_model_without_metadata(model_file):
    with pytest.raises(ContractError, match="no metadata 'ssdnet'"):
        Predictor(model_file(contract=None))


def test_a_model_with_damaged_metadata(model_file):
    with pytest.raises(ContractError, match="not JSON"):
        Predictor(model_file(contract=None, metadata="{"))


def test_a_model_of_a_future_version(model_file, contract):
    future = json.loads(contract.to_json()) | {"schema_version": "2.0"}
    with pytest.raises(ContractError, match=r"schema version '2\.0'"):
        Predictor(model_file(contract=None, metadata=json.dumps(future)))


def test_a_graph_of_a_future_opset(model_file):
    with pytest.raises(ContractError, match="newer version"):
        Predictor(model_file(opset=999))


def test_a_model_of_the_wrong_input_type(model_file):
    with pytest.raises(ContractError, match=r"rgb to be tensor\(uint8\).*tensor\(float\)"):
        Predictor(model_file(rgb_type=TensorProto.FLOAT))


def test_a_semantic_head_without_classes(model_file, contract):
    path = model_file(contract=dataclasses.replace(contract, classes=()))
    with pytest.raises(ContractError, match="names no classes"):
        Predictor(path)


def edited(path, edit):
    model = onnx.load(path)
    edit(model.graph)
    onnx.save(model, path)
    return path


def test_inputs_of_other_names(model_file):
    def rename(graph):
        graph.input[0].name = "image"
        graph.node[0].input[0] = "image"

    with pytest.raises(ContractError, match=r"expected inputs .*found .*image"):
        Predictor(edited(model_file(), rename))


def test_outputs_of_other_names_only(model_file):
    def rename(graph):
        graph.output[0].name = "red"

    with pytest.raises(ContractError, match="at least one output"):
        Predictor(edited(model_file(heads=("depth",)), rename))


def test_channels_first(model_file):
    def reshape(graph):
        shape = graph.input[0].type.tensor_type.shape
        shape.dim[1].dim_value, shape.dim[3].dim_value = 3, 64

    with pytest.raises(ContractError, match=r"rgb of shape \(N, H, W, 3\)"):
        Predictor(edited(model_file(size=(48, 64)), reshape))


def test_a_batch_of_more_than_one(model_file):
    def batch(graph):
        for tensor in [*graph.input, *graph.output]:
            tensor.type.tensor_type.shape.dim[0].dim_value = 4

    with pytest.raises(ContractError, match=r"one frame at a time.*batch of 4"):
        Predictor(edited(model_file(), batch))


def test_inputs_of_two_sizes(model_file):
    def widen(graph):
        graph.input[1].type.tensor_type.shape.dim[2].dim_value = 128

    with pytest.raises(ContractError, match="one size"):
        Predictor(edited(model_file(size=(48, 64), heads=("semantic",)), widen))


def test_a_half_fixed_size(model_file):
    def free_width(graph):
        for tensor in [*graph.input, *graph.output]:
            tensor.type.tensor_type.shape.dim[2].dim_param = "W"

    with pytest.raises(ContractError, match="both fixed or both free"):
        Predictor(edited(model_file(size=(48, 64)), free_width))


def test_an_unknown_further_output_does_no_harm(model_file, make_frame):
    def confidence(graph):
        graph.output.append(helper.make_tensor_value_info("half", TensorProto.FLOAT, []))

    path = edited(model_file(), confidence)
    assert Predictor(path).predict(*make_frame()).valid


@pytest.mark.parametrize("smallest", [0, 1024])
def test_weights_outside_the_file_are_refused_even_if_they_are_there(
    model_file, tmp_path, monkeypatch, smallest
):
    path = model_file()
    model = onnx.load(path)
    model.graph.initializer.append(numpy_helper.from_array(np.ones(1000, np.float32), "weights"))
    model.graph.node.append(helper.make_node("ReduceSum", ["weights"], ["sum"]))
    weights = "weights.bin"
    onnx.save(model, path, save_as_external_data=True, location=weights, size_threshold=smallest)
    assert (tmp_path / weights).exists()
    monkeypatch.chdir(tmp_path)  # where ONNX Runtime would look for them
    with pytest.raises(ContractError, match=r"outside its own file.*one file"):
        Predictor(path)
