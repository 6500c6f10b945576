"""The versioned JSON document inside every ONNX file; it states what the tensors do not."""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, TypeVar

from runtime.base.arguments import check_integer, check_number, shown
from runtime.base.arrays import Size
from runtime.base.errors import ContractError
from runtime.contract.heads import HEADS

METADATA_KEY = "ssdnet"
SCHEMA_VERSION = "1.4"

# Limits for a model file and for a network's configuration.
MIN_SIDE = 32  # rows or columns: the networks halve an image up to five times
MAX_SIDE = 16_384
MAX_PIXELS = 64_000_000  # largest image; automotive cameras have up to 12 million
MAX_STRIDE = 1024
NO_CLASS = 255  # no class: an unlabelled pixel, or an answer whose scores are not finite
MAX_CLASSES = 255  # ids are uint8, and one of them is NO_CLASS
MAX_NAME_LENGTH = 64
MIN_DEPTH_RANGE_M = 1.0  # bounds of max_depth_m
MAX_DEPTH_RANGE_M = 10_000.0
# Longest range of automotive LiDARs [m]. A value is no measurement if it is larger and also beyond
# the model's range: 65535 in a 16-bit PNG (256 m) marks pixels without a return.
MAX_RETURN_M = 250.0
MIN_FOCAL_PX = 1.0  # bounds of a focal length: from tiny pictures to long telephoto lenses
MAX_FOCAL_PX = 1_000_000.0
MAX_GIGA_MACS = 1_000_000.0

_DIGEST_KEY = "document_sha256"
_Checked = TypeVar("_Checked")


@dataclass(frozen=True)
class ClassInfo:
    """A semantic class: its name and its colour in pictures (red, green, blue, each 0..255)."""

    name: str
    color: tuple[int, int, int]


@dataclass(frozen=True)
class ModelContent:
    """The bytes of a model file before its metadata: their number and SHA-256."""

    bytes: int
    sha256: str


@dataclass(frozen=True)
class Contract:
    """What a model file states in addition to the tensors of its graph.

    Attributes:
        schema_version: SCHEMA_VERSION; any other version is refused.
        model_name: for example "ssdnet-lite".
        classes: in the order of the ids of `semantic`; empty without a semantic head.
        max_depth_m: the depth range. No answer is farther, and returns beyond the range are
            clipped, see `farthest_return`. In canonical metres if `canonical_focal_px` is given.
        native_size: (height, width) at which the file was exported and verified; a dynamic model
            takes any size.
        stride: the graph pads its inputs to a multiple of it, and crops the outputs back.
        precision: "fp32", "fp16" or "int8".
        training: the data it was trained on and their terms.
        versions: versions of the software that made the file (ssdnet, torch, onnx, opset).
        parity: head -> largest measured difference to PyTorch; {} = not measured.
        checkpoint_sha256: SHA-256 of the checkpoint the file was made from.
        trained_height: rows of the images it was trained on; None: not known.
        canonical_focal_px: focal length [px] of the camera in whose metres the graph works, see
            `runtime.contract.canonical_focal`; None: plain metres.
        giga_macs: multiply-accumulate operations for a frame of `native_size`, in billions; None:
            not counted.
        accuracy: measured with this file: "repeat", the command, and "rows", the
            scores on each data set with each LiDAR; None: not measured.
        quantization: for an "int8" file, the calibration data, the convolutions left in float, the
            rows of `accuracy` in single precision, and what was not measured; else None.
        content: the bytes of the file before this document; `with_contract` fills it in.
    """

    schema_version: str
    model_name: str
    classes: tuple[ClassInfo, ...]
    max_depth_m: float
    native_size: Size
    stride: int
    precision: str
    training: Mapping[str, Any]
    versions: Mapping[str, str]
    parity: Mapping[str, Any]
    checkpoint_sha256: str
    trained_height: int | None = None
    canonical_focal_px: float | None = None
    giga_macs: float | None = None
    accuracy: Mapping[str, Any] | None = None
    quantization: Mapping[str, Any] | None = None
    content: ModelContent = ModelContent(bytes=0, sha256="")

    @property
    def sky(self) -> int | None:
        """The id of the class that has no depth; None if there is no such class."""
        return find_sky(self.classes)

    def to_json(self) -> str:
        """Return the document as it is stored under METADATA_KEY.

        Its last key is "document_sha256": the SHA-256 of the UTF-8 bytes before the comma in front
        of that key.
        """
        # This is written for other engines; this engine does not read it.
        resize = {"rgb": "bilinear", "sparse_depth": "nearest"}
        resize |= {head.name: head.resize for head in HEADS.values()}
        document = json.dumps({"resize": resize, **asdict(self)}, allow_nan=False)
        return _with_digest(document.removesuffix("}"))

    @classmethod
    def from_json(cls, text: str) -> "Contract":
        """Read the document.

        Args:
            text: the document as `to_json` writes it.

        Raises:
            ContractError: if a key is missing, a type, a value or the version is wrong, or the
                document was changed after it was written. The message names the cause.
        """
        try:
            document = json.loads(text)
            version = _take(document, "schema_version", str)
            if version != SCHEMA_VERSION:
                raise ContractError(
                    f"the model's metadata has schema version {shown(version)}, this engine reads "
                    f"{SCHEMA_VERSION}: export the model again with this version of ssdnet, or use "
                    "the version that wrote it"
                )
            contract = cls(
                schema_version=version,
                model_name=check_name(_take(document, "model_name"), "model_name"),
                classes=check_classes([_class(each) for each in _take(document, "classes", list)]),
                max_depth_m=check_max_depth(_take(document, "max_depth_m")),
                native_size=check_size(_take(document, "native_size"), "native_size"),
                stride=check_stride(_take(document, "stride")),
                precision=check_name(_take(document, "precision"), "precision"),
                training=_take(document, "training", dict),
                versions=_texts(_take(document, "versions", dict)),
                parity=_take(document, "parity", dict),
                checkpoint_sha256=_take(document, "checkpoint_sha256", str),
                trained_height=_optional(document, "trained_height", check_side),
                canonical_focal_px=_optional(document, "canonical_focal_px", check_focal_length),
                giga_macs=_optional(document, "giga_macs", _check_giga_macs),
                accuracy=_take(document, "accuracy", dict | None),
                quantization=_take(document, "quantization", dict | None),
                content=_content(_take(document, "content", dict)),
            )
            # Infinite numbers and lone surrogates are invalid anywhere in the document.
            json.dumps(document, allow_nan=False, ensure_ascii=False).encode()
            if text != _with_digest(text.rpartition(f', "{_DIGEST_KEY}"')[0]):
                raise ValueError(f"it was changed after it was written, see {_DIGEST_KEY}")
        except (ValueError, RecursionError) as error:
            raise ContractError(
                f"the model's metadata {METADATA_KEY!r} is damaged: {error}: get the model again, "
                "or export it again with ssdnet-export"
            ) from error
        return contract


def check_side(side: object, name: str) -> int:
    """Return an image's height or width; ValueError with its name if it is out of range."""
    return check_integer(name, side, MIN_SIDE, MAX_SIDE, "pixels")


def check_size(size: object, name: str = "size") -> Size:
    """Return an image's (height, width); ValueError with its name if it is out of range."""
    if not isinstance(size, Sequence) or isinstance(size, str) or len(size) != 2:
        raise ValueError(f"{name} must be (height, width), got {shown(size)}")
    height, width = (
        check_side(side, f"{name}: {text}")
        for side, text in zip(size, ("height", "width"), strict=True)
    )
    if height * width > MAX_PIXELS:
        raise ValueError(f"{name} must have at most {MAX_PIXELS} pixels, got {shown(size)}")
    return height, width


def check_stride(stride: object) -> int:
    """Return a network's stride; ValueError if it is out of range."""
    return check_integer("stride", stride, 1, MAX_STRIDE, "pixels")


def check_max_depth(range_m: object) -> float:
    """Return a depth range in metres; ValueError if it is out of range."""
    return check_number("max_depth_m", range_m, MIN_DEPTH_RANGE_M, MAX_DEPTH_RANGE_M, "metres")


def farthest_return(range_m: float) -> float:
    """Return the largest depth [m] that counts as a return.

    Returns between `range_m` and this depth are clipped to `range_m`. Farther values, Inf, NaN, 0
    and negative values are no measurement.
    """
    return max(range_m, MAX_RETURN_M)


def check_focal_length(focal_px: object, name: str) -> float:
    """Return a focal length in pixels; ValueError with its name if it is out of range."""
    return check_number(name, focal_px, MIN_FOCAL_PX, MAX_FOCAL_PX, "pixels")


def check_name(text: object, name: str) -> str:
    """Return the name of a class or a model; ValueError unless it is short and printable."""
    if not isinstance(text, str) or not text.isprintable() or not 1 <= len(text) <= MAX_NAME_LENGTH:
        raise ValueError(
            f"{name} must be printable text of 1 to {MAX_NAME_LENGTH} characters, got {shown(text)}"
        )
    return text


def check_classes(classes: Sequence[ClassInfo]) -> tuple[ClassInfo, ...]:
    """Return a class table; ValueError for too many, a bad name or colour, or a repeated name."""
    if isinstance(classes, str) or not isinstance(classes, Sequence):
        raise ValueError(f"classes must be a sequence of ClassInfo, got {shown(classes)}")
    if len(classes) > MAX_CLASSES:
        raise ValueError(f"classes must be at most {MAX_CLASSES}, got {len(classes)}")
    names: dict[str, str] = {}  # "sky" and "road" are found in upper and lower case
    for index, info in enumerate(classes):
        each = f"classes[{index}]"
        if not isinstance(info, ClassInfo):
            raise ValueError(
                f"{each} must be a ClassInfo(name, (red, green, blue)), got {shown(info)}"
            )
        key = check_name(info.name, f"{each}.name").casefold()
        if len(info.color) != 3:
            raise ValueError(f"{each}.color must be red, green and blue, got {shown(info.color)}")
        for place, part in enumerate(info.color):
            check_integer(f"{each}.color[{place}]", part, 0, 255)
        if key in names:
            twice = names[key], info.name
            raise ValueError(f"classes must have names that differ beyond case, got {twice}")
        names[key] = info.name
    return tuple(classes)


def find_sky(classes: Sequence[ClassInfo]) -> int | None:
    """Return the id of the class "sky", in upper or lower case; None if there is no such class."""
    return next((i for i, info in enumerate(classes) if info.name.lower() == "sky"), None)


def _take(document: Any, key: str, kind: Any = object) -> Any:
    """Return the value of a key. Raises ValueError if it is missing or has another type."""
    if not isinstance(document, dict) or key not in document:
        raise ValueError(f"it lacks the key {key!r}")
    if not isinstance(value := document[key], kind):
        raise ValueError(f"{key} must be {getattr(kind, '__name__', kind)}, found {shown(value)}")
    return value


def _optional(document: Any, key: str, check: Callable[[object, str], _Checked]) -> _Checked | None:
    """Return the checked value of a key, or None if it is null."""
    value = _take(document, key)
    return None if value is None else check(value, key)


def _check_giga_macs(value: object, name: str) -> float:
    return check_number(name, value, 0, MAX_GIGA_MACS, "billions")


def _texts(versions: dict[str, Any]) -> dict[str, str]:
    return {name: _take(versions, name, str) for name in versions}


def _class(entry: Any) -> ClassInfo:
    return ClassInfo(_take(entry, "name"), tuple(_take(entry, "color", list)))


def _content(entry: Any) -> ModelContent:
    return ModelContent(
        check_integer("content.bytes", _take(entry, "bytes"), 0), _take(entry, "sha256", str)
    )


def _with_digest(before: str) -> str:
    digest = hashlib.sha256(before.encode()).hexdigest()
    return f'{before}, "{_DIGEST_KEY}": "{digest}"}}'
