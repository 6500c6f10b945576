"""Colours say which of two values is larger, and the bar says what they mean."""

import cv2
import numpy as np
import pytest

from runtime.drawing.color_scale import NO_VALUE_COLOR, ColorScale

DEPTH = ColorScale("depth", "m", 3.0, 100.0, cv2.COLORMAP_MAGMA, bright_low=True)
PERCENT = ColorScale("uncertainty", "%", 1.0, 100.0, cv2.COLORMAP_VIRIDIS)


def lightness(picture: np.ndarray) -> np.ndarray:
    """L* of the CIE, 0..100: what an eye sees that tells no hues."""
    return cv2.cvtColor(picture.astype(np.float32) / 255, cv2.COLOR_BGR2Lab)[..., 0]


@pytest.mark.parametrize(("scale", "direction"), [(DEPTH, -1), (PERCENT, 1)])
def test_the_lightness_alone_tells_the_order(scale, direction):
    values = np.geomspace(scale.low, scale.high, 40, dtype=np.float32)[np.newaxis]
    steps = np.diff(direction * lightness(scale.paint(values))[0])
    assert steps.min() > 0.5
    assert steps.sum() > 70


def test_equal_ratios_look_equally_different():
    def index(value: float) -> int:
        steps = np.arange(256, dtype=np.uint8).reshape(-1, 1)
        colors = cv2.applyColorMap(steps, cv2.COLORMAP_VIRIDIS)
        (found,) = np.flatnonzero((colors[:, 0] == PERCENT.paint(np.float32([[value]]))).all(-1))
        return int(found)

    assert [index(value) for value in (1, 10, 100)] == pytest.approx([0, 127.5, 255], abs=1)
    assert index(20) - index(10) == pytest.approx(index(4) - index(2), abs=2)


def test_what_is_beyond_an_end_takes_its_colour():
    values = np.float32([[-1, 0, 0.5, 3, 100, 1e4, np.inf]])
    colors = DEPTH.paint(values)[0].tolist()
    assert colors[:4] == [colors[3]] * 4
    assert colors[4:] == [colors[4]] * 3
    assert colors[3] != colors[4]


def test_only_what_is_hidden_has_no_value():
    values = np.geomspace(1, 200, 300, dtype=np.float32).reshape(3, 100)
    hidden = np.zeros((3, 100), bool)
    hidden[1, ::2] = True
    painted = DEPTH.paint(values, hidden=hidden)
    assert np.array_equal((painted == NO_VALUE_COLOR).all(axis=-1), hidden)
    assert np.array_equal(painted[~hidden], DEPTH.paint(values)[~hidden])


@pytest.mark.parametrize("width", [32, 200, 1242])
def test_the_bar_has_the_colours_of_its_values(width):
    bar = DEPTH.draw_bar(width, 22)
    assert bar.shape == (22, width, 3)
    for share in (0.3, 0.7):
        x = round(share * (width - 1))
        color = DEPTH.paint(np.float32([[3 * (100 / 3) ** (x / (width - 1))]]))[0, 0]
        assert np.abs(bar[3, x].astype(int) - color).max() <= 3  # above the words
