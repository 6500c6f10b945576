"""The factor between metres and canonical depth."""

import pytest

from runtime.contract.canonical_focal import camera_scale


@pytest.mark.parametrize(("canonical_px", "focal_px", "network_size", "factor"), [
    (700.0, 1400.0, (400, 600), 0.5), (700.0, 350.0, (400, 600), 2.0),
    (None, 700.0, (400, 600), 1.0), (700.0, None, (400, 600), 1.0),
    (700.0, 700.0, (200, 300), 2.0),
    (700.0, 700.0, (800, 300), 1.0),  # twice as high, half as wide: sqrt(2 f * f / 2)
])  # fmt: skip
def test_metres_times_the_factor_are_canonical(canonical_px, focal_px, network_size, factor):
    scale = camera_scale(
        80.0, canonical_px, focal_px, frame_size=(400, 600), network_size=network_size
    )
    assert scale.factor == pytest.approx(factor)
    assert scale.range_m == pytest.approx(80 / factor)
