"""The size of an image from its header, before its pixels take memory."""

import re
import struct

_PNG_START = b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR"
_JPEG_START = b"\xff\xd8"
# Codes of JPEG markers (ITU-T T.81, table B.1); a marker is 0xFF and its code.
_MARKER = re.compile(rb"\xff([^\x00\xff])")
_START_OF_FRAME = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_NO_SEGMENT = frozenset({0x01, *range(0xD0, 0xD8)})
_MAX_SEGMENTS = 1000  # before the size; a colour profile takes up to 255


def image_size(content: bytes) -> tuple[int, int] | None:
    """(height, width) from the header of a PNG or JPEG file; None for any other content.

    It is read where OpenCV's decoders (libpng, libjpeg) read it.
    """
    try:
        if content.startswith(_PNG_START):
            width, height = struct.unpack_from(">II", content, len(_PNG_START))
            return height, width
        if content.startswith(_JPEG_START):
            return _jpeg_size(content)
    except struct.error:  # truncated
        pass
    return None


def _jpeg_size(content: bytes) -> tuple[int, int] | None:
    position = len(_JPEG_START)
    for _ in range(_MAX_SEGMENTS):
        marker = _MARKER.search(content, position)
        if marker is None:
            return None
        position = marker.end()
        if marker[1][0] in _START_OF_FRAME:
            _length, _precision, height, width = struct.unpack_from(">HBHH", content, position)
            return height, width
        if marker[1][0] not in _NO_SEGMENT:
            position += struct.unpack_from(">H", content, position)[0]
    return None
