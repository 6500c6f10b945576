"""The bytes of a model file: what is written, and that no byte of it changes unnoticed."""

import dataclasses
import hashlib
import json
from pathlib import Path

import numpy as np
import onnx
import pytest
from google.protobuf.message import DecodeError
from onnx import helper
from onnxruntime import InferenceSession

from runtime import ContractError, Predictor
from runtime.contract.contract import METADATA_KEY
from runtime.contract.model_file import load_model_file, parse_model_file, with_contract


def test_the_layout_as_the_onnx_library_reads_it(model_file):
    whole = model_file().read_bytes()
    model = onnx.load_from_string(whole)
    (entry,) = model.metadata_props
    assert entry.key == METADATA_KEY
    content = json.loads(entry.value)["content"]
    assert content["sha256"] == hashlib.sha256(whole[: content["bytes"]]).hexdigest()
    tail = whole[content["bytes"] :]
    assert tail.endswith(entry.value.encode())
    del model.metadata_props[:]
    assert model == onnx.load_from_string(whole[: content["bytes"]])
    alone = onnx.ModelProto(metadata_props=[entry])
    assert tail == alone.SerializeToString()


def test_the_contract_is_the_one_that_onnx_runtime_hands_out(model_file):
    path = model_file()
    metadata = InferenceSession(path).get_modelmeta().custom_metadata_map
    with Predictor(path, warmup=0) as predictor:
        assert predictor.contract.to_json() == metadata[METADATA_KEY]


def test_the_check_in_the_documentation(model_file, tmp_path, monkeypatch):
    page = (Path(__file__).parents[3] / "docs/model_file.md").read_text()
    program = page.partition("```python")[2].partition("```")[0]
    whole = model_file().read_bytes()
    monkeypatch.chdir(tmp_path)
    exec(program, {})
    place = whole.index(b"by-hand")
    for damaged in (
        whole[:9] + b"?" + whole[10:],
        whole[:place] + b"?" + whole[place + 1 :],
        whole + b"\x08\x01",
    ):
        (tmp_path / "model.onnx").write_bytes(damaged)
        with pytest.raises((AssertionError, DecodeError)):
            exec(program, {})


def test_every_byte_counts(model_file):
    path = model_file()
    whole = path.read_bytes()
    random = np.random.default_rng(0)
    for place in range(len(whole)):
        damaged = bytearray(whole)
        damaged[place] ^= int(random.integers(1, 256))
        with pytest.raises(ContractError):
            parse_model_file(bytes(damaged))


def test_what_is_appended_is_refused(model_file, contract):
    whole = model_file().read_bytes()
    other = dataclasses.replace(contract, max_depth_m=20.0).to_json()
    for extra in (
        onnx.ModelProto(metadata_props=[{"key": METADATA_KEY, "value": other}]),
        onnx.ModelProto(metadata_props=[{"key": "author", "value": "somebody"}]),
        onnx.ModelProto(graph=onnx.GraphProto(name="other")),
        onnx.ModelProto(doc_string="a note"),
    ):
        with pytest.raises(ContractError, match="truncated or damaged"):
            parse_model_file(whole + extra.SerializeToString())


def test_metadata_of_others_may_stand_before_ours(model_file, contract):
    model = onnx.load(model_file(contract=None))
    helper.set_model_props(model, {"author": "somebody"})
    whole = with_contract(model.SerializeToString(), contract)
    assert parse_model_file(whole).contract.content.bytes == model.ByteSize()


def test_a_tensor_may_have_the_name_of_the_metadata(model_file, contract):
    model = onnx.load(model_file(contract=None))
    (last,) = (node for node in model.graph.node if "depth" in node.output)
    last.output[0] = METADATA_KEY
    model.graph.node.append(helper.make_node("Identity", [METADATA_KEY], ["depth"]))
    content = model.SerializeToString()
    assert b"\x0a\x06ssdnet\x12" in content
    assert parse_model_file(with_contract(content, contract)).contract.content.bytes == len(content)


@pytest.mark.parametrize("value", [b"\xff\xfe", b"{\xc3}", b"\0"])
def test_metadata_that_is_no_text(model_file, value):
    key = METADATA_KEY.encode()
    entry = bytes([0x0A, len(key)]) + key + bytes([0x12, len(value)]) + value
    whole = model_file(contract=None).read_bytes() + bytes([0x72, len(entry)]) + entry
    with pytest.raises(ContractError, match="damaged"):
        parse_model_file(whole)


def test_metadata_of_many_megabytes_is_not_parsed(model_file):
    path = model_file(contract=None, metadata=" " * 2**22 + "{}")
    with pytest.raises(ContractError, match="4194306"):
        load_model_file(path)


@pytest.mark.parametrize("content", [
    b"\x08\xff",  # a number that does not end
    b"\x08\x01\x72" + b"\xff" * 8 + b"\x7f",  # an entry of 2^63 bytes
    b"\x08\x01\x72\x0a\x0a\x06ssdnet\x12" + b"\xff" * 8,  # metadata of a length without end
])  # fmt: skip
def test_what_is_no_protobuf(content):
    with pytest.raises(ContractError, match=r"damaged|truncated"):
        parse_model_file(content)
