"""Checking, cleaning and resizing against hand-made cases and plain loops."""

import numpy as np
import pytest

from runtime import Cleaned, InputError
from runtime.contract.canonical_focal import CameraScale
from runtime.contract.degraded import SPARSE_DEPTH_LOW
from runtime.engine.preprocess import (
    check_rgb,
    check_sparse_depth,
    clean_sparse_depth,
    covers_little,
    preprocess,
)


@pytest.mark.parametrize(("rgb", "named"), [
    (np.zeros((40, 50, 3), np.float32), "float32"),
    (np.zeros((3, 40, 50), np.uint8), r"transpose\(1, 2, 0\)"),
    (np.zeros((40, 50), np.uint8), "grey"),
    (np.zeros((40, 50, 4), np.uint8), "alpha"),
    (np.zeros((31, 50, 3), np.uint8), "32 x 32"),
    (None, "NoneType"),
    (np.ma.zeros((40, 50, 3), np.uint8), "Masked"),
])  # fmt: skip
def test_other_pictures_are_refused(rgb, named):
    with pytest.raises(InputError, match=named):
        check_rgb(rgb)


@pytest.mark.parametrize(("depth", "named"), [
    (np.zeros((40, 50), np.uint16), "metres"), (np.zeros((40, 50), np.float64), "float32"),
    (np.zeros((40, 50, 1), np.float32), "40, 50, 1"), (np.zeros((50, 40), np.float32), "50, 40"),
    ([[1]], "list"), (np.ma.zeros((40, 50), np.float32), "masked"),
])  # fmt: skip
def test_other_depth_maps_are_refused(depth, named):
    with pytest.raises(InputError, match=named):
        check_sparse_depth(depth, size=(40, 50))


def test_each_kind_of_impossible_depth_is_counted_and_removed():
    depth = np.zeros((4, 5), np.float32)
    depth[0] = [5, 80, np.nan, np.nan, np.nan]
    depth[1] = [np.inf, -np.inf, -1, -0.001, -2]
    depth[2] = [80.01, 655.35, -0.0, 1e-3, 0]
    depth[3, :2] = 65535 / np.float32(1000), 65535 / np.float32(256)  # saturated 16 bits
    before = depth.copy()
    kept, cleaned, returns = clean_sparse_depth(depth, max_depth_m=80)
    assert cleaned == Cleaned(nan=4, infinite=2, negative=3, too_far=3)
    assert cleaned.total == 12
    assert sorted(kept[kept != 0].tolist()) == pytest.approx([1e-3, 5, 80, 80])
    assert returns == 4
    assert np.array_equal(depth, before, equal_nan=True), "the caller's array was written to"


@pytest.mark.parametrize(("range_m", "fed"), [
    (80.0, [0, 80, 80, 80, 0, 0]),
    (200.0, [0, 100, 200, 200, 0, 0]),
    (400.0, [0, 100, 201, 250, 251, 0]),
])  # fmt: skip
def test_a_return_beyond_the_range_is_fed_as_its_end(range_m, fed):
    """Up to what a LiDAR of a car can reach; 655 m is another unit, or the mark of no return."""
    depth = np.array([[0, 100, 201, 250, 251, 655.35]], np.float32)
    kept, cleaned, _ = clean_sparse_depth(depth, max_depth_m=range_m)
    np.testing.assert_array_equal(kept, [fed])
    assert cleaned == Cleaned(too_far=np.count_nonzero(depth > range_m))


@pytest.mark.parametrize("range_m", [80.0, 200.0, 400.0])
def test_the_networks_have_the_same_rule(range_m):
    torch = pytest.importorskip("torch", reason="the engine alone is installed")
    from models import create_model

    values = [0, -1, -0.0, 1e-3, 79, 81, 200, 201, 250, 251, 399, 401, 655.35, np.nan, np.inf]
    depth = np.array([[*values, -np.inf]], np.float32)
    kept, _, _ = clean_sparse_depth(depth, max_depth_m=range_m)
    network = create_model("ssdnet-nano", max_depth_m=range_m)
    share, measured = network.normalise_depth(torch.from_numpy(depth)[None, None])
    np.testing.assert_array_equal(measured[0, 0].numpy(), kept > 0)
    np.testing.assert_allclose(share[0, 0].numpy() * range_m, kept, rtol=1e-6)


PLAIN = CameraScale(1.0, 80.0, None)


def scan_rows(size, lines, firings=450):
    """A LiDAR of so many level lines over the lower two thirds of a picture of any size."""
    depth = np.zeros(size, np.float32)
    rows = np.linspace(size[0] / 3, size[0] - 1, lines).astype(int)
    columns = np.linspace(0, size[1] - 1, firings).astype(int)
    depth[np.ix_(rows, columns)] = 9
    return depth


def flagged(depth):
    return covers_little(depth, returns=np.count_nonzero(depth))


@pytest.mark.parametrize("size", [(125, 414), (375, 1242), (1216, 1936), (2160, 3840)])
def test_few_returns_are_flagged_alike_for_every_camera(size):
    for lines in (64, 32, 16, 8, 4):
        assert not flagged(scan_rows(size, lines)), lines
    assert flagged(scan_rows(size, 1))
    assert flagged(scan_rows(size, 16, firings=20))


def test_returns_in_one_corner_are_few_where_the_frame_is_shrunk():
    """The 40,000 of the frame would be enough wherever they lie; the network gets 2,500."""
    depth = np.zeros((1280, 4160), np.float32)
    depth[:200, :200] = 5
    rgb = np.random.default_rng(0).integers(0, 256, (*depth.shape, 3), dtype=np.uint8)
    given = preprocess(rgb, depth, size_for=lambda _: (320, 1040), scale_for=lambda _: PLAIN)
    assert given.depth_returns == 40_000
    assert given.degraded == (SPARSE_DEPTH_LOW,)
