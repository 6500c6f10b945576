"""IP-Basic by hand, and against its published steps in SciPy's filters and plain loops."""

import cv2
import numpy as np
import pytest
from scipy import ndimage

from training.evaluation.classical.ip_basic import IPBasic, IPBasicMultiscale


def complete(sparse_depth, method=IPBasic):
    rgb = np.zeros((*sparse_depth.shape, 3), np.uint8)
    return method().complete(rgb, sparse_depth)


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


def ip_basic_in_scipy(sparse_depth):
    """The published steps once more, with SciPy's filters and a loop over the columns."""
    diamond = np.array(
        [[0, 0, 1, 0, 0], [0, 1, 1, 1, 0], [1, 1, 1, 1, 1], [0, 1, 1, 1, 0], [0, 0, 1, 0, 0]]
    ).astype(bool)
    x = np.where(sparse_depth > 0.1, 100 - sparse_depth.astype(np.float64), 0)
    x = dilate(x, diamond)
    x = close(x, full(5))
    x = np.where(x > 0.1, x, dilate(x, full(7)))
    extend(x)
    x = np.where(x > 0.1, x, dilate(x, full(31)))
    x = ndimage.median_filter(x, size=5, mode="nearest")
    return np.where(x > 0.1, 100 - blur(x), 0)


@pytest.mark.parametrize("share", [0.001, 0.01, 0.1])
def test_ip_basic_equals_scipy(share):
    sparse_depth = random_returns(share)
    ours = complete(sparse_depth)
    np.testing.assert_allclose(ours, ip_basic_in_scipy(sparse_depth), atol=1e-3)


def multiscale_in_scipy(sparse_depth):
    """Repeat the steps of the method, pixel by pixel where a range or a column decides."""
    height, width = sparse_depth.shape
    x = np.zeros((height, width))
    for size, low, high in ((3, 30.0, np.inf), (5, 15.0, 30.0), (7, 0.1, 15.0)):
        reach = size // 2
        dilated = np.zeros_like(x)
        for v, u in zip(*np.nonzero(sparse_depth), strict=True):
            if low < sparse_depth[v, u] <= high:
                value = 100 - float(sparse_depth[v, u])
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
    smooth = cv2.bilateralFilter(x.astype(np.float32), 5, 1.5, 2.0)
    return np.where(x > 0.1, 100 - smooth, 0)


@pytest.mark.parametrize("share", [0.003, 0.03])
def test_the_multiscale_variant_equals_scipy(share):
    sparse_depth = random_returns(share)
    ours = complete(sparse_depth, IPBasicMultiscale)
    np.testing.assert_allclose(ours, multiscale_in_scipy(sparse_depth), atol=1e-3)
