"""What an image shows of its camera, on small pictures and on a street in faulty pictures of it."""

import cv2
import numpy as np
import pytest

from runtime.engine.image_quality import find_doubts, is_constant


@pytest.fixture(scope="module")
def street():
    """Rectangles of many colours and sizes, with a sensor's noise."""
    rng = np.random.default_rng(0)
    rgb = np.full((192, 320, 3), 120, np.uint8)
    for top, left, height, width in rng.integers(4, 120, (80, 4)):
        rgb[top : top + height, 2 * left : 2 * (left + width)] = rng.integers(20, 236, 3)
    return np.clip(rgb + rng.normal(0, 2, rgb.shape), 0, 255).astype(np.uint8)


def test_a_constant_picture_has_no_other_doubt():
    rgb = np.full((40, 50, 3), (7, 8, 9), np.uint8)
    assert find_doubts(rgb) == ("image_constant",)
    rgb[39, 49, 2] = 10
    assert not is_constant(rgb), "one pixel away from the sampled grid differs"
    rgb[0, 0] = 99
    assert not is_constant(rgb)


@pytest.mark.parametrize(("spoil", "doubts"), [
    (lambda rgb: rgb, ()),
    (lambda rgb: cv2.GaussianBlur(rgb, (0, 0), 0.8), ()),
    (lambda rgb: cv2.GaussianBlur(rgb, (0, 0), 3), ("image_blurred",)),
    (lambda rgb: cv2.GaussianBlur(rgb, (0, 0), 12), ("image_blurred",)),
    (lambda rgb: rgb // 2, ("image_dark",)),
    (lambda rgb: np.clip(rgb.astype(int) * 9, 0, 255).astype(np.uint8), ("image_overexposed",)),
])  # fmt: skip
def test_faulty_pictures_are_named(street, spoil, doubts):
    assert find_doubts(np.ascontiguousarray(spoil(street))) == doubts


@pytest.mark.parametrize(("width", "bright", "level", "doubts"), [
    (1, 32, (200, 200, 200), ()), (3, 32, (200, 200, 200), ()), (1, 32, (150, 0, 0), ()),
    (1, 32, (255, 255, 249), ()), (1, 24, (255, 255, 255), ()),
    (4, 32, (200, 200, 200), ("image_blurred",)), (1, 32, (149, 149, 149), ("image_dark",)),
    (1, 32, (255, 255, 255), ("image_overexposed",)),
])  # fmt: skip
def test_an_edge_is_measured_as_counted_by_hand(width, bright, level, doubts):
    """Black, and bright columns at the right, with an edge of this width between them."""
    share = np.clip((np.arange(64) - (63 - bright)) / width, 0, 1)[:, None]
    rgb = np.tile((share * level).astype(np.uint8), (32, 1, 1))
    assert find_doubts(rgb) == doubts
