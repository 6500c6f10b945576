"""Steps of the logits that make training frames score best."""

import numpy as np
import pytest

from logit_offsets import rate

NAMES = ("sky", "road", "car")


def test_the_rates_are_counted_by_hand():
    logits = np.zeros((3, 2, 2), np.float16)
    logits[0, 0, 0] = logits[1, 0, 1] = logits[1, 1, 0] = logits[2, 1, 1] = 1.0
    labels = np.array([[0, 1], [2, 255]], np.uint8)  # the last is not scored
    mask = np.array([[0, 1], [0, 255]], np.uint8)
    none = np.zeros(3, np.float32)
    miou, road = rate([(logits, labels)], [(logits, mask)], none, NAMES)
    assert miou == pytest.approx((1 + 1 / 2 + 0) / 3)
    assert road == pytest.approx(1 / 2)
    # Less of the road: what was called so by mistake is the first class's, and what was right, too.
    less = np.array([0.0, -2.0, 0.0], np.float32)
    assert rate([(logits, labels)], [(logits, mask)], less, NAMES)[1] == 0.0
