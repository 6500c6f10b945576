"""Sparse depth against hand-made scenes and the numbers of the sensor's data sheet."""

import numpy as np
import pytest

from training.lidar.split import beam_elevations, random_share, scan_line_index, scan_lines

KITTI = np.array([[721.5, 0, 609.6], [0, 721.5, 172.9], [0, 0, 1]])
EXACT = {"range_noise_m": 0.0, "drop_share": 0.0, "far_drop_share": 0.0, "pitch_jitter_deg": 0.0}


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
    degrees = np.rad2deg(beam_elevations(64))
    assert degrees[0] == pytest.approx(2.0)
    assert degrees[-1] == pytest.approx(-24.33)
    assert (np.diff(degrees) < 0).all()
    assert np.allclose(beam_elevations(16), beam_elevations(64)[::4])
    for lines in (1, 2, 4, 8, 16, 32):
        assert len(beam_elevations(lines)) == lines
        assert set(beam_elevations(lines)) < set(beam_elevations(2 * lines))
    assert np.rad2deg(beam_elevations(1)) == pytest.approx([-2 / 3])
    assert np.rad2deg(beam_elevations(4)) == pytest.approx([-2 / 3, -6, -12.83, -20.83])


def test_128_lines_have_one_between_every_two():
    fine = np.rad2deg(beam_elevations(128))
    assert len(fine) == 128
    np.testing.assert_allclose(np.deg2rad(fine[::2]), beam_elevations(64))
    assert (np.diff(fine) < -0.16).all()
    np.testing.assert_allclose(fine[1:-1:2], (fine[:-2:2] + fine[2::2]) / 2)
    assert fine[-1] == pytest.approx(-24.58)
    depth = np.full((375, 1242), 20.0, np.float32)
    hits = [
        np.count_nonzero(scan_lines(depth, KITTI, lines, np.random.default_rng(0), **EXACT))
        for lines in (64, 128)
    ]
    assert 1.8 < hits[1] / hits[0] <= 2.1


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


def test_a_wall_ahead_is_hit_where_the_beams_are():
    depth = np.full((375, 1242), 20.0, np.float32)
    sparse = scan_lines(depth, KITTI, 64, np.random.default_rng(0), **EXACT)
    assert np.unique(np.round(sparse, 4)).tolist() == [0.0, 20.0]
    rows = np.nonzero(sparse[:, 600:620].any(axis=1))[0]
    # 2 deg above to 15.6 deg below the horizon: 172.9 - 721.5 tan(2 deg) = 147.7 is the first row.
    assert rows[0] == 148
    assert rows[-1] > 365


@pytest.mark.parametrize(("lines", "low", "high"), [(64, 0.03, 0.05), (32, 0.015, 0.025)])
def test_density_is_that_of_kitti(lines, low, high):
    row = np.arange(375)[:, None] * np.ones((1, 1242))
    depth = np.where(row > 178, 1.65 * 721.5 / np.maximum(row - 172.9, 1), 40.0).astype(np.float32)
    sparse = scan_lines(depth, KITTI, lines, np.random.default_rng(3))
    assert low < np.count_nonzero(sparse) / sparse.size < high


def test_noise_is_along_the_ray_and_of_the_given_size():
    depth = np.full((375, 1242), 10.0, np.float32)
    quiet = {**EXACT, "range_noise_m": 0.05}
    sparse = scan_lines(depth, KITTI, 64, np.random.default_rng(0), **quiet)
    column = np.arange(1242) * np.ones((375, 1))
    seen = sparse > 0
    centre = seen & (np.abs(column - 609.6) < 100)
    side = seen & (column < 100)
    assert np.std(sparse[centre] - 10.0) == pytest.approx(0.05, rel=0.1)
    assert np.std(sparse[side] - 10.0) == pytest.approx(0.05 / 1.26, rel=0.12)


def test_far_returns_are_lost_more_often():
    near = np.full((375, 1242), 5.0, np.float32)
    far = np.full((375, 1242), 60.0, np.float32)
    lost = {**EXACT, "far_drop_share": 0.5, "drop_share": 0.1}
    hits = [
        np.count_nonzero(scan_lines(d, KITTI, 64, np.random.default_rng(0), **lost))
        for d in (near, far)
    ]
    full = np.count_nonzero(scan_lines(near, KITTI, 64, np.random.default_rng(0), **EXACT))
    assert hits[0] / full == pytest.approx(0.9, abs=0.01)
    assert hits[1] < 0.75 * full
