"""The size in a header is the size of the decoded picture."""

import cv2
import numpy as np
import pytest

from runtime.io.images import image_size


def encode(suffix, shape, dtype=np.uint8, *options):
    image = np.random.default_rng(0).integers(0, 255, shape).astype(dtype)
    return cv2.imencode(suffix, image, options)[1].tobytes()


HUFFMAN_TABLE = b"\xff\xc4\x00\x14\x00\x01" + bytes(16)  # of one code


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
@pytest.mark.parametrize("size", [(1, 1), (37, 1242), (300, 2)])
@pytest.mark.parametrize("channels", [(), (3,)])
def test_of_what_opencv_writes(suffix, size, channels):
    assert image_size(encode(suffix, size + channels)) == size


def test_of_other_pngs_and_jpegs():
    assert image_size(encode(".png", (20, 30), np.uint16)) == (20, 30)
    assert image_size(encode(".png", (20, 30, 4))) == (20, 30)
    progressive = (cv2.IMWRITE_JPEG_PROGRESSIVE, 1, cv2.IMWRITE_JPEG_RST_INTERVAL, 1)
    assert image_size(encode(".jpg", (20, 30, 3), np.uint8, *progressive)) == (20, 30)


@pytest.mark.parametrize(
    "between",
    [
        b"\xff\xe1\x00\x0a" + b"\xff\xc0\xff\xd8\xff\xd9ab",  # a thumbnail's markers in its segment
        b"\xff" * 9,
        b"extraneous \xff\x00 bytes",
        b"\xff\x01\xff\xd3",
        b"\xff\xfe\x00\x02" * 300,
        HUFFMAN_TABLE,
    ],
    ids=[
        *("markers in a segment", "fill", "garbage", "markers without a segment", "comments"),
        "a table whose marker is among those of frames",
    ],
)
def test_a_jpeg_is_read_as_the_decoder_reads_it(between):
    whole = encode(".jpg", (20, 30, 3))
    content = whole[:20] + between + whole[20:]  # after the segment that says JFIF
    assert cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR).shape == (20, 30, 3)
    assert image_size(content) == (20, 30)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_of_the_beginning_of_a_file(suffix):
    """Either the size or none, wherever the file ends."""
    whole = encode(suffix, (20, 30, 3))
    sizes = [image_size(whole[:length]) for length in range(len(whole) + 1)]
    known = sizes.index((20, 30))
    assert sizes[:known] == [None] * known
    assert set(sizes[known:]) == {(20, 30)}


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"BM" + bytes(100),
        b"\x89PNG\r\n\x1a\n\x00\x00\x00\x04IDAT" + bytes(100),
        b"\xff\xd8" + b"\xff\xfe\x00\x02" * 1001 + encode(".jpg", (20, 30, 3))[2:],
    ],
    ids=["empty", "BMP", "no IHDR", "more comments than any picture has"],
)
def test_of_what_is_not_read(content):
    assert image_size(content) is None
