"""How a picture's header turns it. Pixels stay as they are stored, like the depth and the lens."""

import contextlib
import struct

from runtime.geometry.assumptions import assume

_ORIENTATION = 0x0112  # tag of EXIF (CIPA DC-008)
# How viewers turn the picture for each EXIF orientation; 1 does not turn it.
_TURNS = {
    2: "mirrors them",
    3: "turns them by 180 degrees",
    4: "mirrors them",
    5: "turns and mirrors them",
    6: "turns them by 90 degrees",
    7: "turns and mirrors them",
    8: "turns them by 270 degrees",
}
_ORDERS = {b"II*\0": "<", b"MM\0*": ">"}
_HEADER_BYTES = 1 << 17  # EXIF is looked for in so many bytes


def check_turn(turned: str, what: str) -> None:
    """Report the assumption that a header turns pictures, which are used as they are stored.

    Args:
        turned: what the header does, such as "turns them by 180 degrees"; "" if it does nothing.
        what: name of the header, such as "EXIF of the images".
    """
    if turned:
        assume(
            f"pixels are upright as they are stored, although the {what} {turned}",
            "if they are not, turn the pixels by ffmpeg or mogrify -auto-orient, with depth maps "
            "and calibration",
        )


def check_exif(content: bytes, what: str) -> bytes:
    """Report how the EXIF of a JPEG or PNG, or the header of a TIFF, turns `what` it holds.

    Returns the content without the turn of a TIFF, which OpenCV would apply.
    """
    start = 0 if content[:4] in _ORDERS else content.find(b"Exif\0\0", 0, _HEADER_BYTES) + 6
    if content.startswith(b"\x89PNG"):
        start = content.find(b"eXIf", 0, _HEADER_BYTES) + 4
    order = _ORDERS.get(content[start : start + 4])
    if order is None or 0 < start < 6:  # not found
        return content
    with contextlib.suppress(struct.error):  # the content may be truncated
        at = start + struct.unpack_from(f"{order}I", content, start + 4)[0]
        for entry in range(struct.unpack_from(f"{order}H", content, at)[0]):
            tag, _, _, value = struct.unpack_from(f"{order}HHIH", content, at + 2 + 12 * entry)
            if tag == _ORIENTATION:
                check_turn(_TURNS.get(value, ""), f"{'EXIF' if start else 'header'} of the {what}")
                at += 2 + 12 * entry + 8
                upright = struct.pack(f"{order}H", 1)
                return content if start else content[:at] + upright + content[at + 2 :]
    return content
