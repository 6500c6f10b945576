"""IP-Basic by hand, and against its published steps in SciPy's filters and plain loops."""

import cv2
import numpy as np
import pytest

from training.evaluation.classical.ip_basic import IPBasic, IPBasicMultiscale

ndimage = pytest.importorskip("scipy.ndimage")


def ip_basic(sparse_depth, method=IPBasic, **settings):
    rgb = np.zeros((*sparse_depth.shape, 3), np.uint8)
    return method(**settings).complete(rgb, sparse_depth)


def one_point(depth_m, size=(60, 80), at=(40, 30)):
    sparse_depth = np.zeros(size, dtype=np.float32)
    sparse_depth[at] = depth_m
    return sparse_depth


def random_returns(share, shape=(90, 130)):
    rng = np.random.default_rng(0)
    sparse_depth = np.where(rng.random(shape) < share, 2 + 78 * rng.random(shape), 0)
    return sparse_depth.astype(np.float32)


def dilate(x, kernel):
    return ndimage.grey_dilation(x, footprint=kernel, mode="constant", cval=-np.inf)


def close(x, kernel):
    wide = dilate(x, kernel)
    return ndimage.grey_erosion(wide, footprint=kernel, mode="constant", cval=np.inf)


def full(size):
    return np.ones((size, size), dtype=bool)


def extend(x):
    for column in x.T:
        known = np.nonzero(column > 0.1)[0]
        if known.size:
            column[: known[0]] = column[known[0]]


def blur(x):
    taps = np.array([1, 4, 6, 4, 1]) / 16
    once = ndimage.correlate1d(x, taps, 0, mode="mirror")
    return ndimage.correlate1d(once, taps, 1, mode="mirror")


def ip_basic_in_scipy(sparse_depth, max_depth_m):
    """The published steps once more, with SciPy's filters and a loop over the columns."""
    diamond = np.array(
        [[0, 0, 1, 0, 0], [0, 1, 1, 1, 0], [1, 1, 1, 1, 1], [0, 1, 1, 1, 0], [0, 0, 1, 0, 0]]
    ).astype(bool)
    x = np.where(sparse_depth > 0.1, max_depth_m - sparse_depth.astype(np.float64), 0)
    x = dilate(x, diamond)
    x = close(x, full(5))
    x = np.where(x > 0.1, x, dilate(x, full(7)))
    extend(x)
    x = np.where(x > 0.1, x, dilate(x, full(31)))
    x = ndimage.median_filter(x, size=5, mode="nearest")
    known = x > 0.1
    return np.where(known, max_depth_m - blur(x), 0)


@pytest.mark.parametrize("share", [0.001, 0.01, 0.1])
def test_ip_basic_equals_scipy(share):
    sparse_depth = random_returns(share)
    ours = ip_basic(sparse_depth, max_depth_m=90.0)
    np.testing.assert_allclose(ours, ip_basic_in_scipy(sparse_depth, 90.0), atol=1e-3)


def test_ip_basic_dilates_one_point_and_extends_its_columns_up():
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


# The variant of many scales


def multiscale_in_scipy(sparse_depth, max_depth_m):
    """Its steps once more, pixel by pixel where a range or a column decides."""
    height, width = sparse_depth.shape
    x = np.zeros((height, width))
    for size, low, high in ((3, 30.0, np.inf), (5, 15.0, 30.0), (7, 0.1, 15.0)):
        reach = size // 2
        dilated = np.zeros_like(x)
        for v, u in zip(*np.nonzero(sparse_depth), strict=True):
            if low < sparse_depth[v, u] <= high:
                value = max_depth_m - float(sparse_depth[v, u])
                for step in range(-reach, reach + 1):
                    for row, column in ((v + step, u), (v, u + step)):
                        if 0 <= row < height and 0 <= column < width:
                            dilated[row, column] = max(dilated[row, column], value)
        x = np.where(dilated > 0.1, dilated, x)
    x = close(x, full(5))
    x = np.where(x > 0.1, ndimage.median_filter(x, size=5, mode="nearest"), x)
    below = np.maximum.accumulate(x > 0.1, axis=0)
    x = np.where((x <= 0.1) & below, dilate(x, full(9)), x)
    extend(x)
    below = np.maximum.accumulate(x > 0.1, axis=0)
    for _ in range(6):
        x = np.where((x <= 0.1) & below, dilate(x, full(5)), x)
    x = np.where(x > 0.1, ndimage.median_filter(x, size=5, mode="nearest"), x)
    known = x > 0.1
    x = np.where(known, blur(x), x)
    return np.where(x > 0.1, max_depth_m - x, 0)


@pytest.mark.parametrize("share", [0.003, 0.03])
def test_the_multiscale_variant_equals_scipy(share):
    sparse_depth = random_returns(share)
    ours = ip_basic(sparse_depth, IPBasicMultiscale, blur="gaussian", max_depth_m=90.0)
    np.testing.assert_allclose(ours, multiscale_in_scipy(sparse_depth, 90.0), atol=1e-3)


# Both


@pytest.mark.parametrize("method", [IPBasic, IPBasicMultiscale])
def test_the_bilateral_blur_keeps_a_step_that_the_gaussian_softens(method):
    step = np.full((60, 80), 10.0, np.float32)
    step[:, 40:] = 30.0
    between = {}
    for blur_name in ("gaussian", "bilateral"):
        filled = ip_basic(step, method, blur=blur_name)
        between[blur_name] = int(((filled > 11) & (filled < 29)).sum())
    assert between["bilateral"] == 0
    assert between["gaussian"] > 0
