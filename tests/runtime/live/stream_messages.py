"""Messages for a stream, and the check that each of them is accounted for."""

import numpy as np


def image(value=0):
    rgb = np.full((32, 40, 3), value % 256, np.uint8)
    rgb[0, 0] = 255 - rgb[0, 0]
    return rgb


def depth(value=0):
    return np.full((32, 40), 1 + value % 50, np.float32)


def push_image(stream, number):
    stream.push_image(image(number), number / 10)


def push_depth(stream, number):
    stream.push_depth(depth(number), number / 10)


def push_pair(stream, number):
    push_image(stream, number)
    push_depth(stream, number)


def add_up(counts):
    """Check that every message is accounted for, and return the counts."""
    for of in (counts.images, counts.depths, counts):
        others = sum(sum(each.values()) for each in (of.dropped, of.unmatched, of.errors))
        assert of.pushed == of.answered + of.pending + others
        assert of.pending >= 0
    return counts
