"""Scan lines by hand."""

import numpy as np

from training.datasets.scan_lines import elevation_bands, project_lines, scan_line_of


def test_scan_lines_by_hand():
    def points(*azimuths_deg):
        angle = np.radians(azimuths_deg)
        return np.stack([np.cos(angle), np.sin(angle), 0 * angle, 0 * angle], axis=1)

    # Straight ahead to the left, round, and back from the right; jitter is no new line.
    azimuths = [1, 20, 19.5, 40, -38, -2, 0.5, 30, -10, 5, 39, 2, -30, -20]
    lines = scan_line_of(points(*azimuths).astype(np.float32))
    assert lines.tolist() == [0, 0, 0, 0, 0, 0, 1, 1, 1, 2, 2, 3, 3, 3]
    assert lines.dtype == np.int16
    assert scan_line_of(np.zeros((0, 4), dtype=np.float32)).tolist() == []


def test_each_pixel_names_the_line_of_the_return_that_it_holds():
    """Three lines of a LiDAR in the camera; the lines overlap in two pixels."""
    intrinsics = np.array([[10.0, 0, 4], [0, 10, 3], [0, 0, 1]])
    extrinsics = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])

    def at(u, v, depth):
        return (depth, (4 - u) * depth / 10, (3 - v) * depth / 10)

    lines = [
        [at(3, 2, 9.0), at(1, 2, 9.0), at(7, 2, 9.0), at(6, 2, 5.0)],
        [at(3, 2, 7.0), at(6, 2, 6.0)],
        [at(3, 4, 8.0), at(6, 4, 8.0)],
    ]
    points = np.array([point for line in lines for point in line], np.float32)
    depth, line = project_lines(points, intrinsics, extrinsics, (6, 8))
    assert line.dtype == np.int16
    assert {(u, v): (depth[v, u], line[v, u]) for v, u in np.argwhere(line >= 0)} == {
        (3, 2): (7.0, 1),
        (1, 2): (9.0, 0),
        (7, 2): (9.0, 0),
        (6, 2): (5.0, 0),
        (3, 4): (8.0, 2),
        (6, 4): (8.0, 2),
    }
    assert ((line >= 0) == (depth > 0)).all()


def test_bands_of_elevation_without_and_with_intrinsics():
    depth = np.ones((101, 201), np.float32)
    depth[::2] = 0
    intrinsics = np.array([[200.0, 0, 100], [0, 200, 50], [0, 0, 1]])
    band = elevation_bands(depth, intrinsics)
    assert band.dtype == np.int16
    np.testing.assert_array_equal(band < 0, depth == 0)
    middle = band[1::2, 100]
    degrees = np.degrees(np.arctan((np.arange(1, 101, 2) - 50) / 200))
    expected = np.floor(degrees / 0.5) - np.floor(np.degrees(np.arctan(-50 / 200)) / 0.5)
    np.testing.assert_array_equal(middle, expected)
    # A line of a scan is bent towards the image's middle row at the sides.
    assert band[1, 0] > band[1, 100]
    assert band[99, 0] < band[99, 100]
    near = elevation_bands(depth, None)
    assert np.abs(near[1::2, 100] - middle).max() <= 1
