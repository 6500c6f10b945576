"""Points fall into the pixels where a plain loop in float64 puts them."""

import numpy as np
import pytest

from runtime import InputError, project_points
from runtime.geometry.projection import project_with_rows

SIZE = (24, 60)
K = np.array([[30.0, 0, 29.5], [0, 30.0, 11.5], [0, 0, 1]])
# Of a LiDAR (x ahead, y left, z up) 0.3 m behind and 0.1 m above the camera.
LIDAR_TO_CAMERA = np.array([[0.0, -1, 0, 0], [0, 0, -1, -0.1], [1, 0, 0, -0.3], [0, 0, 0, 1]])


def in_image(points):
    """(u, v, depth) of each point by the definition, float64 (N, 3)."""
    camera = points[:, :3].astype(np.float64) @ LIDAR_TO_CAMERA[:3, :3].T + LIDAR_TO_CAMERA[:3, 3]
    pixels = camera @ K.T
    return np.column_stack([pixels[:, 0] / pixels[:, 2], pixels[:, 1] / pixels[:, 2], camera[:, 2]])


def loop(points):
    """Depth and row of each pixel, point by point."""
    depth, rows = np.zeros(SIZE), np.full(SIZE, -1)
    for row, (u, v, z) in enumerate(in_image(points)):
        pixel = round(v), round(u)
        inside = 0 <= pixel[0] < SIZE[0] and 0 <= pixel[1] < SIZE[1]
        if z > 0 and inside and (depth[pixel] == 0 or z < depth[pixel]):
            depth[pixel], rows[pixel] = z, row
    return depth, rows


def scan(count, seed):
    """Points on all sides, with reflectance; none within 1e-3 px of the border of two pixels."""
    rng = np.random.default_rng(seed)
    points = (rng.normal(size=(count, 4)) * [20, 20, 5, 1]).astype(np.float32)
    uv = in_image(points)[:, :2]
    return points[(np.abs(uv - np.floor(uv) - 0.5) > 1e-3).all(axis=1)]


def visible(points):
    """Return whether each point falls into the image, even behind a nearer one."""
    u, v, z = np.rint(in_image(points)).T
    return (z > 0) & (u >= 0) & (u < SIZE[1]) & (v >= 0) & (v < SIZE[0])


@pytest.mark.parametrize("seed", range(3))
def test_is_what_a_plain_loop_does(seed):
    points = scan(4000, seed)
    depth, rows = loop(points)
    projected = project_with_rows(points, K, LIDAR_TO_CAMERA, SIZE)
    assert projected.sparse_depth.dtype == np.float32
    assert np.count_nonzero(depth) > 300
    assert np.count_nonzero(depth) < 0.8 * np.count_nonzero(visible(points))
    np.testing.assert_array_equal(projected.rows, rows)
    np.testing.assert_allclose(projected.sparse_depth, depth, rtol=1e-5)


def at(u, v, depth):
    """A point in the LiDAR's frame that falls at (u, v) in this depth."""
    camera = depth * np.linalg.inv(K) @ (u, v, 1)
    return (np.linalg.inv(LIDAR_TO_CAMERA) @ (*camera, 1))[:3]


def project(*points):
    return project_points(np.array(points, np.float32), K, LIDAR_TO_CAMERA, SIZE)


@pytest.mark.parametrize(("u", "v", "pixel"), [
    (7.49, 5.49, (5, 7)), (6.51, 4.51, (5, 7)), (-0.49, -0.49, (0, 0)), (59.49, 23.49, (23, 59)),
])  # fmt: skip
def test_integers_are_pixel_centres(u, v, pixel):
    depth = project(at(u, v, 10.0))
    assert np.argwhere(depth).tolist() == [list(pixel)]
    assert depth[pixel] == pytest.approx(10.0, rel=1e-6)


@pytest.mark.parametrize(("u", "v"), [(-0.51, 3), (59.51, 3), (3, -0.51), (3, 23.51)])
def test_what_falls_beside_the_picture_is_left_out(u, v):
    assert not project(at(u, v, 10.0)).any()


def test_of_equal_returns_the_first_is_named():
    points = np.array([at(5, 5, 8.0)] * 3, np.float32)
    assert project_with_rows(points, K, LIDAR_TO_CAMERA, SIZE).rows[5, 5] == 0


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 3e38])
@pytest.mark.parametrize("place", range(3))
def test_points_that_are_not_finite_are_left_out(bad, place):
    points = np.array([at(5, 5, 8.0), at(9, 9, 8.0)], np.float32)
    points[0, place] = bad
    with np.errstate(all="raise"):
        depth = project_points(points, K, LIDAR_TO_CAMERA, SIZE)
    assert np.argwhere(depth).tolist() == [[9, 9]]


@pytest.mark.parametrize(("key", "value"), [
    ("points", np.zeros((5, 3))), ("points", np.zeros((5, 2), np.float32)),
    ("intrinsics", K.astype(int)), ("intrinsics", K[:2]), ("intrinsics", K * np.nan),
    ("intrinsics", K.T), ("intrinsics", np.ma.masked_less(K, 1)),
    ("intrinsics", np.diag([-1.0, 1, 1])), ("intrinsics", np.diag([1e300, 1, 1])),
    ("extrinsics", LIDAR_TO_CAMERA[:3]), ("extrinsics", LIDAR_TO_CAMERA.T),
    ("size", 5), ("size", (0, 5)), ("size", (10**6, 10**6)),
])  # fmt: skip
def test_other_inputs_are_named(key, value):
    arguments = {"points": scan(5, 0), "intrinsics": K, "extrinsics": LIDAR_TO_CAMERA, "size": SIZE}
    with pytest.raises(InputError, match=key):
        project_points(**arguments | {key: value})
