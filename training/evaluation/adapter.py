"""How `ssdnet-eval` reads a network of others: a TOML file beside its ONNX file.

The keys are the fields of `Adapter`. Keys that are left out are read from the ONNX file.
"""

import ast
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from models import CLASS_TABLES
from runtime.base.errors import InputError
from runtime.contract.contract import MAX_CLASSES, MAX_FOCAL_PX, MAX_NAME_LENGTH, MIN_FOCAL_PX
from runtime.engine.example_inputs import make_feeds
from runtime.files.read_input import read_toml
from training.base.limits import STRICT, Positive, Side
from training.base.tables import build
from training.datasets.class_mapping import TableName, list_classes, named_table
from training.scores.metrics import FARTHEST_M

Channels = tuple[float, float, float]
# Mean and standard deviation of RGB in 0..255, by name.
NORMALIZATIONS: Mapping[str, tuple[Channels, Channels]] = {
    "none": ((0, 0, 0), (1, 1, 1)),
    "0..1": ((0, 0, 0), (255, 255, 255)),
    "-1..1": ((127.5, 127.5, 127.5), (127.5, 127.5, 127.5)),
    "imagenet": ((123.675, 116.28, 103.53), (58.395, 57.12, 57.375)),
}
_Name = Annotated[str, Field(min_length=1, max_length=MAX_NAME_LENGTH)]
# Size of free axes when a network is run to see its outputs [px].
_PROBED = (256, 512)
_PLANES = 4  # axes of an image or of scores: batch, channels, rows, columns


class MissingAdapterError(InputError):
    """A network of others has no adapter; `text` is one that was filled in from its file."""

    def __init__(self, message: str, text: str) -> None:
        super().__init__(message)
        self.text = text


@dataclass(frozen=True, config=STRICT)
class Normalize:
    """Mean and standard deviation of the channels in 0..255, red first."""

    mean: Channels
    std: tuple[Positive, Positive, Positive]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Adapter:
    """What the inputs and outputs of a network of others mean.

    Attributes:
        rgb: name of the image's input; None: the only input, or the one with three channels.
        layout: order of the image's axes; None: read from the axis with three channels.
        channels: order of the channels.
        normalize: how the pixels are scaled; "none" leaves 0..255.
        size: (height, width) or rows to which frames are resized; None: the size of the file's
            input, or --size.
        fit: how a frame is fitted to a fixed size: resized on both sides, or in its own aspect with
            grey around it.
        stride: multiple to which frames of a free size are padded at the bottom and right.
        sparse_depth: name of the input of LiDAR depth, 0 = none; None: there is no such input.
        sparse_depth_scale: units per metre of that input.
        semantic: name of the output of the classes; None: there is none.
        semantic_is: "scores", with a plane for each class, or "ids"; None: its shape decides.
        classes: names of the classes in the order of their ids, or the name of a table in
            `models.CLASS_TABLES`.
        class_stride: stride of the grid on which classes are decided and then repeated; None:
            scores are interpolated to the frame's pixels.
        depth: name of the output of the depth; None: there is none.
        depth_is: whether it is depth along the optical axis, or its inverse.
        depth_scale: its units per metre, or per 1/m if it is inverse depth.
        max_depth_m: range to which returns are clipped [m].
        canonical_focal_px: focal length [px] of the camera in whose metres the network works, see
            `runtime.contract.canonical_focal`; None: plain metres.
    """

    rgb: _Name | None = None
    layout: Literal["NCHW", "NHWC"] | None = None
    channels: Literal["RGB", "BGR"] = "RGB"
    normalize: Literal["none", "0..1", "-1..1", "imagenet"] | Normalize = "none"
    size: tuple[Side, Side] | Side | None = None
    fit: Literal["stretch", "pad"] = "stretch"
    stride: Annotated[int, Field(ge=1, le=1024)] = 1
    sparse_depth: _Name | None = None
    sparse_depth_scale: Positive = 1.0
    semantic: _Name | None = None
    semantic_is: Literal["scores", "ids"] | None = None
    classes: TableName | Annotated[tuple[_Name, ...], Field(max_length=MAX_CLASSES)] = ()
    class_stride: Annotated[int, Field(ge=1, le=64)] | None = None
    depth: _Name | None = None
    depth_is: Literal["depth", "inverse"] = "depth"
    depth_scale: Positive = 1.0
    max_depth_m: Positive = FARTHEST_M
    canonical_focal_px: Annotated[float, Field(ge=MIN_FOCAL_PX, le=MAX_FOCAL_PX)] | None = None

    def __post_init__(self) -> None:
        """Check that there is an output, and that its classes have names."""
        if self.semantic is None and self.depth is None:
            raise ValueError("semantic and depth: name the output of one of them, or of both")
        if self.semantic is not None and not self.classes:
            raise ValueError('classes: name them in the order of ids, or a table ("cityscapes")')

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the classes."""
        return tuple(info.name for info in list_classes(named_table(self.classes)))

    @property
    def color_scale(self) -> tuple[Channels, Channels]:
        """Mean and standard deviation of RGB in 0..255."""
        if isinstance(self.normalize, str):
            return NORMALIZATIONS[self.normalize]
        return self.normalize.mean, self.normalize.std


def read_adapter(path: Path) -> Adapter:
    """Read an adapter. Raises InputError for another kind of file, and a wrong key or value."""
    table = read_toml(path)
    try:
        return build(Adapter, table)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def channel_axis(shape: Sequence[Any]) -> int | None:
    """Return the axis of an image's three channels, 1 or 3; None if it is not certain."""
    axes = [at for at in (1, 3) if len(shape) == _PLANES and shape[at] == 3]
    return axes[0] if len(axes) == 1 else None


def find_rgb(session: Any) -> Any:
    """Return the input of the image: the only input, or the first with three channels."""
    inputs = session.get_inputs()
    found = [item for item in inputs if channel_axis(item.shape) is not None]
    return found[0] if found and len(inputs) > 1 else inputs[0]


def describe_network(path: Path, session: Any) -> str:
    """Return an adapter as TOML, filled in from the ONNX file as far as possible; guesses say so.

    Args:
        path: path of the file.
        session: session of ONNX Runtime.
    """
    return "\n".join((*_describe(path, session), ""))


def _describe(path: Path, session: Any) -> Iterator[str]:
    facts = session.get_modelmeta().custom_metadata_map
    rgb = find_rgb(session)
    axis = channel_axis(rgb.shape)
    is_bytes = rgb.type == "tensor(uint8)"
    yield f"# How ssdnet-eval feeds and reads {path.name}. Check the lines that say so."
    yield f"rgb = {_toml(rgb.name)}  # {_shape(rgb)}"
    note = "" if axis else "  # guessed: check"
    yield f"layout = {_toml('NHWC' if axis == 3 else 'NCHW')}{note}"
    yield 'channels = "RGB"  # guessed: check; or "BGR"'
    if is_bytes:
        yield 'normalize = "none"  # the file takes bytes'
    else:
        guess = "0..1" if "imgsz" in facts or "names" in facts else "imagenet"
        known = ", ".join(_toml(name) for name in NORMALIZATIONS)
        yield f"normalize = {_toml(guess)}  # guessed: check; one of {known},"
        yield "#   or { mean = [123.7, 116.3, 103.5], std = [58.4, 57.1, 57.4] } in 0..255"
    rows, columns = (rgb.shape[at] for at in ((1, 2) if axis == 3 else (2, 3)))
    if isinstance(rows, int) and isinstance(columns, int):
        fit = "pad" if "imgsz" in facts else "stretch"
        yield f'fit = {_toml(fit)}  # to {rows} x {columns}; guessed: check; "stretch" or "pad"'
    else:
        yield "# size = 512  # rows, or [rows, columns]; --size by default"
        yield f"stride = {facts.get('stride', '32')}  # sides are padded to a multiple; check"
    for item in session.get_inputs():
        if item.name != rgb.name:
            yield f"sparse_depth = {_toml(item.name)}  # {_shape(item)}; guessed: check; in metres"
    yield from _describe_outputs(session, facts)


def _describe_outputs(session: Any, facts: Mapping[str, str]) -> Iterator[str]:
    known = _class_names(facts)
    heads: dict[str, str] = {}
    for item, values in zip(session.get_outputs(), _probe(session), strict=True):
        shape = item.shape if values is None else values.shape
        axes = [side for side in shape[1:] if side != 1]
        is_float = item.type in ("tensor(float)", "tensor(float16)", "tensor(double)")
        kind = "semantic" if len(axes) == _PLANES - 1 or not is_float else "depth"
        text = f"{kind} = {_toml(item.name)}  # {_shape(item)}; guessed: check"
        if len(axes) not in (_PLANES - 2, _PLANES - 1) or kind in heads:
            yield f"# an output that is not read: {item.name}  # {_shape(item)}"
            continue
        heads[kind] = item.name
        yield text
        if kind == "depth":
            yield 'depth_is = "depth"  # guessed: check; or "inverse"'
            yield "depth_scale = 1.0  # units per metre, or per 1/m; guessed: check"
            continue
        planes = [side for side in (shape[1], shape[-1]) if isinstance(side, int)]
        counts = planes if len(axes) == _PLANES - 1 else [len(known)]
        tables = [name for name, table in CLASS_TABLES.items() if len(table) in counts]
        if known and not all(name.isdigit() for name in known):  # numbers are no names
            yield f"classes = {json.dumps(known, ensure_ascii=False)}"
        elif tables:
            yield f"classes = {_toml(tables[0])}  # guessed by their number: check"
        else:
            tables = list(CLASS_TABLES)
            yield f"classes = []  # FILL IN: names in the order of ids, or one of {tables}"


def _class_names(facts: Mapping[str, str]) -> list[str]:
    """Return the names that exporters of YOLO store, "{0: 'road', ...}"; [] if there are none."""
    try:
        names = ast.literal_eval(facts.get("names", ""))
    except (ValueError, SyntaxError):
        return []
    if isinstance(names, dict):
        names = [names[key] for key in sorted(names)]
    return [str(name) for name in names] if isinstance(names, list) else []


def _probe(session: Any) -> list[np.ndarray | None]:
    """Return what the network returns for noise; if it refuses the noise, None for each output."""
    try:
        feeds, _ = make_feeds(session.get_inputs(), size=_PROBED, batch=1)
        return list(session.run(None, feeds))
    except Exception:  # an input cannot be made, or the network refuses its size
        return [None] * len(session.get_outputs())


def _shape(item: Any) -> str:
    return f"{item.type.removeprefix('tensor(').rstrip(')')} {list(item.shape)}"


def _toml(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
