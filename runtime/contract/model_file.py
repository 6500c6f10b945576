"""The bytes of a model file: an ONNX model, followed by the metadata by which it is checked.

A file holds, in this order and nothing else:

| bytes | |
|---|---|
| content | a serialised ONNX model (protobuf `ModelProto`) without the metadata below |
| `72` LENGTH | the key and length of one more `metadata_props` entry (field 14 of `ModelProto`) |
| `0A 06` "ssdnet" | the entry's key |
| `12` LENGTH JSON | the entry's value: the document of `runtime.Contract` |

LENGTH is a protobuf varint. The document holds the length and SHA-256 of the content, and its own
SHA-256, so that no byte of the file can change unnoticed. The entry is found by its key, which JSON
cannot contain; only ONNX Runtime parses the content. The digests detect damage, not forgery: a
forger can write the digests too. `sha256=` of `load_model_file` pins a whole file.
"""

import dataclasses
import hashlib
import re
from dataclasses import dataclass
from pathlib import Path

from runtime.base.arguments import shown
from runtime.base.errors import ContractError, InputError
from runtime.contract.contract import METADATA_KEY, Contract, ModelContent
from runtime.files.read_input import read_input

MAX_MODEL_BYTES = 2**31 - 1  # limit of protobuf
MAX_DOCUMENT_BYTES = 2**22

_METADATA_PROPS = b"\x72"  # field 14 of ModelProto, with a length
_KEY = b"\x0a" + bytes([len(METADATA_KEY)]) + METADATA_KEY.encode()  # field 1 of an entry
_VALUE = b"\x12"  # field 2 of an entry, with a length
_LENGTH = re.compile(rb"[\x80-\xff]{0,4}[\x00-\x7f]")  # a varint
_ONNX_START = b"\x08"  # the key of ir_version, the first field that is written


@dataclass(frozen=True)
class ModelFile:
    """A model file in memory: its bytes, their SHA-256 (hexadecimal) and its metadata."""

    content: bytes
    sha256: str
    contract: Contract


def load_model_file(path: Path, *, sha256: str | None = None) -> ModelFile:
    """Read a model file and check that it is whole.

    Args:
        path: the model file.
        sha256: SHA-256 that the file must have, 64 hexadecimal digits; None: any.

    Raises:
        ContractError: if the file is missing, not a regular file, larger than `MAX_MODEL_BYTES`,
            not ONNX or damaged, or if it has another SHA-256 or no metadata.
    """
    content = _read(path)
    digest = hashlib.sha256(content).hexdigest()
    if sha256 is not None and str(sha256).lower() != digest:  # what is no text never matches
        raise ContractError(
            f"the model {path} has the SHA-256 {digest}, expected {shown(sha256)}: get the right "
            "file, or give this one"
        )
    return _parse_named(content, path)


def _parse_named(content: bytes, path: Path) -> ModelFile:
    try:
        return parse_model_file(content)
    except ContractError as error:
        raise ContractError(f"{path}: {error}") from error


def read_onnx(path: Path) -> bytes:
    """Read an ONNX file of any origin; if it has metadata of this project, it is also checked.

    Raises:
        ContractError: as for `load_model_file`, but not if the file has no metadata.
    """
    content = _read(path)
    _require_onnx(content)
    if _KEY + _VALUE in content:
        _parse_named(content, path)
    return content


def has_metadata(path: Path) -> bool:
    """Return whether an ONNX file holds metadata of this project, damaged or not; ContractError."""
    content = _read(path)
    _require_onnx(content)
    return _KEY + _VALUE in content


def parse_model_file(content: bytes) -> ModelFile:
    """Read the metadata of a model, and check with it that the bytes are those of the export.

    Raises:
        ContractError: if the bytes are not ONNX, damaged, or have no metadata.
    """
    view, text = memoryview(content), _document(content)
    contract, entry = Contract.from_json(text), _entry(text)
    digest = hashlib.sha256(view[: -len(entry)])
    if view[-len(entry) :] != entry:
        raise _damaged("its metadata is not the last entry of the file, or is encoded differently")
    actual = ModelContent(bytes=len(view) - len(entry), sha256=digest.hexdigest())
    if actual != (known := contract.content):
        raise _damaged(
            f"the model has {actual.bytes} bytes (SHA-256 {actual.sha256[:12]}), but its metadata "
            f"describes {known.bytes} bytes (SHA-256 {known.sha256[:12]})"
        )
    digest.update(view[-len(entry) :])  # one pass over the bytes for both digests
    return ModelFile(content, digest.hexdigest(), contract)


def with_contract(content: bytes, contract: Contract) -> bytes:
    """Return the bytes of a model file: an ONNX model, followed by its metadata.

    Args:
        content: the serialised ONNX model.
        contract: the metadata; this function fills in its `content`.

    Raises:
        ValueError, TypeError: if the contract holds values that JSON cannot represent.
    """
    described = ModelContent(bytes=len(content), sha256=hashlib.sha256(content).hexdigest())
    text = dataclasses.replace(contract, content=described).to_json()
    return content + _entry(text)


def _document(content: bytes) -> str:
    """Return the text of the metadata. Raises ContractError."""
    _require_onnx(content)
    key = content.rfind(_KEY + _VALUE)
    if key < 0:
        raise ContractError(
            f"the ONNX file has no metadata {METADATA_KEY!r}: it was not written by ssdnet-export, "
            "or is truncated; export a checkpoint with ssdnet-export; other networks are scored by "
            "ssdnet-eval and timed by ssdnet-bench"
        )
    length = _LENGTH.match(content, key + len(_KEY + _VALUE))
    if length is None:
        raise _damaged("the length of its metadata is not a number")
    size = sum((byte & 0x7F) << 7 * place for place, byte in enumerate(length[0]))
    if size > MAX_DOCUMENT_BYTES:
        raise _damaged(f"its metadata has {size} bytes, more than {MAX_DOCUMENT_BYTES}")
    try:
        return content[length.end() : length.end() + size].decode()
    except UnicodeDecodeError as error:
        raise _damaged(f"its metadata is not UTF-8 ({error})") from error


def _require_onnx(content: bytes) -> None:
    if not content.startswith(_ONNX_START):
        raise ContractError(
            "the model cannot be loaded: the file is not ONNX; give one that ssdnet-export wrote"
        )


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


def _entry(text: str) -> bytes:
    """Return the metadata entry that holds `text`, encoded as protobuf encodes it."""
    value = text.encode()
    entry = _KEY + _VALUE + _varint(len(value)) + value
    return _METADATA_PROPS + _varint(len(entry)) + entry


def _varint(value: int) -> bytes:
    written = bytearray()
    while value >= 0x80:
        written.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*written, value])


def _damaged(fault: str) -> ContractError:
    return ContractError(
        f"the model file is truncated or damaged; get it again, or export it again ({fault})"
    )
