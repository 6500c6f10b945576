"""Inputs for any ONNX model, to measure how fast it runs and to see what it answers."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.base.arguments import shown
from runtime.base.arrays import Size
from runtime.base.errors import InputError

Feeds = Mapping[str, NDArray[Any]]

_DTYPES = {
    "tensor(float)": "float32",
    "tensor(double)": "float64",
    **{f"tensor({name})": name for name in ("float16", "uint8", "int32", "int64", "bool")},
}
# Names that free axes may have.
_NAMES = {"C": "c|.*channels?", "H": "h|rows|.*height", "W": "w|columns|.*width"}


def make_feeds(inputs: Sequence[Any], *, size: Size, batch: int) -> tuple[Feeds, tuple[str, ...]]:
    """Fill a session's inputs; return them, and what of `size` and `batch` no input takes.

    Raises InputError.

    Free axes are the batch, height, width and 3 channels, see `_free_axes`; other axes are fixed.
    The name of an axis has the same meaning in all inputs.
    """
    feeds, takes_size, takes_batch = {}, False, batch == 1
    sides = {"N": batch, "C": 3, "H": size[0], "W": size[1]}
    roles = {item.shape[at]: role for item in inputs for role, at in _free_axes(item.shape).items()}
    for item in inputs:
        named = {roles[side]: at for at, side in enumerate(item.shape) if side and side in roles}
        axes, shape = named | _free_axes(item.shape), list(item.shape)
        for role, at in axes.items():
            shape[at] = sides[role]
        if unknown := [side for side in shape if not isinstance(side, int)]:
            raise InputError(
                f"the input {shown(item.name)}: whether {shown(unknown[0])} of {list(item.shape)} "
                "is height, width or else is not certain; fix that axis, or name it H, W or C"
            )
        takes_batch |= "N" in axes
        takes_size |= bool(axes.keys() & {"H", "W"}) and {*size} <= {*shape}
        feeds[item.name] = make_input(item.name, item.type, shape)
    notes = {"its own size": takes_size, "its own batch": takes_batch}
    return feeds, tuple(note for note, taken in notes.items() if not taken)


def _free_axes(shape: Sequence[Any]) -> dict[str, int]:
    """Return the axes N, C, H and W of an input that are free, as far as they are certain.

    H, W and C are recognised by their names. If there are no such names, the first axis is N, and H
    and W are two neighbouring axes of four whose other axis, the channels, is fixed.
    """
    free = [at for at, side in enumerate(shape) if not isinstance(side, int)]
    axes = {
        role: at
        for role, pattern in _NAMES.items()
        for at in free
        if re.fullmatch(pattern, str(shape[at]), re.IGNORECASE)
    }
    rest = [at for at in free if at not in axes.values()]
    if rest[:1] == [0]:
        axes["N"] = rest.pop(0)
    if len(shape) == 4 and rest in ([1, 2], [2, 3]):
        axes |= dict(zip("HW", rest, strict=True))
    return axes


def make_input(name: str, element: str, shape: Sequence[int]) -> NDArray[Any]:
    """Fill an input of an ONNX Runtime type such as "tensor(float)".

    Bytes and floats are noise, and 5 % of the pixels of `sparse_depth` are returns. Other integers,
    which may be indices, are 0; booleans, which may be masks, are True.

    Raises:
        InputError: if the input is anything but a tensor of numbers.
    """
    if element not in _DTYPES:
        raise InputError(f"the input {shown(name)} is {element}: expected a tensor of numbers")
    dtype = np.dtype(_DTYPES[element])
    rng = np.random.default_rng(0)
    if dtype == np.uint8:
        return rng.integers(0, 256, shape, dtype=np.uint8)
    if dtype.kind != "f":
        return np.full(shape, dtype.kind == "b", dtype)
    noise = rng.random(shape, dtype=np.float32)
    if name == "sparse_depth":
        noise = np.where(rng.random(shape, dtype=np.float32) < 0.05, 80 * noise, 0)
    return noise.astype(dtype)
