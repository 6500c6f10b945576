"""How `ssdnet-eval` reads a network of others: a TOML file beside its ONNX file.

The keys are the fields of `Adapter`. Keys that are left out are read from the ONNX file.
"""

import ast
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from models import CLASS_TABLES
from runtime.base.arguments import shown
from runtime.base.arrays import Size
from runtime.base.errors import InputError
from runtime.contract.contract import (
    MAX_CLASSES,
    MAX_FOCAL_PX,
    MAX_NAME_LENGTH,
    MIN_FOCAL_PX,
    MIN_SIDE,
)
from runtime.engine.example_inputs import make_feeds
from runtime.files.read_input import read_toml
from training.base.limits import STRICT, Positive, Side
from training.base.tables import build, quoted
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
MAX_STRIDE = 1024
_Name = Annotated[str, Field(min_length=1, max_length=MAX_NAME_LENGTH)]
# Size of free axes when a network is run to see its outputs [px].
_PROBED = (256, 512)
_PLANES = 4  # axes of an image or of scores: batch, channels, rows, columns
IMAGE_TYPES = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(uint8)": np.uint8,
}
# For keys that say what an input or output means: the key that names it.
_NEEDS = {
    **dict.fromkeys(("semantic_is", "classes", "class_stride"), "semantic"),
    **dict.fromkeys(("depth_is", "depth_scale"), "depth"),
    "sparse_depth_scale": "sparse_depth",
}
ONE_PLANE = (
    "one plane decides between a class and the rest, by a threshold that only its author knows: "
    "export the decision as ids, 0 and 1, and name both classes"
)


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
    stride: Annotated[int, Field(ge=1, le=MAX_STRIDE)] = 1
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
        for key, needed in _NEEDS.items():
            if getattr(self, needed) is None and getattr(self, key) != getattr(type(self), key):
                raise ValueError(f"{key}: has no use without {needed}: leave it out")
        if self.semantic_is == "scores" and len(self.names) == 1:
            raise ValueError(f"semantic_is: {ONE_PLANE}")

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
    return build(Adapter, read_toml(path), f"{path}: ")


def channel_axis(shape: Sequence[Any]) -> int | None:
    """Return the axis of an image's three channels, 1 or 3; None if it is not certain."""
    axes = [at for at in (1, 3) if len(shape) == _PLANES and shape[at] == 3]
    return axes[0] if len(axes) == 1 else None


def find_rgb(path: Path, session: Any, name: str | None = None) -> Any:
    """Return the input of the image: of this name, the only one, or that with three channels.

    Raises:
        InputError: if the file takes anything but one image and, if at all, a depth map.
    """
    inputs = session.get_inputs()
    listed = ", ".join(f"{shown(item.name)}: {_shape(item)}" for item in inputs)
    if not 1 <= len(inputs) <= 2:
        raise InputError(
            f"{path}: has {len(inputs)} inputs ({listed or 'none'}); expected an image and, if at "
            "all, LiDAR depth: give a network of images"
        )
    named = [item for item in inputs if item.name == name]
    rgb = (named or [i for i in inputs if channel_axis(i.shape) is not None] or inputs)[0]
    what = f"{path}: its input {rgb.name!r} is {_shape(rgb)}; expected"
    if len(rgb.shape) != _PLANES or rgb.type not in IMAGE_TYPES:
        kinds = ", ".join(kind.removeprefix("tensor(").rstrip(")") for kind in IMAGE_TYPES)
        raise InputError(f"{what} an image of four axes, of {kinds}: give a network of images")
    if isinstance(rgb.shape[0], int) and rgb.shape[0] != 1:
        raise InputError(f"{what} one image: export it with a batch of 1, or of any size")
    fixed = [side for side in (rgb.shape[1], rgb.shape[3]) if isinstance(side, int)]
    if 3 not in fixed and (len(fixed) == 2 or min(fixed, default=MIN_SIDE) < MIN_SIDE):
        raise InputError(f"{what} three channels, RGB: give a network of colour images")
    return rgb


def fits(grid: Sequence[int], image: Sequence[int]) -> bool:
    """Whether (height, width) is a grid of an image: its aspect, but for an incomplete cell."""
    return abs(grid[0] * image[1] - grid[1] * image[0]) <= max(image)


def describe_network(path: Path, session: Any) -> str:
    """Return an adapter as TOML, filled in from the ONNX file as far as possible; guesses say so.

    Args:
        path: path of the file.
        session: session of ONNX Runtime.

    Raises:
        InputError: in the cases of `find_rgb`, and if no output is a map of the image.
    """
    return "\n".join((*_describe(path, session), ""))


def _describe(path: Path, session: Any) -> Iterator[str]:
    facts = session.get_modelmeta().custom_metadata_map
    rgb = find_rgb(path, session)
    axis = channel_axis(rgb.shape)
    is_bytes = rgb.type == "tensor(uint8)"
    yield f"# How ssdnet-eval feeds and reads {shown(path.name)}. Check the lines that say so."
    yield f"rgb = {quoted(rgb.name)}  # {_shape(rgb)}"
    note = "" if axis else "  # guessed: check"
    yield f"layout = {quoted('NHWC' if axis == 3 else 'NCHW')}{note}"
    yield 'channels = "RGB"  # guessed: check; or "BGR"'
    if is_bytes:
        yield 'normalize = "none"  # the file takes bytes'
    else:
        guess = "0..1" if "imgsz" in facts or "names" in facts else "imagenet"
        known = ", ".join(quoted(name) for name in NORMALIZATIONS)
        yield f"normalize = {quoted(guess)}  # guessed: check; one of {known},"
        yield "#   or { mean = [123.7, 116.3, 103.5], std = [58.4, 57.1, 57.4] } in 0..255"
    rows, columns = (rgb.shape[at] for at in ((1, 2) if axis == 3 else (2, 3)))
    if isinstance(rows, int) and isinstance(columns, int):
        fit = "pad" if "imgsz" in facts else "stretch"
        yield f'fit = {quoted(fit)}  # to {rows} x {columns}; guessed: check; "stretch" or "pad"'
    else:
        stride = facts.get("stride", "")
        stride = stride if stride.isdecimal() and 1 <= int(stride) <= MAX_STRIDE else "32"
        yield "# size = 512  # rows, or [rows, columns]; --size by default"
        yield f"stride = {stride}  # sides are padded to a multiple; check"
    for item in session.get_inputs():
        if item.name != rgb.name:
            yield f"sparse_depth = {quoted(item.name)}  # {_shape(item)}; guessed: check; in metres"
    yield from _describe_outputs(path, session, rgb, facts)


def _describe_outputs(
    path: Path, session: Any, rgb: Any, facts: Mapping[str, str]
) -> Iterator[str]:
    known = _class_names(facts)
    heads: dict[str, str] = {}
    image, outputs = _probe(session, rgb)
    for item, values in zip(session.get_outputs(), outputs, strict=True):
        shape = item.shape if values is None else values.shape
        axes = [side for side in shape[1:] if side != 1]
        is_float = item.type in ("tensor(float)", "tensor(float16)", "tensor(double)")
        kind = "semantic" if len(axes) == _PLANES - 1 or not is_float else "depth"
        is_map = len(axes) in (_PLANES - 2, _PLANES - 1) and (
            values is None or fits(axes[-2:], image) or fits(axes[:2], image)
        )
        if not is_map or kind in heads:
            yield f"# an output that is not read: {shown(item.name)}  # {_shape(item)}"
            continue
        heads[kind] = item.name
        yield f"{kind} = {quoted(item.name)}  # {_shape(item)}; guessed: check"
        if kind == "depth":
            yield 'depth_is = "depth"  # guessed: check; or "inverse"'
            yield "depth_scale = 1.0  # units per metre, or per 1/m; guessed: check"
            continue
        planes = [side for side in (shape[1], shape[-1]) if isinstance(side, int)]
        counts = planes if len(axes) == _PLANES - 1 else [len(known)]
        tables = [name for name, table in CLASS_TABLES.items() if len(table) in counts]
        if known and not all(name.isdigit() for name in known):  # numbers are no names
            note = "" if len(known) in counts else f"  # {len(known)} names, not {planes[0]}: check"
            yield f"classes = {quoted(known)}{note}"
        elif tables:
            yield f"classes = {quoted(tables[0])}  # guessed by their number: check"
        else:
            tables = list(CLASS_TABLES)
            yield f"classes = []  # FILL IN: names in the order of ids, or one of {tables}"
    if not heads:
        listed = ", ".join(f"{shown(i.name)}: {_shape(i)}" for i in session.get_outputs())
        raise InputError(
            f"{path}: none of its outputs is a map of the image ({listed}): export class scores "
            "(1, classes, rows, columns), ids or depth (1, rows, columns)"
        )


def _class_names(facts: Mapping[str, str]) -> list[str]:
    """Return the names that exporters of YOLO store, "{0: 'road', ...}"; [] if there are none.

    Keys may be text, and are sorted as numbers. Names of other ids than 0, 1, ... are not used.
    """
    try:
        names = ast.literal_eval(facts.get("names", ""))
        if isinstance(names, dict):
            by_id = {int(key): name for key, name in names.items()}
            names = [by_id[index] for index in range(len(names))]
    except (ValueError, SyntaxError, TypeError, KeyError, MemoryError, RecursionError):
        return []
    listed = [str(name) for name in names] if isinstance(names, list) else []
    return listed if all(0 < len(name) <= MAX_NAME_LENGTH for name in listed) else []


def _probe(session: Any, rgb: Any) -> tuple[Size, list[NDArray[Any] | None]]:
    """Return the size of an image of noise, and what the network answers to it.

    What is no array of numbers is None, and all are None if the network refuses the noise.
    """
    try:
        feeds, _ = make_feeds(session.get_inputs(), size=_PROBED, batch=1)
        found = session.run(None, feeds)
    except Exception:  # an input cannot be made, or the network refuses its size
        return _PROBED, [None] * len(session.get_outputs())
    sides = [side for at, side in enumerate(feeds[rgb.name].shape) if at != channel_axis(rgb.shape)]
    arrays = [values if isinstance(values, np.ndarray) else None for values in found]
    return (sides[-2], sides[-1]), arrays


def _shape(item: Any) -> str:
    return f"{item.type.removeprefix('tensor(').rstrip(')')} {list(item.shape)}"
