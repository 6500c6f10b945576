"""Model files that are missing, damaged, foreign or too new: each a ContractError that says so."""

import dataclasses
import hashlib
import json
import os

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from runtime import ContractError, InputError, Predictor
from runtime.model_file import load_model_file, with_contract


def test_a_missing_file(tmp_path):
    with pytest.raises(ContractError, match=r"cannot read the model .*none\.onnx"):
        Predictor(tmp_path / "none.onnx")


def test_a_folder(tmp_path):
    with pytest.raises(ContractError, match="cannot read the model"):
        Predictor(tmp_path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_a_device_and_a_pipe(tmp_path):
    os.mkfifo(tmp_path / "pipe.onnx")
    for path in ("/dev/zero", tmp_path / "pipe.onnx"):
        with pytest.raises(ContractError, match="not a regular file"):
            Predictor(path)


def test_a_file_larger_than_onnx_can_hold(tmp_path):
    path = tmp_path / "sparse.onnx"
    with path.open("wb") as stream:
        stream.truncate(100 * 2**30)
    sizes = "107,374,182,400 bytes, expected at most 2,147,483,647"
    with pytest.raises(ContractError, match=sizes):
        Predictor(path)


def test_a_pinned_file(model_file):
    path = model_file()
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    assert Predictor(path, sha256=digest.upper(), warmup=0).digest == digest
    other = "0" * 64
    with pytest.raises(ContractError, match=f"{digest}.* {other}"):
        Predictor(path, sha256=other)
    path.write_bytes(path.read_bytes()[:-1])  # another file is refused, whatever it is
    with pytest.raises(ContractError, match=f"SHA-256 .* {digest}"):
        Predictor(path, sha256=digest)


@pytest.mark.parametrize("digest", ["", "abc", "g" * 64, "0" * 63, "0" * 64 + "\n", 0, b"0" * 64])
def test_a_pin_that_is_no_digest(model_file, digest):
    with pytest.raises(InputError, match="64 hexadecimal digits"):
        Predictor(model_file(), sha256=digest)


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
    with pytest.raises(ContractError, match=r"cannot be loaded: .* not ONNX"):
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
    with pytest.raises(ContractError, match="newer ONNX version"):
        Predictor(model_file(opset=999))


def test_a_model_of_the_wrong_input_type(model_file):
    with pytest.raises(ContractError, match=r"rgb to be tensor\(uint8\).*tensor\(float\)"):
        Predictor(model_file(rgb_type=TensorProto.FLOAT))


def test_a_semantic_head_without_classes(model_file, contract):
    path = model_file(contract=dataclasses.replace(contract, classes=()))
    with pytest.raises(ContractError, match="names of the classes"):
        Predictor(path)


def test_logits_of_another_number_of_classes(model_file, contract):
    three = (*contract.classes, dataclasses.replace(contract.classes[0], name="third"))
    path = model_file(
        contract=dataclasses.replace(contract, classes=three), heads=("semantic_logits",)
    )
    with pytest.raises(ContractError, match="of the 3 classes in the metadata, found 2"):
        Predictor(path)


@pytest.mark.parametrize("size", [(48, 20_000), (16, 64), (16_384, 16_384)])
def test_a_fixed_size_that_no_picture_has(model_file, size):
    with pytest.raises(ContractError, match="the size of images"):
        Predictor(model_file(size=size))


def test_inputs_of_other_names(model_file):
    def rename(graph):
        graph.input[0].name = "image"
        graph.node[0].input[0] = "image"

    with pytest.raises(ContractError, match=r"expected inputs .*found .*image"):
        Predictor(model_file(edit=rename))


def test_outputs_of_other_names_only(model_file):
    def rename(graph):
        graph.output[0].name = "red"

    with pytest.raises(ContractError, match="at least one output"):
        Predictor(model_file(edit=rename, heads=("depth",)))


def test_channels_first(model_file):
    def reshape(graph):
        shape = graph.input[0].type.tensor_type.shape
        shape.dim[1].dim_value, shape.dim[3].dim_value = 3, 64

    with pytest.raises(ContractError, match=r"rgb of shape \(N, H, W, 3\)"):
        Predictor(model_file(edit=reshape, size=(48, 64)))


@pytest.mark.parametrize("frames", [0, 4])
def test_a_batch_of_none_or_several(model_file, frames):
    def batch(graph):
        for tensor in [*graph.input, *graph.output]:
            tensor.type.tensor_type.shape.dim[0].dim_value = frames

    with pytest.raises(ContractError, match=f"one frame at a time.*batch of {frames}"):
        Predictor(model_file(edit=batch))


def test_inputs_of_two_sizes(model_file):
    def widen(graph):
        graph.input[1].type.tensor_type.shape.dim[2].dim_value = 128

    with pytest.raises(ContractError, match="one size"):
        Predictor(model_file(edit=widen, size=(48, 64), heads=("semantic",)))


def test_a_half_fixed_size(model_file):
    def free_width(graph):
        for tensor in [*graph.input, *graph.output]:
            tensor.type.tensor_type.shape.dim[2].dim_param = "W"

    with pytest.raises(ContractError, match="both fixed or both free"):
        Predictor(model_file(edit=free_width, size=(48, 64)))


def test_an_unknown_further_output_does_no_harm(model_file, make_frame):
    def confidence(graph):
        graph.output.append(helper.make_tensor_value_info("half", TensorProto.FLOAT, []))

    path = model_file(edit=confidence)
    assert Predictor(path).predict(*make_frame()).valid


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


@pytest.mark.parametrize("weight", [np.nan, np.inf])
def test_a_constant_that_is_not_finite_is_found_by_the_answer(model_file, weight):
    def edit(graph: onnx.GraphProto) -> None:
        (last,) = (node for node in graph.node if "depth" in node.output)
        last.output[0] = "metres"
        graph.initializer.append(numpy_helper.from_array(np.float32([weight]), "weight"))
        graph.node.append(helper.make_node("Add", ["metres", "weight"], ["depth"]))

    path = model_file(edit=edit)
    assert load_model_file(path).sha256, "the graph is left to ONNX Runtime"
    with pytest.raises(ContractError, match="empty frame is not finite"):
        Predictor(path)


def test_functions_are_left_to_onnx_runtime(model_file, contract, make_frame):
    path = model_file(contract=None)
    model = onnx.load(path)
    (add,) = (node for node in model.graph.node if "depth" in node.output)
    body = helper.make_node("Add", ["a", "b"], ["sum"])
    opset = helper.make_opsetid("", 20)
    model.functions.append(helper.make_function("own", "Own", ["a", "b"], ["sum"], [body], [opset]))
    model.opset_import.append(helper.make_opsetid("own", 1))
    add.domain, add.op_type = "own", "Own"
    path.write_bytes(with_contract(model.SerializeToString(), contract))
    with Predictor(path) as predictor:
        assert predictor.predict(*make_frame()).valid


@pytest.mark.parametrize("warmup", [0, 1])
def test_a_model_whose_answer_to_an_empty_frame_is_not_finite_is_refused(model_file, warmup):
    """0 / 0 is found by the answer."""

    def edit(graph: onnx.GraphProto) -> None:
        (last,) = (node for node in graph.node if "depth" in node.output)
        last.output[0] = "metres"
        graph.node.extend(
            [
                helper.make_node("Sub", ["metres", "metres"], ["zero"]),
                helper.make_node("Div", ["zero", "zero"], ["nan"]),
                helper.make_node("Add", ["metres", "nan"], ["depth"]),
            ]
        )

    with pytest.raises(ContractError, match="empty frame is not finite"):
        Predictor(model_file(edit=edit), warmup=warmup)
