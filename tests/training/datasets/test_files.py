"""Labels and masks: the numbers that a PNG stores, however it stores them."""

import re
import struct
import zlib

import cv2
import numpy as np
import pytest

from runtime.base.errors import DatasetError
from training.datasets.files import read_gray

GREY, COLOR, PALETTE = 0, 2, 3
IDS = np.arange(5 * 9).reshape(5, 9)


def png(path, values, *, bits, color=GREY, colors=None, more=b""):
    """Write values (H, W), or bytes (H, W, 3), as a PNG without a library."""

    def chunk(kind, data):
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    height, width = values.shape[:2]
    places = np.arange(bits - 1, -1, -1)
    rows = np.packbits((values.reshape(height, -1, 1) >> places & 1).reshape(height, -1), axis=1)
    pixels = b"".join(b"\0" + row.tobytes() for row in rows)
    content = b"\x89PNG\r\n\x1a\n" + chunk(
        b"IHDR", struct.pack(">IIBBBBB", width, height, bits, color, 0, 0, 0)
    )
    if colors is not None:
        content += chunk(b"PLTE", np.asarray(colors, np.uint8).tobytes()) + more
    path.write_bytes(content + chunk(b"IDAT", zlib.compress(pixels)) + chunk(b"IEND", b""))
    return path


VOC = np.random.default_rng(0).integers(256, size=(256, 3))
RAMP = np.arange(256)[:, None].repeat(3, 1)
CLEAR = struct.pack(">I4sHI", 2, b"tRNS", 0, zlib.crc32(b"tRNS\0\0"))  # also of a grey PNG


@pytest.mark.parametrize("bits", [1, 2, 4, 8, 16])
def test_grey_of_any_depth_is_read_as_stored(tmp_path, bits):
    ids = IDS % 2 ** min(bits, 8)
    read = read_gray(png(tmp_path / "a.png", ids, bits=bits), np.uint8, IDS.shape)
    assert read.dtype == np.uint8
    np.testing.assert_array_equal(read, ids)


@pytest.mark.parametrize("bits", [1, 2, 4, 8])
@pytest.mark.parametrize(
    ("colors", "more"), [(VOC, b""), (VOC, CLEAR), (RAMP, b"")], ids=["VOC", "clear", "ramp"]
)
def test_a_palette_is_read_as_its_indices(tmp_path, bits, colors, more):
    ids = IDS % 2**bits
    path = png(
        tmp_path / "a.png", ids, bits=bits, color=PALETTE, colors=colors[: 2**bits], more=more
    )
    np.testing.assert_array_equal(read_gray(path, np.uint8, IDS.shape), ids)


@pytest.mark.parametrize(("make", "message"), [
    (
        lambda path: png(path, IDS % 2, bits=1, color=PALETTE, colors=[[0] * 3, [255] * 3]),
        "palette is of grays that are not its indices.*convert it to 8-bit gray",
    ),
    (lambda path: png(path, IDS + 256, bits=16), "expected one channel of uint8, or a palette"),
    (
        lambda path: png(path, np.zeros((5, 9, 3), int), bits=8, color=COLOR),
        "expected one channel of uint8, or a palette",
    ),
    (
        lambda path: path.write_bytes(cv2.imencode(".jpg", np.uint8(IDS))[1].tobytes()),
        "expected one channel of uint8.*in a PNG",
    ),
    (
        lambda path: path.write_bytes(
            png(path, IDS, bits=8, color=PALETTE, colors=VOC).read_bytes()[:-20]
        ),
        "truncated or damaged",
    ),
    (lambda path: png(path, IDS.T, bits=8), "its size 9x5 differs from the frame's 5x9"),
])  # fmt: skip
def test_other_labels_are_refused(tmp_path, make, message):
    path = tmp_path / "a.png"
    make(path)
    with pytest.raises(DatasetError, match=re.compile(message, re.DOTALL)):
        read_gray(path, np.uint8, IDS.shape)


def test_disparities_have_16_bits(tmp_path):
    path = png(tmp_path / "a.png", IDS + 256, bits=16)
    np.testing.assert_array_equal(read_gray(path, np.uint16, IDS.shape), IDS + 256)
    with pytest.raises(DatasetError, match="expected one channel of uint16"):
        read_gray(png(path, IDS, bits=8), np.uint16, IDS.shape)
