"""The versioned JSON document inside every ONNX file: what the tensors alone do not say."""

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from runtime.errors import ContractError
from runtime.heads import HEADS

METADATA_KEY = "ssdnet"
SCHEMA_VERSION = "1.2"

# What is sane, for a model file and for a network's configuration alike.
MIN_SIDE = 32  # rows, columns: networks of the family halve a picture up to five times
MAX_SIDE = 16_384
MAX_PIXELS = 64_000_000  # of a picture: the largest cameras of the field have 12 million
MAX_STRIDE = 1024
NO_CLASS = 255  # the id of a pixel without a class; in an answer its scores are not finite
MAX_CLASSES = 255  # ids are uint8, and one of them is NO_CLASS
MAX_NAME_LENGTH = 64
MIN_DEPTH_RANGE_M = 1.0  # bounds of max_depth_m
MAX_DEPTH_RANGE_M = 10_000.0
MIN_FOCAL_PX = 1.0  # bounds of a focal length: from tiny pictures to long telephoto lenses
MAX_FOCAL_PX = 1_000_000.0

_INPUT_RESIZE = {"rgb": "bilinear", "sparse_depth": "nearest"}
_DIGEST_KEY = "document_sha256"
_MINOR_VERSION = re.compile("[0-9]{1,4}")


@dataclass(frozen=True)
class ClassInfo:
    """A semantic class: its name and its colour in pictures (red, green, blue, each 0..255)."""

    name: str
    color: tuple[int, int, int]


@dataclass(frozen=True)
class Content:
    """What stands in a model file before its metadata: how many bytes, and their SHA-256."""

    bytes: int
    sha256: str


@dataclass(frozen=True)
class Contract:
    """What a model file says about itself, beside the tensors of its graph.

    schema_version: "major.minor"; a reader refuses another major than its own
    model_name: for example "ssdnet-lite"
    classes: in the order of the ids of `semantic`; empty without a semantic head
    max_depth_m: depths beyond it are no measurement [m], in canonical metres if there are any
    native_size: (height, width) it was exported and verified at; a dynamic model accepts any size
    stride: the graph pads to a multiple of it, and crops back
    resize: how each tensor is resized where the network runs at another size than the frame's
    precision: "fp32", "fp16", "int8"
    training: the data it was trained on and their terms
    versions: of what made the file (ssdnet, torch, onnx, opset)
    parity: head -> largest measured difference to PyTorch; {} = not measured
    checkpoint_sha256: digest of the checkpoint the file was made from
    trained_height: rows of the pictures it was trained for; None = not known
    canonical_focal_px: focal length [px] of the camera in whose metres the graph works, see
        `runtime.canonical_focal`; None = it works in plain metres
    content: the bytes of the file before this document; None in a file of schema 1.0
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
    canonical_focal_px: float | None = None
    content: Content | None = None

    @property
    def sky(self) -> int | None:
        """The id of the class that has no depth; None = there is none."""
        return find_sky(self.classes)

    def to_json(self) -> str:
        """The document as it is stored under METADATA_KEY.

        With `content` its last key is "document_sha256": the SHA-256 of the UTF-8 bytes before
        the comma that stands before that key.
        """
        document = asdict(self)
        if self.content is None:
            del document["content"]
            return json.dumps(document, allow_nan=False)
        return _with_digest(json.dumps(document, allow_nan=False).removesuffix("}"))

    @classmethod
    def from_json(cls, text: str) -> "Contract":
        """Read the document.

        Unknown keys are ignored: a later minor version may add some.
        Raises ContractError naming the missing key, the wrong type or value, or the unknown
        major version, and for a document of schema 1.1 that was changed after it was written.
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
        try:
            contract = cls(
                schema_version=version,
                model_name=check_name(_value(document, "model_name"), "model_name"),
                classes=check_classes(_classes(document)),
                max_depth_m=check_max_depth(_value(document, "max_depth_m")),
                native_size=check_size(_value(document, "native_size"), "native_size"),
                stride=check_stride(_value(document, "stride")),
                resize=_resize(document),
                precision=check_name(_value(document, "precision"), "precision"),
                training=_mapping(document, "training"),
                versions=_text_mapping(document, "versions"),
                parity=_mapping(document, "parity"),
                checkpoint_sha256=_text(document, "checkpoint_sha256"),
                trained_height=_trained_height(document),
                canonical_focal_px=_canonical_focal(document),
                content=_content(document, text),
            )
            # Infinite numbers and halves of characters, wherever else they stand.
            json.dumps(document, allow_nan=False, ensure_ascii=False).encode()
        except (ValueError, RecursionError) as error:
            raise ContractError(
                f"the model's metadata is damaged: {error}: export the model again with "
                "ssdnet-export"
            ) from error
        return contract


def resize_rules() -> dict[str, str]:
    """Return how each tensor is resized where the network runs at another size than the frame's.

    "bilinear" takes the mean of the area along each side that shrinks, so that no pixel is skipped,
    and is bilinear along one that grows. "nearest" never mixes two values: a head takes the pixel
    with the nearest centre, and each return of `sparse_depth` is moved to its one pixel; of several
    in one pixel the nearest to the camera is kept. `runtime.resize` implements both.
    """
    return _INPUT_RESIZE | {head.name: head.resize for head in HEADS.values()}


def check_side(side: object, name: str) -> int:
    """Give back a picture's height or width; ValueError naming it if it is out of range."""
    if not isinstance(side, int) or isinstance(side, bool) or not MIN_SIDE <= side <= MAX_SIDE:
        raise ValueError(f"{name} must be {MIN_SIDE} to {MAX_SIDE} pixels, got {side!r:.80}")
    return side


def check_size(size: object, name: str = "size") -> tuple[int, int]:
    """Give back a picture's (height, width); ValueError naming it if it is out of range."""
    if not isinstance(size, Sequence) or isinstance(size, str) or len(size) != 2:
        raise ValueError(f"{name} must be (height, width), got {size!r:.80}")
    for side, text in zip(size, ("height", "width"), strict=True):
        check_side(side, f"{name}: {text}")
    if size[0] * size[1] > MAX_PIXELS:
        raise ValueError(f"{name} must have at most {MAX_PIXELS} pixels, got {size!r:.80}")
    return size[0], size[1]


def check_stride(stride: object) -> int:
    """Give back a network's stride in pixels; ValueError if it is out of range."""
    if not isinstance(stride, int) or isinstance(stride, bool) or not 1 <= stride <= MAX_STRIDE:
        raise ValueError(f"stride must be an integer 1 to {MAX_STRIDE}, got {stride!r:.80}")
    return stride


def check_max_depth(max_depth_m: object) -> float:
    """Give back a depth range in metres; ValueError if it is out of range."""
    if (
        not isinstance(max_depth_m, int | float)
        or isinstance(max_depth_m, bool)
        or not MIN_DEPTH_RANGE_M <= max_depth_m <= MAX_DEPTH_RANGE_M  # False for NaN
    ):
        raise ValueError(
            f"max_depth_m must be {MIN_DEPTH_RANGE_M:g} to {MAX_DEPTH_RANGE_M:g} metres, "
            f"got {max_depth_m!r:.80}"
        )
    return float(max_depth_m)


def check_focal_length(focal_px: object, name: str) -> float:
    """Give back a focal length in pixels; ValueError naming it if it is out of range."""
    if (
        not isinstance(focal_px, int | float)
        or isinstance(focal_px, bool)
        or not MIN_FOCAL_PX <= focal_px <= MAX_FOCAL_PX  # False for NaN
    ):
        raise ValueError(
            f"{name} must be {MIN_FOCAL_PX:g} to {MAX_FOCAL_PX:g} pixels, got {focal_px!r:.80}"
        )
    return float(focal_px)


def check_name(text: object, name: str) -> str:
    """Give back a name, of a class say; ValueError unless it is short and printable."""
    if not isinstance(text, str) or not text.isprintable() or not 1 <= len(text) <= MAX_NAME_LENGTH:
        raise ValueError(
            f"{name} must be printable text of 1 to {MAX_NAME_LENGTH} characters, got {text!r:.80}"
        )
    return text


def check_classes(classes: Sequence[ClassInfo]) -> tuple[ClassInfo, ...]:
    """Give back a class table; ValueError for too many, for a bad name or colour, or for one name
    twice.
    """
    if len(classes) > MAX_CLASSES:
        raise ValueError(f"classes must be at most {MAX_CLASSES}, got {len(classes)}")
    for index, info in enumerate(classes):
        check_name(info.name, f"classes[{index}].name")
        if len(info.color) != 3 or not all(
            _is_integer(part) and 0 <= part <= 255 for part in info.color
        ):
            raise ValueError(
                f"classes[{index}].color must be three integers 0..255, got {info.color!r:.80}"
            )
    names = [info.name for info in classes]
    if len(set(names)) < len(names):
        raise ValueError(f"classes must have different names, got {names!r:.80}")
    return tuple(classes)


def find_sky(classes: Sequence[ClassInfo]) -> int | None:
    """The id of the class "sky", in any case of its letters; None = there is none."""
    return next((i for i, info in enumerate(classes) if info.name.lower() == "sky"), None)


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


def _trained_height(document: Mapping[str, Any]) -> int | None:
    value = document.get("trained_height")  # files of schema 1.0 have none
    return None if value is None else check_side(value, "trained_height")


def _canonical_focal(document: Mapping[str, Any]) -> float | None:
    value = document.get("canonical_focal_px")  # files before schema 1.2 have none
    return None if value is None else check_focal_length(value, "canonical_focal_px")


def _content(document: Mapping[str, Any], text: str) -> Content | None:
    """Read `content`; by the version or the keys of schema 1.1 it and the digest are required."""
    minor = document["schema_version"].partition(".")[2]
    if not _MINOR_VERSION.fullmatch(minor):
        raise _wrong("schema_version", "major.minor", document["schema_version"])
    if int(minor) == 0 and not {"content", _DIGEST_KEY} & document.keys():
        return None
    value, digest = _mapping(document, "content"), _text(document, _DIGEST_KEY)
    before = text.rpartition(f', "{_DIGEST_KEY}"')[0]
    if text != _with_digest(before):
        raise ContractError(
            f"the model's metadata was changed after it was written ({_DIGEST_KEY} is "
            f"{digest!r:.80}): get the model again, or export it again with ssdnet-export"
        )
    size, sha256 = _value(value, "bytes"), _value(value, "sha256")
    if not _is_integer(size):
        raise _wrong("content.bytes", "an integer", size)
    if not isinstance(sha256, str):
        raise _wrong("content.sha256", "text", sha256)
    return Content(bytes=size, sha256=sha256)


def _with_digest(before: str) -> str:
    digest = hashlib.sha256(before.encode()).hexdigest()
    return f'{before}, "{_DIGEST_KEY}": "{digest}"}}'


def _classes(document: Mapping[str, Any]) -> list[ClassInfo]:
    value = _value(document, "classes")
    if not isinstance(value, list):
        raise _wrong("classes", "a list", value)
    return [_class(entry, f"classes[{index}]") for index, entry in enumerate(value)]


def _class(entry: object, name: str) -> ClassInfo:
    if not isinstance(entry, dict):
        raise _wrong(name, "an object", entry)
    color = _value(entry, "color")
    if not isinstance(color, list) or len(color) != 3:
        raise _wrong(f"{name}.color", "[red, green, blue]", color)
    return ClassInfo(name=_value(entry, "name"), color=(color[0], color[1], color[2]))


def _resize(document: Mapping[str, Any]) -> dict[str, str]:
    rules = _text_mapping(document, "resize")
    for tensor, known in resize_rules().items():
        # A head that was added after the file was written has no rule in it.
        rule = _value(rules, tensor) if tensor in _INPUT_RESIZE else rules.get(tensor, known)
        if rule != known:
            raise _wrong(f"resize.{tensor}", known, rule)
    return rules
