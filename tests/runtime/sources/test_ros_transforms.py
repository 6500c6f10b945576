"""Transforms between the frames of a robot."""

from types import SimpleNamespace as Record

import numpy as np
import pytest

from runtime import InputError
from runtime.sources.ros_transforms import TransformTree


def stamped(parent, child, quaternion=(0, 0, 0, 1), shift=(0, 0, 0)):
    rotation = Record(**dict(zip("xyzw", quaternion, strict=True)))
    translation = Record(**dict(zip("xyz", shift, strict=True)))
    return Record(
        header=Record(frame_id=parent),
        child_frame_id=child,
        transform=Record(rotation=rotation, translation=translation),
    )


def tree(*transforms):
    return TransformTree([Record(transforms=[transform]) for transform in transforms])


QUARTER = (0, 0, np.sqrt(0.5), np.sqrt(0.5))  # about z, x to y


def test_a_point_goes_up_to_the_common_frame_and_down_again():
    between = tree(
        stamped("base", "roof", QUARTER, (1, 2, 3)),
        stamped("roof", "lidar", shift=(4, 0, 0.5)),
        stamped("map", "base", shift=(100, 0, 0)),
        stamped("base", "camera", QUARTER, (0, 0, 1)),
    ).between("lidar", "/camera")
    in_base = np.array([1 - 20, 2 + 14, 3 + 30.5])  # (10, 20, 30) turned, and moved
    in_camera = np.array([in_base[1], -in_base[0], in_base[2] - 1])
    assert np.allclose(between @ (10, 20, 30, 1), (*in_camera, 1))
    assert between[3].tolist() == [0, 0, 0, 1]


def test_a_frame_to_itself_needs_no_tree():
    assert np.array_equal(tree().between("lidar", "lidar"), np.eye(4))


def test_a_quaternion_a_little_off_is_made_a_rotation():
    between = tree(stamped("a", "b", 1.01 * np.array(QUARTER))).between("b", "a")
    assert np.allclose(between[:3, :3] @ between[:3, :3].T, np.eye(3))


@pytest.mark.parametrize(
    ("transforms", "text"),
    [
        ([], "does not connect the frame 'b' to 'a', it has no frames: give --calibration"),
        ([stamped("a", "c")], "it has a, c: give --calibration"),
        ([stamped("a", "b"), stamped("b", "a")], "a cycle at the frame 'b'"),
        ([stamped("a", "b", (0, 0, 0, 0))], "expected a unit quaternion"),
        ([stamped("a", "b", (0, 0, 0, np.nan))], "expected a unit quaternion"),
        ([stamped("a", "b", shift=(np.inf, 0, 0))], "expected a unit quaternion .* and metres"),
    ],
)
def test_invalid_trees_are_refused(transforms, text):
    with pytest.raises(InputError, match=text):
        tree(*transforms).between("b", "a")
