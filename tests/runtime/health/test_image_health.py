import numpy as np
import pytest

from runtime.health.image_health import ImageHealth


def noise(seed, low=0, high=256):
    return np.random.default_rng(seed).integers(low, high, (60, 80, 3), dtype=np.uint8)


def test_a_living_camera_is_healthy():
    health = ImageHealth()
    assert [health.check(noise(seed)) for seed in range(3)] == [()] * 3


def test_identical_bytes_are_frozen_and_one_other_byte_is_not():
    health = ImageHealth()
    rgb = noise(0)
    other = rgb.copy()
    other[33, 41, 1] ^= 1  # where not every pixel is looked at
    assert health.check(rgb) == ()
    assert health.check(rgb.copy()) == ("image_frozen",)
    assert health.check(other) == ()
    assert health.check(other.copy()) == ("image_frozen",)
    assert health.check(other[:40].copy()) == (), "another size"


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [(0, 13, ("image_black",)), (0, 30, ()), (250, 256, ("image_overexposed",)), (200, 256, ())],
)
def test_dark_and_bright_images(low, high, expected):
    assert ImageHealth().check(noise(0, low, high)) == expected


def test_half_a_bright_image_is_over_exposed_and_lights_at_night_are_not_black():
    rgb = noise(0, 30, 200)
    rgb[:24] = 255
    assert ImageHealth().check(rgb) == ()
    rgb[:32] = 255
    assert ImageHealth().check(rgb) == ("image_overexposed",)
    night = noise(0, 0, 10)
    night[:8, :8] = 255
    assert ImageHealth().check(night) == ()
