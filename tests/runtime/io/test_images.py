"""Files to arrays."""

import os
import re
import subprocess
import sys
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

import runtime.io.images
import runtime.read_input
from runtime import InputError
from runtime.io.images import read_rgb, read_sparse_depth


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


@pytest.mark.parametrize("scale", [256, 100])
def test_depth_is_read_in_metres(tmp_path, scale):
    image = np.random.default_rng(0).integers(0, 65536, (40, 50), dtype=np.uint16)
    image[0, :3] = (0, 1, 65535)
    depth = read_sparse_depth(write(tmp_path / "d.png", image), depth_scale=scale)
    assert depth.dtype == np.float32
    np.testing.assert_allclose(depth, image.astype(np.float64) / scale, rtol=1e-7)
    assert depth[0, 0] == 0


def test_a_depth_map_with_an_axis_too_many_is_no_picture(tmp_path):
    with pytest.raises(InputError, match=r"got float32 \(40, 50, 1\): convert it to one"):
        read_sparse_depth(write(tmp_path / "d.npy", np.zeros((40, 50, 1), np.float32)))


@pytest.mark.parametrize(
    "image",
    [np.zeros((40, 50), np.uint8), np.zeros((40, 50, 3), np.uint16)],
    ids=["8 bits", "colour"],
)
@pytest.mark.parametrize("suffix", ["png", "tif", "npy"])
def test_depth_of_other_types_is_refused_with_what_is_accepted(tmp_path, image, suffix):
    path = write(tmp_path / f"d.{suffix}", image)
    with pytest.raises(InputError) as raised:
        read_sparse_depth(path)
    assert str(path) in str(raised.value)
    assert "of one channel of 16 bits (PNG, TIFF or .npy) or of floats" in str(raised.value)
    assert f"got {image.dtype} {image.shape}" in str(raised.value)


@pytest.mark.parametrize("shape", [(40, 50), (40, 50, 3)], ids=["depth map", "colour"])
def test_a_picture_of_16_bits_is_refused(tmp_path, shape):
    path = write(tmp_path / "p.png", np.full(shape, 9999, np.uint16))
    with pytest.raises(InputError, match=r"8 bits a channel, got 16 bits.*folders swapped"):
        read_rgb(path)


def test_a_gray_picture_has_three_equal_channels(tmp_path):
    gray = np.random.default_rng(0).integers(0, 255, (40, 50), dtype=np.uint8)
    image = read_rgb(write(tmp_path / "p.png", gray))
    assert image.dtype == np.uint8
    assert (image == gray[..., None]).all()


@pytest.mark.parametrize(
    ("name", "dtype"),
    [("d.tif", "f4"), ("d.TIFF", "f8"), ("d.npy", "f4"), ("d.NPY", ">f8"), ("d.npy", "f2")],
)
def test_floats_are_metres(tmp_path, name, dtype):
    metres = np.random.default_rng(0).random((40, 50)).astype(dtype)
    metres[0, :3] = (0, np.nan, np.inf)
    depth = read_sparse_depth(write(tmp_path / name, metres), depth_scale=100)
    assert depth.dtype == np.dtype(np.float32)
    np.testing.assert_array_equal(depth, metres.astype(np.float32))


@pytest.mark.parametrize(("name", "dtype"), [("d.tif", "u2"), ("d.npy", "u2"), ("d.npy", ">u2")])
def test_16_bits_have_a_scale_in_every_format(tmp_path, name, dtype):
    units = np.arange(2000).reshape(40, 50).astype(dtype)
    depth = read_sparse_depth(write(tmp_path / name, units), depth_scale=100)
    np.testing.assert_allclose(depth, units / 100, rtol=1e-6)


def test_an_array_of_objects_or_of_more_than_its_file_is_refused(tmp_path):
    path = write(tmp_path / "d.npy", np.zeros((40, 50), np.float32))
    whole = path.read_bytes()
    for content in (whole[:-1], whole.replace(b"(40, 50), ", b"(40000000000, 50), "), b"", b"no"):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"d\.npy is not a .npy file of numbers, or is trunc"):
            read_sparse_depth(path)
    np.save(path, np.zeros((40, 50), object), allow_pickle=True)
    with pytest.raises(InputError, match="OBJECT"):
        read_sparse_depth(path)


@pytest.mark.parametrize("suffix", ["rgb.png", "rgb.jpg", "depth.png", "depth.tif"])
@pytest.mark.parametrize("kept", [0.0, 0.1, 0.5, 0.99])
def test_truncated_files_are_refused(tmp_path, suffix, kept):
    random = np.random.default_rng(0)
    if suffix.startswith("depth"):
        image, read = random.integers(0, 9999, (40, 50), dtype=np.uint16), read_sparse_depth
    else:
        image, read = random.integers(0, 255, (40, 50, 3), dtype=np.uint8), read_rgb
    path = write(tmp_path / suffix, image)
    read(path)
    os.truncate(path, int(path.stat().st_size * kept))
    with pytest.raises(InputError, match="empty, truncated or damaged"):
        read(path)


def test_a_damaged_png_is_refused(tmp_path):
    image = np.random.default_rng(0).integers(0, 9999, (40, 50), dtype=np.uint16)
    path = write(tmp_path / "d.png", image)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(content)
    with pytest.raises(InputError, match="damaged"):
        read_sparse_depth(path)


def test_a_vanished_file(tmp_path):
    with pytest.raises(InputError, match="cannot read"):
        read_rgb(tmp_path / "gone.png")


def test_an_exif_orientation_is_not_followed(tmp_path):
    """The depth map is of the sensor's raster; a picture turned by itself would not fit it."""
    rng = np.random.default_rng(0)
    image = cv2.resize(rng.integers(0, 255, (4, 6, 3), np.uint8), (96, 64))
    jpeg = cv2.imencode(".jpg", image)[1].tobytes()
    upright = tmp_path / "upright.jpg"
    upright.write_bytes(jpeg)
    for orientation in (3, 6):
        entry = b"\x01\x12\x00\x03\x00\x00\x00\x01" + bytes([0, orientation, 0, 0])
        exif = b"Exif\x00\x00MM\x00*\x00\x00\x00\x08\x00\x01" + entry + bytes(4)
        header = b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif
        turned = tmp_path / f"{orientation}.jpg"
        turned.write_bytes(jpeg[:2] + header + jpeg[2:])
        assert cv2.imread(str(turned)).shape != image.shape or orientation == 3
        np.testing.assert_array_equal(read_rgb(turned), read_rgb(upright))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_what_is_no_regular_file_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe.png")
    (tmp_path / "folder.png").mkdir()
    for name in ("pipe.png", "folder.png"):
        with pytest.raises(InputError, match=r"not a regular file|Is a directory"):
            read_rgb(tmp_path / name)


# --- pictures that ask for too much -------------------------------------------------------------


def bomb(path: Path, height: int = 30_000, width: int = 30_000) -> Path:
    """A JPEG or PNG of a few hundred bytes whose header asks for gigabytes."""
    content = cv2.imencode(path.suffix, np.zeros((16, 16, 3), np.uint8))[1].tobytes()
    if path.suffix == ".jpg":
        frame = content.index(b"\xff\xc0") + 5
        size = height.to_bytes(2, "big") + width.to_bytes(2, "big")
        content = content[:frame] + size + content[frame + 4 :]
    else:
        header = b"IHDR" + width.to_bytes(4, "big") + height.to_bytes(4, "big") + content[24:29]
        content = content[:12] + header + zlib.crc32(header).to_bytes(4, "big") + content[33:]
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_a_picture_may_have_so_many_pixels(tmp_path, monkeypatch, suffix):
    path = write(tmp_path / f"a{suffix}", np.zeros((40, 50, 3), np.uint8))
    monkeypatch.setattr(runtime.io.images, "MAX_PIXELS", 40 * 50)
    assert read_rgb(path).shape == (40, 50, 3)
    monkeypatch.setattr(runtime.io.images, "MAX_PIXELS", 40 * 50 - 1)
    with pytest.raises(InputError, match=r"has 40 x 50 pixels, expected at most 1,999"):
        read_rgb(path)


def test_a_file_may_have_so_many_bytes(tmp_path, monkeypatch):
    path = write(tmp_path / "a.png", np.zeros((40, 50, 3), np.uint8))
    size = path.stat().st_size
    monkeypatch.setitem(runtime.read_input.read_input.__kwdefaults__, "max_bytes", size)
    assert read_rgb(path).shape == (40, 50, 3)
    monkeypatch.setitem(runtime.read_input.read_input.__kwdefaults__, "max_bytes", size - 1)
    with pytest.raises(InputError, match=rf"has {size} bytes, expected at most {size - 1}"):
        read_rgb(path)


@pytest.mark.skipif(sys.platform != "linux", reason="needs RLIMIT_AS")
def test_what_asks_for_too_much_takes_no_memory(tmp_path):
    """Where 300 MB are left, as seen by the reader that training has, too."""
    bomb(tmp_path / "bomb.jpg")
    bomb(tmp_path / "bomb.png")
    (tmp_path / "sparse.png").touch()
    os.truncate(tmp_path / "sparse.png", 100_000_000_000)
    program = (
        "import resource, sys; from pathlib import Path\n"
        "from runtime import InputError; from runtime.io.images import read_rgb\n"
        "used = int(Path('/proc/self/statm').read_text().split()[0]) * resource.getpagesize()\n"
        "resource.setrlimit(resource.RLIMIT_AS, (used + 300_000_000,) * 2)\n"
        "for path in sys.argv[1:]:\n"
        "    try: read_rgb(Path(path))\n"
        "    except InputError as error: print(error)\n"
    )
    paths = [tmp_path / name for name in ("bomb.jpg", "bomb.png", "sparse.png")]
    command = [sys.executable, "-c", program, *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert re.findall(r"has (.*?), expected", done.stdout) == [
        "30000 x 30000 pixels",
        "30000 x 30000 pixels",
        "100,000,000,000 bytes",
    ]
