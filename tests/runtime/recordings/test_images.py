"""Files to arrays."""

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

import runtime.recordings.images
from runtime import InputError
from runtime.geometry.assumptions import AssumptionWarning
from runtime.recordings.images import decode_rgb, image_size, read_rgb, read_sparse_depth
from runtime.recordings.orientation import check_exif


def write(path: Path, image) -> Path:
    if path.suffix.lower() == ".npy":
        with path.open("wb") as file:
            np.save(file, image)
    else:
        assert cv2.imwrite(str(path), image)
    return path


def test_a_picture_is_read_red_first(tmp_path):
    bgr = np.zeros((40, 50, 3), np.uint8)
    bgr[:] = (10, 20, 200)
    assert (read_rgb(write(tmp_path / "a.png", bgr)) == (200, 20, 10)).all()
    from_jpeg = read_rgb(write(tmp_path / "a.jpg", bgr)).astype(int)
    assert abs(from_jpeg - (200, 20, 10)).max() < 4
    grey = bgr[..., 0]
    assert (read_rgb(write(tmp_path / "g.png", grey)) == grey[..., None]).all()


@pytest.mark.parametrize(("name", "scale"), [("d.png", 256), ("d.tif", 100), ("d.npy", 100)])
def test_depth_is_read_in_metres(tmp_path, name, scale):
    image = np.random.default_rng(0).integers(0, 65536, (40, 50), dtype=np.uint16)
    image[0, :3] = (0, 1, 65535)
    depth = read_sparse_depth(write(tmp_path / name, image), depth_scale=scale)
    assert depth.dtype == np.float32
    expected = np.where(image == 65535, np.nan, image.astype(np.float64) / scale)
    np.testing.assert_allclose(depth, expected, rtol=1e-7)
    assert depth[0, 0] == 0


@pytest.mark.parametrize(("name", "image", "read"), [
    ("d.png", np.zeros((40, 50), np.uint8), read_sparse_depth),
    ("d.tif", np.zeros((40, 50, 3), np.uint16), read_sparse_depth),
    ("d.npy", np.zeros((40, 50, 1), np.float32), read_sparse_depth),
    ("p.png", np.zeros((40, 50), np.uint16), read_rgb),
])  # fmt: skip
def test_other_types_are_refused(tmp_path, name, image, read):
    with pytest.raises(InputError, match=name):
        read(write(tmp_path / name, image))


@pytest.mark.parametrize(("name", "dtype"), [
    ("d.tif", "f4"), ("d.TIFF", "f8"), ("d.npy", "f4"), ("d.NPY", ">f8"), ("d.npy", "f2"),
])  # fmt: skip
def test_floats_are_metres(tmp_path, name, dtype):
    metres = np.random.default_rng(0).random((40, 50)).astype(dtype)
    metres[0, :3] = (0, np.nan, np.inf)
    depth = read_sparse_depth(write(tmp_path / name, metres), depth_scale=100)
    assert depth.dtype == np.dtype(np.float32)
    np.testing.assert_array_equal(depth, metres.astype(np.float32))


def test_an_array_of_more_than_its_file_is_refused(tmp_path):
    path = write(tmp_path / "d.npy", np.zeros((40, 50), np.float32))
    whole = path.read_bytes()
    for content in (whole[:-1], whole.replace(b"(40, 50), ", b"(-4, 50), "), b""):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"d\.npy"):
            read_sparse_depth(path)


@pytest.mark.parametrize("suffix", ["rgb.png", "rgb.jpg", "depth.png", "depth.tif"])
@pytest.mark.parametrize("kept", [0.0, 0.1, 0.99])
def test_truncated_files_are_refused(tmp_path, suffix, kept):
    random = np.random.default_rng(0)
    if suffix.startswith("depth"):
        image, read = random.integers(0, 9999, (40, 50), dtype=np.uint16), read_sparse_depth
    else:
        image, read = random.integers(0, 255, (40, 50, 3), dtype=np.uint8), read_rgb
    path = write(tmp_path / suffix, image)
    read(path)
    content = bytearray(path.read_bytes())
    path.write_bytes(content[: int(len(content) * kept)])
    with pytest.raises(InputError, match=suffix):
        read(path)
    if path.suffix == ".png":  # has a checksum
        content[len(content) // 2] ^= 0xFF
        path.write_bytes(content)
        with pytest.raises(InputError, match=suffix):
            read(path)


def exif_of(order, orientation):
    entry = struct.pack(f"{order}HHIHH", 0x112, 3, 1, orientation, 0)
    other = struct.pack(f"{order}HHII", 0x10F, 2, 4, 0)
    start = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(f"{order}IH", 8, 2)
    return start + other + entry + bytes(4)


@pytest.mark.parametrize(("orientation", "degrees"), [(3, 180), (6, 90)])
def test_an_exif_orientation_is_not_followed(tmp_path, orientation, degrees):
    """The depth map is of the sensor's raster; a picture turned by itself would not fit it."""
    image = cv2.resize(np.random.default_rng(0).integers(0, 255, (4, 6, 3), np.uint8), (96, 64))
    jpeg = cv2.imencode(".jpg", image)[1].tobytes()
    exif = b"Exif\0\0" + exif_of(">", orientation)
    turned = jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + jpeg[2:]
    followed = cv2.imdecode(np.frombuffer(turned, np.uint8), cv2.IMREAD_COLOR)
    assert not np.array_equal(followed, cv2.imdecode(np.frombuffer(jpeg, np.uint8), 1))
    with pytest.warns(AssumptionWarning, match=f"EXIF of the images turns them by {degrees} deg"):
        pixels = decode_rgb(turned, name="a.jpg")
    np.testing.assert_array_equal(pixels, decode_rgb(jpeg, name="b.jpg"))


@pytest.mark.parametrize(("order", "orientation", "said"), [
    ("<", 8, "270"), (">", 3, "180"), ("<", 2, "mirrors"), (">", 1, ""), ("<", 99, ""),
])  # fmt: skip
def test_what_exif_turns_is_said(order, orientation, said, recwarn):
    """A PNG states the same in its chunk eXIf."""
    exif = exif_of(order, orientation)
    png = cv2.imencode(".png", np.zeros((4, 6, 3), np.uint8))[1].tobytes()
    chunk = b"eXIf" + exif
    chunk = struct.pack(">I", len(exif)) + chunk + struct.pack(">I", zlib.crc32(chunk))
    assert decode_rgb(png[:33] + chunk + png[33:], name="a.png").shape == (4, 6, 3)
    assert [said in str(each.message) for each in recwarn] == [True] * bool(said)
    check_exif(b"\xff\xd8Exif\0\0" + exif[:12], "images")  # truncated


def test_the_header_of_a_tiff_does_not_turn_depth(tmp_path):
    """OpenCV turns a TIFF although it is told not to."""
    depth = np.arange(1, 13, dtype=np.float32).reshape(3, 4)
    path = write(tmp_path / "a.tiff", depth)
    content = path.read_bytes()
    samples = struct.pack("<HHIHH", 0x115, 3, 1, 1, 0)  # 1 is the default: can be left out
    assert content.count(samples) == 1
    path.write_bytes(content.replace(samples, struct.pack("<HHIHH", 0x112, 3, 1, 3, 0)))
    assert cv2.imread(str(path), cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION)[0, 0] == 12
    with pytest.warns(AssumptionWarning, match="header of the depth maps turns them by 180 deg"):
        np.testing.assert_array_equal(read_sparse_depth(path), depth)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_a_picture_of_too_many_pixels_is_refused_before_it_is_decoded(
    tmp_path, monkeypatch, suffix
):
    """Decoded, a JPEG of 631 bytes may take 5 GB and 23 s."""
    path = write(tmp_path / f"a{suffix}", np.zeros((40, 50, 3), np.uint8))
    monkeypatch.setattr(runtime.recordings.images, "MAX_PIXELS", 40 * 50)
    assert read_rgb(path).shape == (40, 50, 3)
    monkeypatch.setattr(runtime.recordings.images, "MAX_PIXELS", 40 * 50 - 1)
    monkeypatch.delattr(cv2, "imdecode")
    with pytest.raises(InputError, match="1,999"):
        read_rgb(path)


# --- the size in the header --------------------------------------------------------------------


def encode(suffix, shape, dtype=np.uint8, *options):
    image = np.random.default_rng(0).integers(0, 255, shape).astype(dtype)
    return cv2.imencode(suffix, image, options)[1].tobytes()


PROGRESSIVE = (cv2.IMWRITE_JPEG_PROGRESSIVE, 1, cv2.IMWRITE_JPEG_RST_INTERVAL, 1)


@pytest.mark.parametrize(("suffix", "shape", "dtype", "options"), [
    (".png", (1, 1), np.uint8, ()), (".png", (300, 2, 3), np.uint8, ()),
    (".png", (20, 30), np.uint16, ()), (".png", (20, 30, 4), np.uint8, ()),
    (".jpg", (1, 1), np.uint8, ()), (".jpg", (37, 1242, 3), np.uint8, ()),
    (".jpg", (20, 30, 3), np.uint8, PROGRESSIVE),
])  # fmt: skip
def test_a_header_has_the_size_of_the_picture(suffix, shape, dtype, options):
    assert image_size(encode(suffix, shape, dtype, *options)) == shape[:2]


HUFFMAN_TABLE = b"\xff\xc4\x00\x14\x00\x01" + bytes(16)  # of one code
BETWEEN = {
    "markers in a segment": b"\xff\xe1\x00\x0a" + b"\xff\xc0\xff\xd8\xff\xd9ab",  # a thumbnail's
    "fill": b"\xff" * 9,
    "garbage": b"extraneous \xff\x00 bytes",
    "markers without a segment": b"\xff\x01\xff\xd3",
    "comments": b"\xff\xfe\x00\x02" * 300,
    "a table whose marker is among those of frames": HUFFMAN_TABLE,
}


@pytest.mark.parametrize("between", BETWEEN.values(), ids=BETWEEN)
def test_a_header_of_a_jpeg_is_read_as_the_decoder_reads_it(between):
    whole = encode(".jpg", (20, 30, 3))
    content = whole[:20] + between + whole[20:]  # after the segment that says JFIF
    assert cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR).shape == (20, 30, 3)
    assert image_size(content) == (20, 30)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_the_beginning_of_a_file_has_its_size_or_none(suffix):
    whole = encode(suffix, (20, 30, 3))
    sizes = [image_size(whole[:length]) for length in range(len(whole) + 1)]
    known = sizes.index((20, 30))
    assert sizes[:known] == [None] * known
    assert set(sizes[known:]) == {(20, 30)}
    assert image_size(b"BM" + bytes(100)) is None
