"""The factor between metres and canonical depth."""

import pytest

from runtime.canonical_focal import camera_scale, focal_length_at


def factor_of(canonical_focal_px, focal_length_px):
    size = (400, 600)
    scale = camera_scale(
        80.0, canonical_focal_px, focal_length_px, frame_size=size, network_size=size
    )
    return scale.factor


def test_metres_times_the_factor_are_canonical():
    assert factor_of(700.0, 1400.0) == 0.5
    assert factor_of(700.0, 350.0) == 2.0


def test_without_either_focal_length_depth_stays_in_metres():
    assert factor_of(None, 700.0) == factor_of(700.0, None) == 1.0


def test_the_focal_length_follows_the_picture():
    assert focal_length_at((200, 300), 800.0, (400, 600)) == pytest.approx(400.0)
    # Twice as high, half as wide: sqrt(2 f * f / 2).
    assert focal_length_at((800, 300), 800.0, (400, 600)) == pytest.approx(800.0)
