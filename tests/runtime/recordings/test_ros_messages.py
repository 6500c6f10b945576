"""Messages of ROS as arrays, whatever they say. rosbags is not needed for it."""

import struct
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from runtime import InputError
from runtime.recordings.ros_messages import (
    decode_compressed_image,
    decode_depth_image,
    decode_image,
    decode_points,
)

hypothesis = pytest.importorskip("hypothesis", reason="hypothesis is not installed")
from hypothesis import given, settings  # noqa: E402
from hypothesis import strategies as st  # noqa: E402

FLOAT32, FLOAT64 = 7, 8


def field(name, offset, datatype=FLOAT32, count=1):
    return SimpleNamespace(name=name, offset=offset, datatype=datatype, count=count)


def cloud(**changes):
    """Three points of x, y, z as float32 in a row, with `changes`."""
    values = np.arange(9, dtype="<f4")
    fields = {"height": 1, "width": 3, "is_bigendian": False, "point_step": 12, "row_step": 36}
    fields["fields"] = [field("x", 0), field("y", 4), field("z", 8)]
    return SimpleNamespace(**fields | {"data": values.view(np.uint8)} | changes)


@st.composite
def written_clouds(draw):
    """A PointCloud2 that is right, and its points by a plain loop."""
    order = draw(st.sampled_from("<>"))
    height, width = draw(st.integers(1, 4)), draw(st.integers(1, 5))
    datatypes = [draw(st.sampled_from([FLOAT32, FLOAT64])) for _ in "xyz"]
    sizes = [4 if datatype == FLOAT32 else 8 for datatype in datatypes]
    axes = draw(st.permutations(range(3)))
    offsets, end = [0, 0, 0], 0
    for axis in axes:
        offsets[axis] = end + draw(st.integers(0, 5))
        end = offsets[axis] + sizes[axis]
    point_step = end + draw(st.integers(0, 5))
    row_step = width * point_step + draw(st.integers(0, 9))
    data = bytearray([draw(st.integers(0, 255))]) * (row_step * height)
    points = np.zeros((height * width, 3), np.float32)
    for row, column, axis in np.ndindex(height, width, 3):
        value, code = draw(st.floats(width=32)), "f" if datatypes[axis] == FLOAT32 else "d"
        place = row * row_step + column * point_step + offsets[axis]
        struct.pack_into(order + code, data, place, value)
        points[row * width + column, axis] = value
    fields = [field("intensity", 0, 2)]
    fields += [field(name, offsets[i], datatypes[i]) for i, name in enumerate("xyz")]
    shape = {"height": height, "width": width, "point_step": point_step, "row_step": row_step}
    content = {"is_bigendian": order == ">", "data": np.frombuffer(bytes(data), np.uint8)}
    return cloud(fields=fields, **shape, **content), points


@settings(max_examples=40, deadline=None)
@given(written_clouds())
def test_points_are_those_of_a_plain_loop(written):
    message, points = written
    decoded = decode_points(message)
    assert decoded.dtype == np.float32
    assert np.array_equal(decoded, points, equal_nan=True)


@pytest.mark.parametrize(("changes", "named"), [
    ({"fields": [field("x", 0), field("y", 4)]}, "z"),
    ({"fields": [field("x", 0)] * 4}, "x"),
    ({"fields": [field("x", 0, 4), field("y", 4), field("z", 8)]}, "datatype 4"),
    ({"fields": [field("x", 0), field("y", 4, count=2), field("z", 8)]}, "y"),
    ({"fields": [field("x", 0), field("y", 4), field("z", 9)]}, "byte 9 of 12"),
    ({"data": np.zeros(35, np.uint8)}, "35"),
    ({"height": 2, "width": 2, "row_step": 23}, "row_step 23"),
])  # fmt: skip
def test_what_is_wrong_with_a_cloud_is_in_the_error(changes, named):
    with pytest.raises(InputError, match=named):
        decode_points(cloud(**changes))


def image(encoding="rgb8", **changes):
    """2 x 3 pixels."""
    fields = {"height": 2, "width": 3, "encoding": encoding, "is_bigendian": 0, "step": 12}
    return SimpleNamespace(**{**fields, "data": np.arange(24, dtype=np.uint8), **changes})


@pytest.mark.parametrize(("decode", "message", "named"), [
    (decode_image, image("bayer_rggb16"), "bayer_rggb8"),
    (decode_image, image("mono16"), "mono16"),
    (decode_image, image("16UC1"), "depth_topic="),
    (decode_image, image("yuv422"), "yuv422"),
    (decode_image, image(step=8), "step 8"),
    (decode_image, image(height=3), "24 bytes"),
    (decode_image, image(height=0), "empty"),
    (decode_image, image(width=2**20, height=2**20), "64,000,000"),
    (decode_depth_image, image("rgb8"), "32FC1"),
    (decode_depth_image, image("32FC1", width=4), "step 12"),
])  # fmt: skip
def test_what_is_wrong_with_an_image_is_in_the_error(decode, message, named):
    with pytest.raises(InputError, match=named):
        decode(message)


@pytest.mark.parametrize("step", [0, 4, 12, 48, 2**31])
def test_data_without_padding_need_no_right_step(step):
    values = np.arange(12, dtype="<f4")
    points = decode_points(cloud(height=2, width=2, row_step=step, data=values.view(np.uint8)))
    assert np.array_equal(points, values.reshape(4, 3))
    pixels = np.arange(18, dtype=np.uint8)
    assert np.array_equal(decode_image(image(step=step, data=pixels)).ravel(), pixels)
    depth = image("32FC1", step=step, data=values[:6].view(np.uint8))
    assert np.array_equal(decode_depth_image(depth).ravel(), values[:6])


@pytest.mark.parametrize(("encoding", "dtype", "big"), [
    ("16UC1", "<u2", 0), ("16UC1", ">u2", 1), ("32FC1", "<f4", 0), ("32FC1", ">f4", 1),
])  # fmt: skip
def test_depth_images_are_metres(encoding, dtype, big):
    metres = np.array([[0, 1.5, 8], [2, 0.25, 60]])
    values = (metres * (1000 if "16" in encoding else 1)).astype(dtype)
    given = {"is_bigendian": big, "step": values[0].nbytes, "data": values.ravel().view(np.uint8)}
    np.testing.assert_array_equal(decode_depth_image(image(encoding, **given)), metres)


@pytest.mark.parametrize("padding", [0, 5])
def test_each_encoding_gives_the_same_picture(padding):
    rgb = np.random.default_rng(0).integers(0, 256, (*SIZE, 3), dtype=np.uint8)
    rgba, mono = np.insert(rgb, 3, 255, axis=-1), np.repeat(rgb[..., :1], 3, axis=-1)
    for encoding, array, expected in (
        ("rgb8", rgb, rgb),
        ("bgr8", rgb[..., ::-1], rgb),
        ("rgba8", rgba, rgb),
        ("bgra8", rgba[..., [2, 1, 0, 3]], rgb),
        ("mono8", rgb[..., 0], mono),
    ):
        rows = np.pad(array.reshape(SIZE[0], -1), ((0, 0), (0, padding)))
        size = {"height": SIZE[0], "width": SIZE[1], "step": rows.shape[1]}
        decoded = decode_image(image(encoding, data=rows.ravel(), **size))
        assert decoded.flags.c_contiguous
        np.testing.assert_array_equal(decoded, expected)


SIZE = (16, 24)
PATTERNS = {"rggb": "RGGB", "bggr": "BGGR", "gbrg": "GBRG", "grbg": "GRBG"}


def tiles():
    """Red on the left, blue on the right."""
    rgb = np.zeros((*SIZE, 3), np.uint8)
    rgb[:, :12], rgb[:, 12:] = (200, 40, 40), (40, 40, 200)
    return rgb


def mosaic_of(rgb, pattern):
    """Return what a sensor with this pattern of 2 x 2 pixels sees."""
    mosaic = np.zeros(SIZE, np.uint8)
    for place, color in enumerate(pattern):
        y, x = divmod(place, 2)
        mosaic[y::2, x::2] = rgb[y::2, x::2, "RGB".index(color)]
    return mosaic


def compressed(form, array, *, ending=".png"):
    """array: as OpenCV takes it, BGR."""
    content = cv2.imencode(ending, array)[1].ravel()
    return SimpleNamespace(format=form, data=content)


def raw(encoding, array):
    height, width = array.shape
    return image(encoding, height=height, width=width, step=width, data=array.ravel())


@pytest.mark.parametrize("name", PATTERNS)
def test_a_mosaic_becomes_a_picture(name):
    rgb, encoding = tiles(), f"bayer_{name}8"
    mosaic = mosaic_of(rgb, PATTERNS[name])
    for decoded in (
        decode_image(raw(encoding, mosaic)),
        decode_compressed_image(compressed(f"{encoding}; png compressed ", mosaic)),
        decode_compressed_image(compressed(f"{encoding}; jpeg compressed ", mosaic, ending=".jpg")),
    ):
        difference = np.abs(decoded[2:-2].astype(int) - rgb[2:-2]).max(axis=(0, 2))
        assert difference[2:10].max() < 20, "the red half"
        assert difference[14:22].max() < 20, "the blue half"


@pytest.mark.parametrize(("form", "array"), [
    ("bayer_rggb8; png compressed bgr8", tiles()[..., ::-1]),  # converted by the publisher
    ("bayer_rggb16; png compressed bgr8", tiles()[..., ::-1]),
    ("yuv422; png compressed bgr8", tiles()[..., ::-1]),
    ("mono8; png compressed ", mosaic_of(tiles(), "RGGB")),
    ("png", mosaic_of(tiles(), "RGGB")),
])  # fmt: skip
def test_what_is_no_mosaic_is_the_picture_itself(form, array):
    expected = np.broadcast_to(
        array[..., ::-1] if array.ndim == 3 else array[..., None], (*SIZE, 3)
    )
    np.testing.assert_array_equal(decode_compressed_image(compressed(form, array)), expected)


@pytest.mark.parametrize(("form", "dtype", "named"), [
    ("16UC1; compressedDepth png", np.uint16, "depth map"),
    ("16UC1; png compressed ", np.uint16, "depth map"),
    ("16UC1; jpeg compressed ", np.uint8, "depth map"),
    ("mono16; png compressed", np.uint16, "8 bits"),
    ("bayer_rggb16; png compressed ", np.uint16, "8 bits"),
    ("bayer_rggb16; jpeg compressed ", np.uint8, "bayer_rggb8"),
])  # fmt: skip
def test_what_is_wrong_with_a_compressed_image_is_in_the_error(form, dtype, named):
    with pytest.raises(InputError, match=named):
        decode_compressed_image(compressed(form, np.zeros((2, 2), dtype)))
