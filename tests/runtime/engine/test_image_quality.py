"""What an image shows of its camera, on small pictures and on a street in faulty pictures of it."""

import cv2
import numpy as np
import pytest

from runtime.engine.image_quality import ImageQuality, find_doubts, is_constant


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


def test_measures_are_those_of_pictures_counted_by_hand():
    rgb = np.zeros((32, 64, 3), np.uint8)
    rgb[:, 32:] = (200, 0, 0)
    rgb[:, 48:] = 255
    found = ImageQuality.measure(rgb)
    assert (found.sharpness, found.bright_share, found.saturated_share) == (1.0, 0.5, 0.25)
    ramp = np.repeat(np.arange(64, dtype=np.uint8)[None, :, None], 32, axis=0).repeat(3, axis=2)
    assert ImageQuality.measure(ramp).sharpness == pytest.approx(1 / 8)
