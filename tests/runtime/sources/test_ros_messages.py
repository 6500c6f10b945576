"""Messages of ROS as arrays, whatever they say. rosbags is not needed for it."""

import struct
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from runtime import InputError
from runtime.sources.ros_messages import (
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
    fields = {
        "height": 1,
        "width": 3,
        "fields": [field("x", 0), field("y", 4), field("z", 8)],
        "is_bigendian": False,
        "point_step": 12,
        "row_step": 36,
        "data": values.view(np.uint8),
    }
    return SimpleNamespace(**{**fields, **changes})


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
    points = []
    for row in range(height):
        for column in range(width):
            point = []
            for axis in range(3):
                value = draw(st.floats(width=32))
                code = "f" if datatypes[axis] == FLOAT32 else "d"
                place = row * row_step + column * point_step + offsets[axis]
                struct.pack_into(order + code, data, place, value)
                point.append(value)
            points.append(point)
    fields = [field("intensity", 0, 2)]
    fields += [field(name, offsets[i], datatypes[i]) for i, name in enumerate("xyz")]
    message = cloud(
        height=height,
        width=width,
        fields=fields,
        is_bigendian=order == ">",
        point_step=point_step,
        row_step=row_step,
        data=np.frombuffer(bytes(data), np.uint8),
    )
    return message, np.array(points, np.float32)


@settings(max_examples=100, deadline=None)
@given(written_clouds())
def test_points_are_those_of_a_plain_loop(written):
    message, points = written
    decoded = decode_points(message)
    assert decoded.dtype == np.float32
    assert np.array_equal(decoded, points, equal_nan=True)


#: Messages are made of a seed a hundred at a time: drawing each field alone takes minutes.


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"fields": [field("x", 0), field("y", 4)]}, "must have one field z, it has x, y"),
        ({"fields": [field("x", 0)] * 4}, "must have one field x, it has x, x, x, x"),
        (
            {"fields": [field("x", 0, 4), field("y", 4), field("z", 8)]},
            "datatype 4, expected one of f4",
        ),
        ({"fields": [field("x", 0), field("y", 4, count=2), field("z", 8)]}, "y .* is 2 of the"),
        ({"fields": [field("x", 0), field("y", 4), field("z", 9)]}, "z .* begins at byte 9 of 12"),
        ({"data": np.zeros(35, np.uint8)}, "3 points has 35 bytes, expected 36: it is truncated"),
        (
            {"height": 2, "width": 2, "row_step": 23},
            "2 points has row_step 23, expected .* 24",
        ),
        ({"width": -3}, "width of a message must be a whole number of 0 to .*, got -3"),
    ],
)
def test_what_is_wrong_with_a_cloud_is_in_the_error(changes, text):
    with pytest.raises(InputError, match=text):
        decode_points(cloud(**changes))


def image(encoding="rgb8", **changes):
    """2 x 3 pixels."""
    fields = {"height": 2, "width": 3, "encoding": encoding, "is_bigendian": 0, "step": 12}
    return SimpleNamespace(**{**fields, "data": np.arange(24, dtype=np.uint8), **changes})


@pytest.mark.parametrize(
    ("decode", "message", "text"),
    [
        (decode_image, image("bayer_rggb16"), "expected one of .*bayer_rggb8"),
        (decode_image, image("mono16"), "expected one of rgb8"),
        (decode_image, image("16UC1"), "that is a depth map: name it by depth_topic= in --source"),
        (decode_image, image("yuv422"), "expected one of rgb8, bgr8"),
        (decode_image, image(step=8), "has step 8, expected at least 9"),
        (decode_image, image(height=3), "has 24 bytes, expected 33: it is truncated"),
        (decode_image, image(height=0), "is empty"),
        (decode_image, image(width=2**20, height=2**20), "expected at most 64,000,000"),
        (decode_depth_image, image("mono16"), "expected 16UC1 .* or 32FC1"),
        (decode_depth_image, image("32FC1", width=4), "has step 12, expected at least 16"),
    ],
)
def test_what_is_wrong_with_an_image_is_in_the_error(decode, message, text):
    with pytest.raises(InputError, match=text):
        decode(message)


SIZE = (16, 24)
PATTERNS = {"rggb": "RGGB", "bggr": "BGGR", "gbrg": "GBRG", "grbg": "GRBG"}


def tiles():
    """Red on the left, blue on the right."""
    rgb = np.zeros((*SIZE, 3), np.uint8)
    rgb[:, :12], rgb[:, 12:] = (200, 40, 40), (40, 40, 200)
    return rgb


def mosaic_of(rgb, pattern):
    """What a sensor with this pattern of 2 x 2 pixels sees."""
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


@pytest.mark.parametrize(
    ("form", "array"),
    [
        ("bayer_rggb8; png compressed bgr8", tiles()[..., ::-1]),  # converted by the publisher
        ("bayer_rggb16; png compressed bgr8", tiles()[..., ::-1]),
        ("yuv422; png compressed bgr8", tiles()[..., ::-1]),
        ("mono8; png compressed ", mosaic_of(tiles(), "RGGB")),
        ("png", mosaic_of(tiles(), "RGGB")),
    ],
)
def test_what_is_no_mosaic_is_the_picture_itself(form, array):
    expected = np.broadcast_to(
        array[..., ::-1] if array.ndim == 3 else array[..., None], (*SIZE, 3)
    )
    np.testing.assert_array_equal(decode_compressed_image(compressed(form, array)), expected)


@pytest.mark.parametrize(
    ("form", "array", "text"),
    [
        ("16UC1; compressedDepth png", np.zeros((2, 2), np.uint16), "a depth map: republish it"),
        ("16UC1; png compressed ", np.zeros((2, 2), np.uint16), "a depth map: republish it as raw"),
        ("16UC1; jpeg compressed ", np.zeros((2, 2), np.uint8), "a depth map: republish it as raw"),
        ("mono16; png compressed", np.zeros((2, 2), np.uint16), "must hold 8 bits"),
        ("bayer_rggb16; png compressed ", np.zeros((2, 2), np.uint16), "must hold 8 bits"),
        ("bayer_rggb16; jpeg compressed ", np.zeros((2, 2), np.uint8), "expected .* bayer_rggb8"),
    ],
)
def test_what_is_wrong_with_a_compressed_image_is_in_the_error(form, array, text):
    with pytest.raises(InputError, match=text):
        decode_compressed_image(compressed(form, array))
