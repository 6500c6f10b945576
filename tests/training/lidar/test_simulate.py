"""Sparse depth against hand-made scenes and the numbers of the sensor's data sheet."""

import numpy as np
import pytest

from training.lidar.simulate import beam_elevations, random_share, scan_line_index, scan_lines

KITTI = np.array([[721.5, 0, 609.6], [0, 721.5, 172.9], [0, 0, 1]])


def test_random_share_keeps_that_share_unchanged():
    depth = np.full((200, 300), 7.0, np.float32)
    depth[:100] = 0
    sparse = random_share(depth, 0.05, np.random.default_rng(1))
    assert sparse.dtype == np.float32
    assert not sparse[:100].any()
    assert set(np.unique(sparse)) == {0.0, 7.0}
    assert np.count_nonzero(sparse) / 30000 == pytest.approx(0.05, abs=0.005)
    assert np.array_equal(random_share(depth, 1.0, np.random.default_rng(1)), depth)


def test_beams_span_the_field_of_the_hdl64():
    degrees = {lines: np.rad2deg(beam_elevations(lines)) for lines in (1, 2, 4, 8, 16, 32, 64, 128)}
    assert degrees[1] == pytest.approx([-2 / 3])
    assert degrees[4] == pytest.approx([-2 / 3, -6, -12.83, -20.83])
    assert degrees[64][[0, -1]] == pytest.approx([2.0, -24.33])
    for lines, of_beams in degrees.items():
        assert len(of_beams) == lines
        assert (np.diff(of_beams) < 0).all()
        assert lines == 1 or set(degrees[lines // 2]) < set(of_beams)
    fine = degrees[128]  # one more between every two, and one below
    np.testing.assert_allclose(fine[1:-1:2], (fine[:-2:2] + fine[2::2]) / 2)
    assert fine[-1] == pytest.approx(-24.58)


def test_a_line_is_one_elevation_angle():
    index = scan_line_index((375, 1242), KITTI, 16)
    row, column = np.nonzero(index == 5)
    direction = np.stack([(column - 609.6) / 721.5, (row - 172.9) / 721.5], axis=1)
    elevation = np.arctan2(-direction[:, 1], np.hypot(direction[:, 0], 1.0))
    half_a_pixel = 0.5 / 721.5
    assert len(row) > 400
    assert np.abs(elevation - beam_elevations(16)[5]).max() <= half_a_pixel * 1.01
    # The trace bends away from the horizon towards the sides.
    assert row[np.argmin(column)] > row[np.argmin(np.abs(column - 610))]

    # 2 deg above to 15.6 deg below the horizon: 172.9 - 721.5 tan(2 deg) = 147.7 is the first row.
    rows = np.nonzero((scan_line_index((375, 1242), KITTI, 64)[:, 600:620] >= 0).any(axis=1))[0]
    assert rows[0] == 148
    assert rows[-1] > 365


def simulate(depth_m, lines=64, seed=0):
    depth = np.broadcast_to(np.float32(depth_m), (375, 1242))
    return scan_lines(depth, KITTI, lines, np.random.default_rng(seed))


@pytest.mark.parametrize(
    ("lines", "low", "high"), [(128, 0.06, 0.09), (64, 0.03, 0.05), (32, 0.015, 0.025)]
)
def test_density_is_that_of_kitti(lines, low, high):
    row = np.arange(375)[:, None] * np.ones((1, 1242))
    depth = np.where(row > 178, 1.65 * 721.5 / np.maximum(row - 172.9, 1), 40.0)
    sparse = simulate(depth, lines)
    assert low < np.count_nonzero(sparse) / sparse.size < high


def test_noise_is_along_the_ray_and_each_scan_is_tilted():
    sparse, other = simulate(10.0), simulate(10.0, seed=1)
    column = np.arange(1242) * np.ones((375, 1))
    centre = (sparse > 0) & (np.abs(column - 609.6) < 100)
    side = (sparse > 0) & (column < 100)
    assert np.std(sparse[centre] - 10.0) == pytest.approx(0.02, rel=0.1)
    assert np.std(sparse[side] - 10.0) == pytest.approx(0.02 / 1.26, rel=0.12)
    rows = [set(np.nonzero(scan[:, 610])[0]) for scan in (sparse, other)]
    assert len(rows[0] & rows[1]) < 0.5 * len(rows[0])


def test_far_returns_are_lost_more_often():
    beams = np.count_nonzero(scan_line_index((375, 1242), KITTI, 64) >= 0)
    near, far = (np.count_nonzero(simulate(depth_m)) / beams for depth_m in (5.0, 60.0))
    assert near == pytest.approx(0.92, abs=0.02)
    assert far == pytest.approx(0.92 - 0.35 * (67 / 85) ** 2, abs=0.04)  # 60 m ahead: 67 m, about
    assert not simulate(86.0).any()
