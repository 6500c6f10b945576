"""Messages for a stream, and the check that each of them is accounted for."""

import numpy as np

from runtime.engine.prediction import Latency, Prediction
from runtime.streams.frame_result import FrameResult


def image(value=0):
    rgb = np.full((32, 40, 3), value % 256, np.uint8)
    rgb[-4:] = 200  # not dark
    rgb[0, 0] = 255 - rgb[0, 0]
    return rgb


def depth(value=0):
    return np.full((32, 40), 1 + value % 50, np.float32)


def push_image(stream, number):
    stream.push_image(image(number), number / 10)


def push_pair(stream, number):
    push_image(stream, number)
    stream.push_depth(depth(number), number / 10)


def add_up(counts):
    """Check that every message is accounted for, and return the counts."""
    for of in (counts.images, counts.depths, counts):
        others = sum(sum(each.values()) for each in (of.dropped, of.unmatched, of.errors))
        assert of.pushed == of.answered + of.pending + others
        assert of.pending >= 0
    return counts


def result(number=0, *, degraded=(), valid=True, **others):
    """The result of a stream that took 40 ms."""
    latency = Latency(0, 0, 0, 0)
    size = (32, 40)
    return FrameResult(
        sequence=number,
        rgb=image(number),
        prediction=Prediction({}, size, size, latency, valid=valid, degraded=degraded),
        predictor_reasons=degraded,
        image_stamp=number,
        latency_ms=40.0,
        age_ms=40.0,
        depth_reused="depth_reused" in degraded,
        **others,
    )
