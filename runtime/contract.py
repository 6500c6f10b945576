"""The versioned JSON document inside every ONNX file: what the tensors alone do not say."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from runtime.errors import ContractError

METADATA_KEY = "ssdnet"
SCHEMA_VERSION = "1.0"

MAX_CLASSES = 255  # ids are uint8 and 255 means "ignore"
#: The rules a file may name for each tensor; `runtime.resize` carries them out.
#: "bilinear" takes the mean of the area along a side that shrinks to less than half, so that no
#: pixel is skipped. "nearest" never mixes two depths or classes; where sparse depth shrinks every
#: measurement is kept, the nearest to the camera of several in one pixel.
RESIZE_RULES: Mapping[str, tuple[str, ...]] = {
    "rgb": ("bilinear",),
    "sparse_depth": ("nearest",),
    "semantic": ("nearest",),
    "depth": ("nearest",),
    "boundary": ("bilinear",),
}


@dataclass(frozen=True)
class ClassInfo:
    """A semantic class: its name and its colour in pictures (red, green, blue, each 0..255)."""

    name: str
    color: tuple[int, int, int]


@dataclass(frozen=True)
class Contract:
    """What a model file says about itself, beside the tensors of its graph.

    schema_version: "major.minor"; a reader refuses another major than its own
    model_name: for example "ssdnet-lite"
    classes: in the order of the ids of `semantic`; empty without a semantic head
    max_depth_m: depths beyond it are no measurement [m]
    native_size: (height, width) it was exported and verified at; a dynamic model accepts any size
    stride: the graph pads to a multiple of it, and crops back
    resize: how each tensor is resized where a picture has another size than a fixed model
    precision: "fp32", "fp16", "int8"
    training: the data it was trained on and their terms
    versions: of what made the file (ssdnet, torch, onnx, opset)
    parity: head -> largest measured difference to PyTorch; {} = not measured
    checkpoint_sha256: digest of the checkpoint the file was made from
    trained_height: rows of the pictures it was trained for; None = not known
    """

    schema_version: str
    model_name: str
    classes: tuple[ClassInfo, ...]
    max_depth_m: float
    native_size: tuple[int, int]
    stride: int
    resize: Mapping[str, str]
    precision: str
    training: Mapping[str, Any]
    versions: Mapping[str, str]
    parity: Mapping[str, Any]
    checkpoint_sha256: str
    trained_height: int | None = None

    def to_json(self) -> str:
        """The document as it is stored under METADATA_KEY."""
        return json.dumps(asdict(self), allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> "Contract":
        """Read the document.

        Unknown keys are ignored: a later minor version may add some.
        Raises ContractError naming the missing key, the wrong type or value, or the unknown
        major version.
        """
        try:
            document = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise ContractError(
                f"the model's metadata {METADATA_KEY!r} is not JSON ({error}): "
                "export the model again with ssdnet-export"
            ) from error
        if not isinstance(document, dict):
            raise _wrong("the document", "an object", document)
        version = _text(document, "schema_version")
        if version.split(".")[0] != SCHEMA_VERSION.split(".")[0]:
            raise ContractError(
                f"the model's metadata has schema version {version!r}, this engine reads "
                f"{SCHEMA_VERSION.split('.')[0]}.x: update ssdnet, or export the model again "
                "with this version"
            )
        return cls(
            schema_version=version,
            model_name=_text(document, "model_name"),
            classes=_classes(document),
            max_depth_m=_positive_number(document, "max_depth_m"),
            native_size=_size(document, "native_size"),
            stride=_positive_integer(_value(document, "stride"), "stride"),
            resize=_resize(document),
            precision=_text(document, "precision"),
            training=_mapping(document, "training"),
            versions=_text_mapping(document, "versions"),
            parity=_mapping(document, "parity"),
            checkpoint_sha256=_text(document, "checkpoint_sha256"),
            trained_height=_trained_height(document),
        )


def _wrong(name: str, expected: str, found: object) -> ContractError:
    return ContractError(
        f"the model's metadata is damaged: {name} must be {expected}, found {found!r:.80}: "
        "export the model again with ssdnet-export"
    )


def _value(document: Mapping[str, Any], key: str) -> Any:
    if key not in document:
        raise ContractError(
            f"the model's metadata lacks the key {key!r}: export the model again with ssdnet-export"
        )
    return document[key]


def _text(document: Mapping[str, Any], key: str) -> str:
    value = _value(document, key)
    if not isinstance(value, str):
        raise _wrong(key, "text", value)
    return value


def _mapping(document: Mapping[str, Any], key: str) -> dict[str, Any]:
    value = _value(document, key)
    if not isinstance(value, dict):
        raise _wrong(key, "an object", value)
    return value


def _text_mapping(document: Mapping[str, Any], key: str) -> dict[str, str]:
    mapping = _mapping(document, key)
    for name, value in mapping.items():
        if not isinstance(value, str):
            raise _wrong(f"{key}.{name}", "text", value)
    return mapping


def _is_integer(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _positive_integer(value: object, name: str) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 1:
        raise _wrong(name, "a positive integer", value)
    return value


def _positive_number(document: Mapping[str, Any], key: str) -> float:
    value = _value(document, key)
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise _wrong(key, "a positive number", value)
    if not 0 < value < float("inf"):
        raise _wrong(key, "a positive number", value)
    return float(value)


def _size(document: Mapping[str, Any], key: str) -> tuple[int, int]:
    value = _value(document, key)
    if not isinstance(value, list) or len(value) != 2:
        raise _wrong(key, "[height, width]", value)
    return _positive_integer(value[0], key), _positive_integer(value[1], key)


def _trained_height(document: Mapping[str, Any]) -> int | None:
    value = document.get("trained_height")  # files of schema 1.0 have none
    return None if value is None else _positive_integer(value, "trained_height")


def _classes(document: Mapping[str, Any]) -> tuple[ClassInfo, ...]:
    value = _value(document, "classes")
    if not isinstance(value, list) or len(value) > MAX_CLASSES:
        raise _wrong("classes", f"a list of at most {MAX_CLASSES}", value)
    classes = tuple(_class(entry, f"classes[{index}]") for index, entry in enumerate(value))
    if len({info.name for info in classes}) < len(classes):
        raise _wrong("classes", "a list of different names", [info.name for info in classes])
    return classes


def _class(entry: object, name: str) -> ClassInfo:
    if not isinstance(entry, dict):
        raise _wrong(name, "an object", entry)
    color = _value(entry, "color")
    if not isinstance(color, list) or len(color) != 3:
        raise _wrong(f"{name}.color", "[red, green, blue]", color)
    if not all(_is_integer(part) and 0 <= part <= 255 for part in color):
        raise _wrong(f"{name}.color", "three integers 0..255", color)
    return ClassInfo(name=_text(entry, "name"), color=(color[0], color[1], color[2]))


def _resize(document: Mapping[str, Any]) -> dict[str, str]:
    rules = _text_mapping(document, "resize")
    for tensor, known in RESIZE_RULES.items():
        rule = _value(rules, tensor)
        if rule not in known:
            raise _wrong(f"resize.{tensor}", " or ".join(known), rule)
    return rules
