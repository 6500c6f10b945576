"""Poses of Odometry and /tf, and the times of points, of messages made by hand."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from runtime.base.errors import InputError
from runtime.geometry.assumptions import AssumptionWarning
from runtime.recordings.ros_poses import TransformTree, odometry_pose, point_times_s

STAMP_NS = 1_700_000_000 * 10**9 + 123_456_789
QUATERNION = Rotation.from_rotvec([0.1, 0.2, 0.3]).as_quat()


def vector(*values):
    return SimpleNamespace(**dict(zip("xyzw", values, strict=False)))


def odometry(quaternion=QUATERNION, position=(1, 2, 3)):
    inner = SimpleNamespace(position=vector(*position), orientation=vector(*quaternion))
    return SimpleNamespace(pose=SimpleNamespace(pose=inner))


def test_the_pose_of_an_odometry():
    expected = np.eye(4)
    expected[:3, :3] = Rotation.from_quat(QUATERNION).as_matrix()
    expected[:3, 3] = 1, 2, 3
    np.testing.assert_allclose(odometry_pose(odometry()), expected, atol=1e-12)


@pytest.mark.parametrize("wrong", [{"quaternion": (0, 0, 0, 0)}, {"quaternion": (0, 0, 0, 1.03)},
                                   {"position": (np.nan, 0, 0)}])  # fmt: skip
def test_a_pose_that_is_none_is_refused(wrong):
    with pytest.raises(InputError, match="Odometry"):
        odometry_pose(odometry(**wrong))


def cloud(name, datatype, code, values, *, height=1, is_bigendian=False, offset=12, count=1):
    step = 24
    width = len(values) // height
    data = np.zeros((len(values), step), np.uint8)
    raw = np.array(values, ("<", ">")[is_bigendian] + code)
    data[:, 12 : 12 + raw.itemsize] = raw.view(np.uint8).reshape(len(values), raw.itemsize)
    field = SimpleNamespace(name=name, datatype=datatype, offset=offset, count=count)
    return SimpleNamespace(
        fields=[SimpleNamespace(name="x", datatype=7, offset=0, count=1), field],
        height=height, width=width, point_step=step, row_step=step * width,
        is_bigendian=is_bigendian, data=data.tobytes(),
    )  # fmt: skip


def times_of(message, lost=()):
    """Nanoseconds after the stamp, where the points with these numbers are no returns."""
    points = np.ones((message.height * message.width, 3), np.float32)
    points[list(lost)] = 0
    times = point_times_s(message, STAMP_NS, points)
    return None if times is None else times * 1e9


@pytest.mark.parametrize("is_bigendian", [False, True])
@pytest.mark.parametrize(("name", "datatype", "code", "values", "after_ns"), [
    ("t", 6, "u4", [0, 50_000_000, 99_000_000, 1], [0, 50_000_000, 99_000_000, 1]),  # Ouster
    ("time", 7, "f4", [-0.1, 0.0, 0.05, 0.0], [-100_000_001, 0, 50_000_001, 0]),  # Velodyne
    ("timestamp", 8, "f8", [0.0, 0.05, 0.1, 0.0], [0, 50_000_000, 100_000_000, 0]),
    ("time_stamp", 6, "u4", [5, 6, 7, 9_000_008], [5, 6, 7, 9_000_008]),  # Autoware
    ("offset_time", 6, "u4", [5, 6, 7, 9_000_008], [5, 6, 7, 9_000_008]),  # Livox
    ("time", 7, "f4", [0, 5e4, 99_999, 1], [0, 50_000_000, 99_999_000, 1000]),
    ("time", 8, "f8", [-5e4, 0, 5e4, 1], [-50_000_000, 0, 50_000_000, 1000]),
    ("time", 7, "f4", [0, 50, 100, 1], [0, 50_000_000, 100_000_000, 1_000_000]),
    ("time", 8, "f8", [0, 5e7, 1e8, 1], [0, 50_000_000, 100_000_000, 1]),
])  # fmt: skip
@pytest.mark.parametrize("height", [1, 2])
def test_times_after_the_stamp(name, datatype, code, values, after_ns, height, is_bigendian):
    message = cloud(name, datatype, code, values, height=height, is_bigendian=is_bigendian)
    after = times_of(message)
    np.testing.assert_allclose(after, after_ns, atol=2)


@pytest.mark.parametrize("unit", [1, 1e3, 1e6, 1e9], ids=["s", "ms", "us", "ns"])
def test_large_eight_bytes_are_of_the_clock(unit):
    """Hesai, RoboSense and Livox write such times; a float64 is exact to 0.24 µs there."""
    message = cloud("timestamp", 8, "f8", [STAMP_NS / 1e9 * unit, (STAMP_NS / 1e9 + 0.05) * unit])
    np.testing.assert_allclose(times_of(message), [0, 50_000_000], atol=256)


def test_two_integers_are_seconds_and_nanoseconds_of_the_clock():
    halves = np.array([divmod(STAMP_NS + after, 10**9) for after in (0, 50_000_000)], "<u4")
    message = cloud("time", 6, "u8", halves.view("<u8").ravel(), count=2)
    np.testing.assert_allclose(times_of(message), [0, 50_000_000], atol=1)


@pytest.mark.parametrize(("datatype", "code", "values"), [
    (7, "f4", [0, 2e9]),
    (7, "f4", [1e4, 1.01e4]),
    (8, "f8", [1.7e13, 1.7e13 + 1e5]),
    (8, "f8", [STAMP_NS, STAMP_NS + 2e9]),
])  # fmt: skip
def test_times_of_another_unit_are_refused(datatype, code, values):
    with pytest.raises(InputError, match="pose_topic=none"):
        times_of(cloud("time", datatype, code, values))


@pytest.mark.parametrize(("code", "values", "unit"), [
    ("u4", [0, 50_000, 99_000], "microseconds"), ("u2", [0, 50, 100], "milliseconds"),
    ("u4", [0, 300, 900], "milliseconds"), ("u4", [5000, 5000, 5001], "nanoseconds"),
])  # fmt: skip
def test_the_span_of_integers_decides_on_their_unit(code, values, unit):
    with pytest.warns(AssumptionWarning, match=f"is {unit}"):
        after = times_of(cloud("t", {"u2": 4, "u4": 6}[code], code, values))
    ns = {"nanoseconds": 1, "microseconds": 10**3, "milliseconds": 10**6}[unit]
    np.testing.assert_allclose(after, np.multiply(values, ns), atol=2)


def test_a_field_that_is_missing_or_not_filled_is_no_time():
    assert times_of(cloud("intensity", 7, "f4", [1, 2])) is None
    assert times_of(cloud("t", 6, "u4", [0, 0, 0])) is None
    assert times_of(cloud("t", 6, "u4", [])) is None


@pytest.mark.parametrize("change", [
    {"datatype": 3, "code": "i2"}, {"offset": 22}, {"count": 3}, {},
])  # fmt: skip
def test_another_layout_and_truncated_data_are_refused(change):
    arguments = {"name": "t", "datatype": 6, "code": "u4", "values": [1, 2]} | change
    message = cloud(**arguments)
    message.data = message.data[:-1] if not change else message.data
    with pytest.raises(InputError, match=r"the field t|truncated"):
        times_of(message)


ENDS = np.linspace(0, 0.1, 99)


@pytest.mark.parametrize("broken", [np.nan, 3.6e9])
@pytest.mark.parametrize(("code", "offset", "unit"), [
    ("f8", 0, 1), ("f4", 0, 1e6), ("f8", STAMP_NS / 1e9, 1), ("f8", STAMP_NS, 1e9), ("u4", 0, 1e9),
])  # fmt: skip
def test_a_broken_time_decides_on_no_unit(code, offset, unit, broken):
    """A lost point and one of a hundred returns have a broken time."""
    values = offset + unit * np.append(ENDS, 0.05)
    values[[7, 99]] = 3.6e9 if code == "u4" else broken
    datatype = {"f4": 7, "f8": 8, "u4": 6}[code]
    after = times_of(cloud("t", datatype, code, values), lost=[99])
    np.testing.assert_allclose(np.delete(after, [7, 99]) / 1e9, np.delete(ENDS, 7), atol=3e-7)
    assert not abs(after[7]) <= 1e9


def stamped(parent, child, quaternion=(0, 0, 0, 1), shift=(0, 0, 0)):
    transform = SimpleNamespace(rotation=vector(*quaternion), translation=vector(*shift))
    header = SimpleNamespace(frame_id=parent)
    return SimpleNamespace(header=header, child_frame_id=child, transform=transform)


def tree(*transforms):
    return TransformTree([SimpleNamespace(transforms=[transform]) for transform in transforms])


QUARTER = (0, 0, np.sqrt(0.5), np.sqrt(0.5))  # about z, x to y


def test_a_point_goes_up_to_the_common_frame_and_down_again():
    with pytest.warns(AssumptionWarning, match="base to roof"):
        between = tree(
            stamped("base", "roof", 1.01 * np.array(QUARTER), (1, 2, 3)),
            stamped("roof", "lidar", shift=(4, 0, 0.5)),
            stamped("map", "base", shift=(100, 0, 0)),
            stamped("base", "camera", QUARTER, (0, 0, 1)),
        ).between("lidar", "/camera")
    in_base = np.array([1 - 20, 2 + 14, 3 + 30.5])  # (10, 20, 30) turned, and moved
    in_camera = np.array([in_base[1], -in_base[0], in_base[2] - 1])
    assert np.allclose(between @ (10, 20, 30, 1), (*in_camera, 1))
    assert between[3].tolist() == [0, 0, 0, 1]
    assert np.array_equal(tree().between("lidar", "lidar"), np.eye(4))


@pytest.mark.parametrize(("transforms", "named"), [
    ([], "no frames"),
    ([stamped("a", "c")], "it has a, c"),
    ([stamped("a", "b"), stamped("b", "a")], "cycle at the frame 'b'"),
    ([stamped("a", "b", (0, 0, 0, 0))], "quaternion"),
    ([stamped("a", "b", shift=(np.inf, 0, 0))], "finite"),
])  # fmt: skip
def test_invalid_trees_are_refused(transforms, named):
    with pytest.raises(InputError, match=named):
        tree(*transforms).between("b", "a")
