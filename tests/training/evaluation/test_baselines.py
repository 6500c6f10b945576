"""Classical completion by hand, and on the recorded stream against published-scale figures."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy import ndimage

from training.datasets.kitti_stream import KittiStream
from training.evaluation.baselines import ip_basic, nearest_fill
from training.evaluation.metrics import DepthScores
from training.lidar.split import LidarInput, frame_generator, split_lidar


@pytest.fixture(scope="module")
def stream():
    root = os.environ.get("SSDNET_DATA")
    if not root or not (Path(root) / "kitti_stream").is_dir():
        pytest.skip("SSDNET_DATA does not point to the recorded stream")
    return Path(root) / "kitti_stream"


def one_point(depth_m, size=(60, 80), at=(40, 30)):
    sparse_depth = np.zeros(size, dtype=np.float32)
    sparse_depth[at] = depth_m
    return sparse_depth


# Nearest filling


def test_nearest_fill_equals_loops():
    rng = np.random.default_rng(0)
    sparse_depth = np.where(rng.random((9, 13)) < 0.1, rng.random((9, 13)) * 50, 0)
    sparse_depth = sparse_depth.astype(np.float32)
    sparse_depth[0, 0], sparse_depth[8, 12] = np.nan, -3.0  # no measurements
    measured = [(v, u) for v, u in np.ndindex(9, 13) if sparse_depth[v, u] > 0]
    filled = nearest_fill(sparse_depth)
    for v, u in np.ndindex(9, 13):
        distances = {(a - v) ** 2 + (b - u) ** 2: [] for a, b in measured}
        for a, b in measured:
            distances[(a - v) ** 2 + (b - u) ** 2].append(sparse_depth[a, b])
        assert filled[v, u] in distances[min(distances)]


@pytest.mark.parametrize("complete", [nearest_fill, ip_basic])
def test_without_measurements_there_is_no_depth(complete):
    filled = complete(np.zeros((40, 50), dtype=np.float32))
    assert filled.dtype == np.float32
    assert filled.shape == (40, 50)
    assert not filled.any()


# IP-Basic


def ip_basic_in_scipy(sparse_depth, max_depth_m):
    """The published steps once more, with SciPy's filters and a loop over the columns."""

    def dilate(x, kernel):
        return ndimage.grey_dilation(x, footprint=kernel, mode="constant", cval=-np.inf)

    def erode(x, kernel):
        return ndimage.grey_erosion(x, footprint=kernel, mode="constant", cval=np.inf)

    def full(size):
        return np.ones((size, size), dtype=bool)

    diamond = np.array(
        [[0, 0, 1, 0, 0], [0, 1, 1, 1, 0], [1, 1, 1, 1, 1], [0, 1, 1, 1, 0], [0, 0, 1, 0, 0]]
    ).astype(bool)
    x = np.where(sparse_depth > 0.1, max_depth_m - sparse_depth.astype(np.float64), 0)
    x = dilate(x, diamond)
    x = erode(dilate(x, full(5)), full(5))
    x = np.where(x > 0.1, x, dilate(x, full(7)))
    for column in x.T:
        known = np.nonzero(column > 0.1)[0]
        if known.size:
            column[: known[0]] = column[known[0]]
    x = np.where(x > 0.1, x, dilate(x, full(31)))
    x = ndimage.median_filter(x, size=5, mode="nearest")
    known = x > 0.1
    taps = np.array([1, 4, 6, 4, 1]) / 16
    blurred = ndimage.correlate1d(
        ndimage.correlate1d(x, taps, 0, mode="mirror"), taps, 1, mode="mirror"
    )
    return np.where(known, max_depth_m - np.where(known, blurred, x), 0)


@pytest.mark.parametrize("share", [0.001, 0.01, 0.1])
def test_ip_basic_equals_scipy(share):
    rng = np.random.default_rng(0)
    shape = (90, 130)
    sparse_depth = np.where(rng.random(shape) < share, 2 + 78 * rng.random(shape), 0)
    sparse_depth = sparse_depth.astype(np.float32)
    ours = ip_basic(sparse_depth, max_depth_m=90.0)
    np.testing.assert_allclose(ours, ip_basic_in_scipy(sparse_depth, 90.0), atol=1e-3)


def test_ip_basic_spreads_one_point_and_extends_its_columns_up():
    filled = ip_basic(one_point(20.0))
    assert filled[40, 30] == pytest.approx(20.0, abs=1e-4)
    assert filled[0, 30] == pytest.approx(20.0, abs=1e-4)  # top of its column
    known = filled > 0
    inside = cv2.erode(known.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    np.testing.assert_allclose(filled[inside], 20.0, atol=1e-4)
    # Dilated by 2, closed, by 3, then by 15 around the column: 30 +- 20 wide, 40 + 20 deep.
    assert known[10, 10:51].all()
    assert not known[10, :10].any()
    assert not known[10, 51:].any()
    assert known[:60, 30].all()


def test_ip_basic_without_extrapolation_stays_near_the_point():
    known = ip_basic(one_point(20.0), extrapolate=False) > 0
    rows, columns = np.nonzero(known)
    # The diamond's tips are rounded by the median; the 7x7 square reaches 2 + 3 pixels.
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (35, 45, 25, 35)


def test_ip_basic_lets_near_surfaces_win():
    sparse_depth = one_point(50.0)
    sparse_depth[40, 32] = 10.0
    filled = ip_basic(sparse_depth)
    # Between the two, in reach of both dilations, the nearer one stands.
    assert filled[40, 31] < 30.0
    assert filled[40, 32] == pytest.approx(10.0, abs=2.0)


def test_ip_basic_counts_what_is_out_of_range_as_no_measurement():
    for value in (0.05, 100.0, 250.0, np.inf, np.nan, -5.0):
        assert not ip_basic(one_point(value)).any(), value
    assert ip_basic(one_point(250.0), max_depth_m=300.0)[40, 30] == pytest.approx(250.0, abs=1e-3)


def test_ip_basic_keeps_a_plane():
    # A ground plane on every fifth row comes back within the spacing's error.
    depth = np.repeat(np.linspace(40, 10, 100, dtype=np.float32)[:, None], 80, axis=1)
    sparse_depth = np.zeros_like(depth)
    sparse_depth[::5, ::2] = depth[::5, ::2]
    filled = ip_basic(sparse_depth)
    assert (filled > 0).all()
    assert np.abs(filled - depth)[10:-10].max() < 2.5


def test_baselines_on_withheld_scan_lines(stream):
    """Frames 50-59, every second line fed: near the 0.5 m / 2.4 m these methods come to there."""
    scores = {nearest_fill: DepthScores(), ip_basic: DepthScores()}
    source = KittiStream(stream, first=50, last=59)
    for index in range(0, 10, 3):
        frame = split_lidar(source[index], LidarInput("own"), frame_generator(index))
        for complete, score in scores.items():
            score.update(complete(frame.fed), frame.target)
    nearest, morphology = (score.compute() for score in scores.values())
    assert 0.40 < morphology.mae_m < nearest.mae_m < 0.60
    assert 1.9 < morphology.rmse_m < nearest.rmse_m < 3.0
