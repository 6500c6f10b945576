"""Files of poses, against scipy and numbers by hand."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from runtime.base.errors import InputError
from runtime.recordings.poses import read_kitti_poses, read_oxts_poses, read_tum_poses


def test_kittis_poses_are_rows_of_a_matrix(tmp_path):
    path = tmp_path / "poses.txt"
    path.write_text("1 0 0 5 0 1 0 6 0 0 1 7\n\n0 -1 0 0 1 0 0 0 0 0 1 0\n")
    poses = read_kitti_poses(path)
    assert poses.shape == (2, 4, 4)
    np.testing.assert_array_equal(
        poses[0], [[1, 0, 0, 5], [0, 1, 0, 6], [0, 0, 1, 7], [0, 0, 0, 1]]
    )
    np.testing.assert_array_equal(poses[1, :2, :2], [[0, -1], [1, 0]])


def test_tums_poses_keep_every_nanosecond(tmp_path):
    path = tmp_path / "tum.txt"
    quaternion = Rotation.from_rotvec([0.1, 0.2, 0.3]).as_quat()
    words = " ".join(map(str, quaternion))
    path.write_text(f"# time x y z\n1305031102.175304123 1 2 3 {words}\n-0.5 0 0 0 0 0 0 1 # end\n")
    stamps, poses = read_tum_poses(path)
    assert stamps.tolist() == [1305031102175304123, -500_000_000]
    np.testing.assert_allclose(
        poses[0, :3, :3], Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix(), atol=1e-12
    )
    np.testing.assert_array_equal(poses[0, :3, 3], [1, 2, 3])
    path.write_text("1.5e3 0 0 0 0 0 0 1\n")
    assert read_tum_poses(path)[0].tolist() == [1_500_000_000_000]


def test_oxts_are_metres_from_the_first_frame(tmp_path):
    """0.0001 degrees of latitude are 11.1 m north, of longitude 7.3 m east at 49 degrees."""
    paths = []
    for number, (latitude, longitude, yaw) in enumerate([(49, 8, 0), (49.0001, 8.0001, 0.5)]):
        paths.append(tmp_path / f"{number:010d}.txt")
        numbers = [latitude, longitude, 100 + number, 0, 0, yaw, *[0] * 24]
        paths[-1].write_text(" ".join(map(str, numbers)) + "\n")
    first, second = read_oxts_poses(paths)
    np.testing.assert_array_equal(first, np.eye(4))
    np.testing.assert_allclose(second[:3, 3], [7.30, 11.13, 1], atol=0.01)
    np.testing.assert_allclose(
        second[:3, :3], Rotation.from_rotvec([0, 0, 0.5]).as_matrix(), atol=1e-12
    )


@pytest.mark.parametrize(("read", "text"), [
    (read_kitti_poses, "1 2 3\n"), (read_kitti_poses, "1 0 0 0 0 1 0 0 0 0 1 nan\n"),
    (read_kitti_poses, "1 0 0 x 0 1 0 0 0 0 1 0\n"), (read_tum_poses, "0 0 0 0 0 0 0\n"),
    (read_tum_poses, "0 0 0 0 0 0 0 0\n"), (read_tum_poses, "1e300 0 0 0 0 0 0 1\n"),
    (lambda path: read_oxts_poses([path]), ""),
    (lambda path: read_oxts_poses([path]), "100 " + "0 " * 29),
    (lambda path: read_oxts_poses([path]), "49 8 0 0 0 90 " + "0 " * 24),
])  # fmt: skip
def test_other_files_are_refused(tmp_path, read, text):
    (tmp_path / "file.txt").write_text(text)
    for name in ("file", "missing"):
        with pytest.raises(InputError, match=name):
            read(tmp_path / f"{name}.txt")


def test_the_line_that_is_wrong_is_named(tmp_path):
    (tmp_path / "file.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n1 2\n")
    with pytest.raises(InputError, match="line 2"):
        read_kitti_poses(tmp_path / "file.txt")
