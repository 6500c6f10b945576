"""The crop with most pixels of the rare classes."""

import numpy as np
import pytest

from training.loading.crop_choice import choose_crop

POLE, SIGN, ROAD = 2, 6, 3


@pytest.fixture
def labels():
    """Road; a pole of 6 px, a sign of 4 px, and a large car."""
    semantic = np.full((20, 40), ROAD, np.uint8)
    semantic[4:10, 5] = POLE
    semantic[2:4, 30:32] = SIGN
    semantic[10:, 20:40] = 8
    return semantic


@pytest.mark.parametrize(
    ("classes", "expected"),
    [([POLE], (4, 0)), ([SIGN], (0, 25)), ([POLE, SIGN], (4, 0)), ([8], (10, 25)), ([10], (0, 0))],
)
def test_most_pixels_of_the_classes_win_and_ties_keep_the_first(labels, classes, expected):
    offsets = [(0, 0), (4, 0), (0, 25), (10, 25)]
    assert choose_crop(labels, (6, 12), offsets, classes) == expected
    labels[:4] = np.where(labels[:4] == SIGN, ROAD, labels[:4])
    assert choose_crop(labels, (6, 12), offsets, [SIGN]) == (0, 0)


def test_a_window_larger_than_the_image_covers_it(labels):
    assert choose_crop(labels, (30, 50), [(-8, -4), (-2, 0)], [POLE]) == (-8, -4)
    assert choose_crop(labels, (30, 12), [(-8, 25), (-2, 0)], [POLE]) == (-2, 0)


def test_unknown_pixels_are_no_class(labels):
    labels[:, :10] = 255
    assert choose_crop(labels, (6, 12), [(4, 0), (0, 25)], [POLE, SIGN]) == (0, 25)


def test_of_random_windows_the_choice_shows_more(labels):
    rng = np.random.default_rng(0)

    def draw():
        return int(rng.integers(0, 15)), int(rng.integers(0, 29))

    def shown(count):
        pixels = 0
        for _ in range(200):
            top, left = choose_crop(labels, (6, 12), [draw() for _ in range(count)], [POLE, SIGN])
            window = labels[top : top + 6, left : left + 12]
            pixels += np.isin(window, (POLE, SIGN)).sum()
        return pixels

    assert shown(4) > 2 * shown(1)
