"""The factor between metres and canonical depth."""

import pytest

from runtime.canonical_focal import canonical_factor, focal_length_at


def test_metres_times_the_factor_are_canonical():
    assert canonical_factor(700.0, 1400.0) == 0.5
    assert canonical_factor(700.0, 350.0) == 2.0


def test_without_either_focal_length_depth_stays_in_metres():
    assert canonical_factor(None, 700.0) == canonical_factor(700.0, None) == 1.0


def test_the_focal_length_follows_the_picture():
    assert focal_length_at((200, 300), 800.0, (400, 600)) == pytest.approx(400.0)
    # Twice as high, half as wide: sqrt(2 f * f / 2).
    assert focal_length_at((800, 300), 800.0, (400, 600)) == pytest.approx(800.0)
