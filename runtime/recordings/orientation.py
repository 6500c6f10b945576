"""By how much a picture's header turns it. Pixels stay as stored, where depth and lens are."""

import contextlib
import struct

from runtime.geometry.assumptions import assume

_ORIENTATION = 0x0112  # tag of EXIF (CIPA DC-008)
#: Orientation of EXIF -> how viewers turn the picture; 1 = not at all.
_TURNS = {
    2: "mirrors them",
    3: "turns them by 180 degrees",
    4: "mirrors them",
    5: "turns and mirrors them",
    6: "turns them by 90 degrees",
    7: "turns and mirrors them",
    8: "turns them by 270 degrees",
}
_HEADER_BYTES = 1 << 17  # in which EXIF is looked for


def check_turn(turned: str, what: str) -> None:
    """Say that a header turns pictures, which are used as they are stored; "" = it does not.

    Args:
        turned: how, as "turns them by 180 degrees".
        what: the header, as "EXIF of the images".
    """
    if turned:
        assume(
            f"images are upright as they are stored, although the {what} {turned}",
            "if they are not, turn the pixels by ffmpeg or mogrify -auto-orient, with depth maps "
            "and calibration",
        )


def check_exif(content: bytes) -> None:
    """Say what the EXIF of a JPEG or PNG file turns, see `check_turn`."""
    start = content.find(b"Exif\0\0", 0, _HEADER_BYTES) + 6
    if content.startswith(b"\x89PNG"):
        start = content.find(b"eXIf", 0, _HEADER_BYTES) + 4
    if start < 6:
        return
    orders = {b"II*\0": "<", b"MM\0*": ">"}
    if (order := orders.get(content[start : start + 4])) is None:
        return
    with contextlib.suppress(struct.error):  # truncated
        at = start + struct.unpack_from(f"{order}I", content, start + 4)[0]
        for entry in range(struct.unpack_from(f"{order}H", content, at)[0]):
            tag, _, _, value = struct.unpack_from(f"{order}HHIH", content, at + 2 + 12 * entry)
            if tag == _ORIENTATION:
                check_turn(_TURNS.get(value, ""), "EXIF of the images")
                return
