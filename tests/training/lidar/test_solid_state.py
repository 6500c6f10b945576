"""Solid-state patterns have the shapes that they are named after."""

import numpy as np
import pytest

from training.lidar.solid_state import raster, rosette, solid_state_scan

SIZE = (375, 1242)
K = np.array([[721.5, 0, 620.5], [0, 721.5, 187.0], [0, 0, 1]])


def angles(looked):
    """Degrees right of and above the axis, of the pixels that are looked at."""
    row, column = np.nonzero(looked)
    x, y = (column - K[0, 2]) / K[0, 0], (row - K[1, 2]) / K[1, 1]
    azimuth = np.arctan(x)
    return np.rad2deg(azimuth), np.rad2deg(np.arctan(-y * np.cos(azimuth)))


@pytest.mark.parametrize("seed", range(4))
def test_a_rosette_is_round_and_densest_in_the_middle(seed):
    tall = (1200, 1242)
    centred = K + np.array([[0, 0, 0], [0, 0, 600 - 187.0], [0, 0, 0]])
    looked = rosette(tall, centred, np.random.default_rng(seed))
    row, column = np.nonzero(looked)
    azimuth = np.rad2deg(np.arctan((column - 620.5) / 721.5))
    elevation = np.rad2deg(np.arctan((600 - row) / 721.5 * np.cos(np.deg2rad(azimuth))))
    radius = np.hypot(azimuth, elevation - np.median(elevation))
    assert radius.max() < 38 + 3  # the largest sensor, and its tilt
    # Along the axes it reaches as far in every direction, as far as the picture shows.
    reach = [radius[mask].max() for mask in (azimuth > 0, azimuth < 0, elevation > 0)]
    assert max(reach) - min(reach) < 4
    inner, outer = radius < 0.3 * radius.max(), radius > 0.7 * radius.max()
    # The ring has (1 - 0.49) / 0.09 times the area of the middle.
    assert inner.sum() / 0.09 > 1.3 * outer.sum() / 0.51


@pytest.mark.parametrize("seed", range(4))
def test_a_raster_is_an_even_low_window(seed):
    looked = raster(SIZE, K, np.random.default_rng(seed))
    azimuth, elevation = angles(looked)
    assert 15 - 1 < np.ptp(elevation) <= 30  # as far as the picture shows it
    share = np.count_nonzero(looked) / looked.size
    assert 0.01 < share < 0.35
    left, right = np.count_nonzero(azimuth < 0), np.count_nonzero(azimuth > 0)
    assert left == pytest.approx(right, rel=0.05)


def test_a_scan_measures_what_is_there_and_no_sky():
    depth = np.full(SIZE, 20.0, np.float32)
    depth[:120] = 0
    before = depth.copy()
    shares = []
    for seed in range(8):
        scan = solid_state_scan(depth, K, np.random.default_rng(seed))
        assert scan.dtype == np.float32
        assert not scan[:120].any()
        np.testing.assert_allclose(scan[scan > 0], 20.0, atol=0.15)
        shares.append(np.count_nonzero(scan) / scan.size)
    assert min(shares) > 0.005
    assert max(shares) > 3 * min(shares)  # both patterns
    again = solid_state_scan(depth, K, np.random.default_rng(7))
    np.testing.assert_array_equal(again, scan)
    np.testing.assert_array_equal(depth, before)
