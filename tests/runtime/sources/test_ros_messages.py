"""Messages of ROS as arrays, whatever they say. rosbags is not needed for it."""

import random
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
seeds = st.integers(0, 2**32)


class Rubbish:
    """Fields that are now and then what they should be."""

    def __init__(self, seed) -> None:
        self._random = random.Random(seed)

    def messages(self, make, fields):
        """A hundred messages of `make`, a few of whose `fields` (name -> drawing) are changed."""
        for _ in range(100):
            names = self._random.sample(list(fields), self._random.randint(1, 4))
            yield make(**{name: fields[name]() for name in names})

    def one_of(self, *choices):
        choice = self._random.choice(choices)
        return choice() if callable(choice) else choice

    def number(self):
        def near():
            return self._random.randint(-2, 40)

        def far():
            return self._random.randint(-(2**33), 2**33)

        return self.one_of(near, near, near, far, 0, 1, 2**31, 2**32 - 1, None, "12", 1.5, True)

    def data(self):
        return np.frombuffer(self._random.randbytes(self._random.randint(0, 64)), np.uint8)

    def fields(self):
        return [
            field(
                self.one_of("x", "y", "z", "rgb", ""),
                self.one_of(0, 4, 8, 12, self.number),
                self.one_of(FLOAT32, FLOAT64, lambda: self._random.randint(-1, 12)),
                self.one_of(1, 1, 1, self.number),
            )
            for _ in range(self._random.randint(0, 5))
        ]

    def coordinates(self):
        """All three, most of them right."""
        return [
            field(
                name, self.one_of(0, 4, 8, self.number), self.one_of(FLOAT32, FLOAT64, FLOAT32, 5)
            )
            for name in "xyz"
        ]


@settings(max_examples=60, deadline=None)
@given(seeds)
def test_a_cloud_that_says_anything_is_points_or_an_input_error(seed):
    """6000 messages."""
    rubbish = Rubbish(seed)
    changes = dict.fromkeys(("height", "width", "point_step", "row_step"), rubbish.number)
    changes["is_bigendian"] = lambda: rubbish.one_of(True, False)
    changes["fields"] = lambda: rubbish.one_of(rubbish.fields, rubbish.coordinates)
    changes["data"] = rubbish.data
    for message in rubbish.messages(cloud, changes):
        try:
            points = decode_points(message)
        except InputError:
            continue
        assert points.dtype == np.float32
        assert points.shape[1:] == (3,)
        assert points.nbytes <= 4096, "not much more than the data"


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"fields": [field("x", 0), field("y", 4)]}, "must have one field z, it has x, y"),
        ({"fields": [field("x", 0)] * 4}, "must have one field x, it has x, x, x, x"),
        ({"fields": []}, "it has none"),
        ({"fields": [field("x", 0, 4), field("y", 4), field("z", 8)]}, "x .* datatype uint16"),
        ({"fields": [field("x", 0), field("y", 4, count=2), field("z", 8)]}, "y .* is 2 of the"),
        ({"fields": [field("x", 0), field("y", 4), field("z", 9)]}, "z .* ends at byte 13 .* 12"),
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


@pytest.mark.parametrize("empty", [{"width": 0}, {"height": 0}])
def test_a_cloud_without_points_is_empty(empty):
    assert decode_points(cloud(**empty, data=np.zeros(0, np.uint8))).shape == (0, 3)


def test_points_that_are_not_there_stay_not_finite():
    values = np.array([np.nan, 1, 2, 3, np.inf, 5, 6, 7, 8], "<f4")
    points = decode_points(cloud(data=values.view(np.uint8)))
    assert np.isfinite(points).all(axis=1).tolist() == [False, False, True]


def image(encoding="rgb8", **changes):
    """2 x 3 pixels."""
    fields = {"height": 2, "width": 3, "encoding": encoding, "is_bigendian": 0, "step": 12}
    return SimpleNamespace(**{**fields, "data": np.arange(24, dtype=np.uint8), **changes})


@settings(max_examples=40, deadline=None)
@given(seeds)
def test_an_image_that_says_anything_is_an_array_or_an_input_error(seed):
    """4000 messages, each as a picture and as a depth map."""
    rubbish = Rubbish(seed)
    changes = dict.fromkeys(("height", "width", "step"), rubbish.number)
    known = ("rgb8", "bgra8", "mono8", "16UC1", "32FC1", "bayer_bggr8", "", "\x00", "mono16")
    changes["encoding"] = lambda: rubbish.one_of(*known)
    changes["is_bigendian"] = lambda: rubbish.one_of(0, 1)
    changes["data"] = rubbish.data
    for message in rubbish.messages(image, changes):
        for decode, dtype, rank in (
            (decode_image, np.uint8, 3),
            (decode_depth_image, np.float32, 2),
        ):
            try:
                array = decode(message)
            except InputError:
                continue
            assert (array.dtype, array.ndim) == (dtype, rank)
            assert array.nbytes <= 4096


@pytest.mark.parametrize(
    ("decode", "message", "text"),
    [
        (decode_image, image("bayer_rggb8"), "debayer it first"),
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


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 200), st.integers(0, 199), st.integers(0, 255))
def test_a_compressed_image_that_is_damaged_is_a_picture_or_an_input_error(cut, at, byte):
    damaged = bytearray(PNG)
    damaged[at % len(damaged)] = byte
    message = SimpleNamespace(format="x", data=np.frombuffer(bytes(damaged[:cut]), np.uint8))
    try:
        picture = decode_compressed_image(message)
    except InputError:
        return
    assert picture.dtype == np.uint8
    assert picture.ndim == 3


PNG = cv2.imencode(".png", np.arange(4 * 5 * 3, dtype=np.uint8).reshape(4, 5, 3))[1].tobytes()


@pytest.mark.parametrize(
    ("form", "array", "text"),
    [
        ("16UC1; compressedDepth png", np.zeros((2, 2), np.uint16), "republish it as raw"),
        ("mono16; png compressed", np.zeros((2, 2), np.uint16), "must hold 8 bits"),
    ],
)
def test_what_is_wrong_with_a_compressed_image_is_in_the_error(form, array, text):
    content = cv2.imencode(".png", array)[1].ravel()
    with pytest.raises(InputError, match=text):
        decode_compressed_image(SimpleNamespace(format=form, data=content))
