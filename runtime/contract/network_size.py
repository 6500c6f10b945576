"""The size at which a network runs for a frame; engine and evaluation use the same rule."""

from typing import Any, Literal

from runtime.base.arguments import shown
from runtime.base.arrays import Size
from runtime.base.errors import InputError
from runtime.contract.contract import MAX_PIXELS, MAX_SIDE, MIN_SIDE, check_side, check_size

# None = about the trained height, "frame" = the frame's own size, a number of rows, or (height,
# width).
NetworkSize = Literal["frame"] | int | Size | None

# Frames of up to this multiple of the trained height run at their own size.
LARGEST_RATIO = 1.25


def check_network_size(requested: Any, *, fixed: bool) -> NetworkSize:
    """Return a requested size in plain integers.

    Args:
        requested: a `NetworkSize`.
        fixed: whether the model takes one size only.

    Raises:
        InputError: if `requested` is no `NetworkSize`, a side is out of range, or a size is
            requested from a model of fixed size.
    """
    if requested is None:
        return None
    if fixed:
        raise InputError(
            f"size = {shown(requested)}, but the model has a fixed size: leave size out, or export "
            "the model without a size"
        )
    if isinstance(requested, str) and requested == "frame":
        return "frame"
    try:
        return _in_range(requested)
    except ValueError as error:
        raise InputError(
            f'{error}: size is None (about the trained height), "frame" (the frame\'s own), a '
            "number of rows, or (height, width)"
        ) from error


def parse_network_size(text: str) -> NetworkSize:
    """Read a command line's "auto", "frame", ROWS or HEIGHTxWIDTH. Raises InputError."""
    if text in ("auto", "frame"):
        return None if text == "auto" else "frame"
    sides = text.lower().split("x")
    try:
        if not all(side.isdecimal() for side in sides) or len(sides) > 2:
            raise ValueError("neither a keyword nor a number of pixels")
        numbers = [int(side[:9]) for side in sides]  # nine digits are out of range already
        return _in_range(numbers[0] if len(numbers) == 1 else numbers)
    except ValueError as error:
        raise InputError(
            f"`size=` {shown(text)}: {error}; expected auto (about the trained height), frame (the "
            "frame's own), a number of rows such as 400, or HEIGHTxWIDTH such as 400x640"
        ) from error


def network_size(requested: NetworkSize, frame_size: Size, *, trained_height: int | None) -> Size:
    """Return the (height, width) at which a network runs for a frame.

    Args:
        requested: the size to use. None: `trained_height` rows, with the aspect kept, if the frame
            has over a quarter more rows; the frame's own size if it has fewer, or if the trained
            height is not known. "frame" = the frame's own size. An int = a number of rows, with the
            aspect kept. (height, width) = this size, also for a network of fixed size.
        frame_size: (height, width) of the frame.
        trained_height: rows of the images that the network was trained on; None: not known.

    Raises:
        InputError: if the rows would be too wide with the frame's aspect.
    """
    if isinstance(requested, tuple):
        return requested
    height, width = frame_size
    rows = requested
    if rows is None and trained_height is not None and height > LARGEST_RATIO * trained_height:
        rows = trained_height
    if rows is None or rows == "frame":
        return frame_size
    size = rows, max(MIN_SIDE, round(width * rows / height))
    if size[1] > MAX_SIDE or size[0] * size[1] > MAX_PIXELS:
        raise InputError(
            f"size = {rows} rows would be {size[0]} x {size[1]} pixels for a frame of {height} x "
            f"{width}; expected at most {MAX_SIDE} per side and {MAX_PIXELS} in total: use fewer "
            "rows"
        )
    return size


def _in_range(requested: Any) -> int | Size:
    """Return rows or (height, width) in plain integers; ValueError for anything else."""
    if isinstance(requested, tuple | list):
        return check_size(requested)
    return check_side(requested, "size")
