"""The bytes of a model file: read within bounds, written and checked with the metadata at the end.

Since schema 1.1 a file holds, in this order and nothing else:

| bytes | |
|---|---|
| content | a serialised ONNX model (protobuf `ModelProto`) without the metadata below |
| `72` LENGTH | the key and length of one more `metadata_props` entry (field 14 of `ModelProto`) |
| `0A 06` "ssdnet" | the entry's key |
| `12` LENGTH JSON | the entry's value: the document of `runtime.contract.Contract` |

LENGTH is a protobuf varint. The document holds the length and SHA-256 of the content, and its own
SHA-256, so that no byte of the file can change unnoticed. That finds damage, not forgery: a forger
can write the digests too. `sha256=` of `load_model_file` pins a whole file.
"""

import dataclasses
import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from runtime.contract import METADATA_KEY, Content, Contract
from runtime.errors import ContractError, InputError
from runtime.read_input import read_input

MAX_MODEL_BYTES = 2**31 - 1  # what protobuf can hold
MAX_DOCUMENT_BYTES = 2**22

_MAX_FIELDS = 10_000  # of a model and its metadata; a model has tens
_MAX_GRAPH_FIELDS = 1_000_000  # of all messages; a graph of 400 nodes has 10,000
# Field numbers of onnx.proto.
_GRAPH, _METADATA_PROPS, _FUNCTIONS = 7, 14, 25  # of ModelProto
_KEY, _VALUE = 1, 2  # of an entry of metadata_props
_NODE, _INITIALIZER = 1, 5  # of GraphProto
_OP_TYPE, _ATTRIBUTE = 4, 5  # of NodeProto
_TENSOR, _SUBGRAPH, _SUBGRAPHS = 5, 6, 11  # of AttributeProto
_DATA_TYPE, _FLOAT_DATA, _RAW_DATA, _DOUBLE_DATA = 2, 4, 9, 10  # of TensorProto
_FLOAT_TYPES = {1: "<f4", 10: "<f2", 11: "<f8"}  # of TensorProto.DataType
_VARINT, _FIXED_64, _BYTES, _FIXED_32 = 0, 1, 2, 5  # wire types
_ONNX_START = b"\x08"  # the key of ir_version, the first field that is written
_SHA256 = re.compile("[0-9a-fA-F]{64}", re.ASCII)


@dataclass(frozen=True)
class ModelFile:
    """A model file in memory: its bytes, their SHA-256 (hexadecimal) and its metadata."""

    content: bytes
    sha256: str
    contract: Contract


def load_model_file(path: Path, *, sha256: str | None = None) -> ModelFile:
    """Read a model file and check that it is whole.

    Args:
        path: of the file.
        sha256: digest that the file must have, 64 hexadecimal digits; None = any.

    Raises:
        ContractError: for a file that is missing, not a regular one, larger than MAX_MODEL_BYTES,
            of another digest, not ONNX, damaged or without metadata.
        InputError: for a malformed digest.
    """
    if sha256 is not None and not (isinstance(sha256, str) and _SHA256.fullmatch(sha256)):
        raise InputError(
            f"sha256 must be the 64 hexadecimal digits of a file's SHA-256, got {sha256!r:.80}"
        )
    content = _read(path)
    if sha256 is not None:
        digest = hashlib.sha256(content).hexdigest()
        if digest != sha256.lower():
            raise ContractError(
                f"the model {path} has the SHA-256 {digest}, expected {sha256.lower()}: get the "
                "right file, or give this digest"
            )
    return parse_model_file(content)


def parse_model_file(content: bytes) -> ModelFile:
    """Read the metadata of a model, and check by it that its bytes are what was exported.

    A file of schema 1.0 has no digests: damage that leaves its metadata readable goes unnoticed.

    Raises:
        ContractError: for bytes that are not ONNX, damaged or without metadata, and for a graph
            with subgraphs (Loop, If, Scan), functions or NaN in its constants.
    """
    contract, digest = _check(content)
    _check_graph(memoryview(content))
    return ModelFile(content, digest, contract)


def with_contract(content: bytes, contract: Contract) -> bytes:
    """Return the bytes of a model file: an ONNX model, then its metadata.

    Args:
        content: the serialised ONNX model.
        contract: the metadata; its own `content` is filled in.

    Raises:
        ValueError, TypeError: where the contract holds something other than plain JSON.
    """
    described = Content(bytes=len(content), sha256=hashlib.sha256(content).hexdigest())
    text = dataclasses.replace(contract, content=described).to_json()
    return content + _entry(text)


def _check(model: bytes) -> tuple[Contract, str]:
    """Check a model: its contract, and the SHA-256 of the whole."""
    entries = list(_metadata(model))
    ours = [(start, value) for start, key, value in entries if key == METADATA_KEY.encode()]
    if not ours:
        keys = sorted(key.decode(errors="replace") for _, key, _ in entries)
        raise ContractError(
            f"not a model for this engine: the ONNX file has no metadata {METADATA_KEY!r} "
            f"(it has {keys!r:.200}): export one with ssdnet-export"
        )
    if len(ours) > 1:
        raise _damaged(f"it holds the metadata {METADATA_KEY!r} {len(ours)} times")
    start, value = ours[0]
    if len(value) > MAX_DOCUMENT_BYTES:
        raise _damaged(f"its metadata has {len(value)} bytes, more than {MAX_DOCUMENT_BYTES}")
    try:
        text = value.decode()
    except UnicodeDecodeError as error:
        raise _damaged(f"its metadata is not UTF-8 ({error})") from error
    contract = Contract.from_json(text)
    view = memoryview(model)
    digest = hashlib.sha256(view[:start])
    if contract.content is not None:
        if view[start:] != _entry(text):
            raise _damaged("its metadata is not the last thing in it, or is written another way")
        found = Content(bytes=start, sha256=digest.hexdigest())
        if found != contract.content:
            raise _damaged(f"the model is {found}, by its metadata {contract.content}")
    digest.update(view[start:])  # one pass over the bytes for both digests
    return contract, digest.hexdigest()


def _read(path: Path) -> bytes:
    try:
        content = read_input(path, max_bytes=MAX_MODEL_BYTES)
    except InputError as error:
        raise ContractError(
            f"cannot read the model ({error}): name an ONNX file made by ssdnet-export, or one of "
            "the bundled models"
        ) from error
    if not content:
        raise ContractError(f"the model {path} is an empty file: get it again")
    return content


def _metadata(model: bytes) -> Iterator[tuple[int, bytes, bytes]]:
    """Yield where each `metadata_props` entry of a model starts, its key and its value."""
    if not model.startswith(_ONNX_START):
        raise ContractError(
            "the model cannot be loaded: the file is not ONNX; give one that ssdnet-export wrote"
        )
    try:
        budget = iter(range(_MAX_FIELDS))
        for start, number, entry in _fields(memoryview(model), budget):
            if number == _METADATA_PROPS and isinstance(entry, memoryview):
                parts = {field: part for _, field, part in _fields(entry, budget)}
                key, value = (parts.get(field, memoryview(b"")) for field in (_KEY, _VALUE))
                if isinstance(key, memoryview) and isinstance(value, memoryview):
                    yield start, bytes(key), bytes(value)
    except (IndexError, ValueError) as error:
        raise _damaged(f"its fields do not make a model: {error}") from error


def _check_graph(model: memoryview) -> None:
    """Raise ContractError for a graph that may not end, or with constants that are not finite.

    Networks need neither subgraphs nor functions; with them a small file may describe endless work.
    """
    budget = iter(range(_MAX_GRAPH_FIELDS))
    try:
        for _, number, graph in _fields(model, budget):
            if number == _FUNCTIONS:
                raise _unusable("it defines functions")
            if number != _GRAPH or not isinstance(graph, memoryview):
                continue
            for _, kind, part in _fields(graph, budget):
                if kind == _NODE and isinstance(part, memoryview):
                    _check_node(part, budget)
                elif kind == _INITIALIZER and isinstance(part, memoryview):
                    _check_constant(part, budget)
    except (IndexError, ValueError) as error:
        raise _damaged(f"its fields do not make a model: {error}") from error


def _check_node(node: memoryview, budget: Iterator[int]) -> None:
    parts = list(_fields(node, budget))
    operator = b"".join(bytes(part) for _, number, part in parts if number == _OP_TYPE)
    for _, number, attribute in parts:
        if number != _ATTRIBUTE or not isinstance(attribute, memoryview):
            continue
        for _, kind, value in _fields(attribute, budget):
            if kind in (_SUBGRAPH, _SUBGRAPHS):
                name = operator.decode(errors="replace")
                raise _unusable(f"its operator {name!r:.80} has a graph of its own")
            if kind == _TENSOR and isinstance(value, memoryview):
                _check_constant(value, budget)


def _check_constant(tensor: memoryview, budget: Iterator[int]) -> None:
    """Refuse NaN; and Inf but in a scalar, which may be the limit of a range."""
    parts = {number: value for _, number, value in _fields(tensor, budget)}
    types = {_FLOAT_DATA: "<f4", _DOUBLE_DATA: "<f8"}
    raw_type = parts.get(_DATA_TYPE)
    if isinstance(raw_type, int) and raw_type in _FLOAT_TYPES:
        types[_RAW_DATA] = _FLOAT_TYPES[raw_type]
    for number, dtype in types.items():
        content = parts.get(number)
        if not isinstance(content, memoryview) or not content:
            continue
        values = np.frombuffer(content, dtype=dtype)
        if np.isnan(values).any() or (values.size > 1 and np.isinf(values).any()):
            raise _unusable("its constants hold NaN or Inf")


def _fields(
    message: memoryview, budget: Iterator[int]
) -> Iterator[tuple[int, int, memoryview | int]]:
    """Yield (start, number, value) of each field of a protobuf message.

    Each field takes an item of `budget`. Raises ValueError or IndexError where the message does not
    end with a field, and where the budget is used up.
    """
    at = 0
    value: memoryview | int
    while at < len(message):
        if next(budget, None) is None:
            raise ValueError("too many fields")
        start = at
        key, at = _varint(message, at)
        number, wire_type = key >> 3, key & 7
        if wire_type == _VARINT:
            value, at = _varint(message, at)
        elif wire_type in (_BYTES, _FIXED_32, _FIXED_64):
            length = 4 if wire_type == _FIXED_32 else 8
            if wire_type == _BYTES:
                length, at = _varint(message, at)
            value = message[at : at + length]
            at += length
        else:
            raise ValueError(f"wire type {wire_type}")
        if at > len(message):
            raise ValueError("a field is longer than its message")
        yield start, number, value


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    """Read an integer of 7 bits a byte, low ones first; give it and where the next field starts."""
    value = 0
    for shift in range(0, 70, 7):
        byte = message[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise ValueError("an integer of more than 64 bits")


def _entry(text: str) -> bytes:
    """The metadata entry that holds `text`, as protobuf writes it."""
    entry = _field(_KEY, METADATA_KEY.encode()) + _field(_VALUE, text.encode())
    return _field(_METADATA_PROPS, entry)


def _field(number: int, payload: bytes) -> bytes:
    return bytes([number << 3 | _BYTES]) + _written_varint(len(payload)) + payload


def _written_varint(value: int) -> bytes:
    written = bytearray()
    while value >= 0x80:
        written.append(value & 0x7F | 0x80)
        value >>= 7
    written.append(value)
    return bytes(written)


def _unusable(fault: str) -> ContractError:
    return ContractError(f"not a model for this engine: {fault}: export one with ssdnet-export")


def _damaged(fault: str) -> ContractError:
    return ContractError(
        f"the model file is truncated or damaged; get it again, or export it again ({fault})"
    )
