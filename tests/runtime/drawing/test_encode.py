"""Heads as pictures: what is encoded comes back, rounded to the step of the format."""

import cv2
import numpy as np

from runtime.contract.heads import HEADS
from runtime.drawing.encode import ENCODERS, encode_ids, encode_metres, encode_probability


def decode(content: bytes):
    return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)


def test_metres_are_rounded_and_clipped_and_zero_stays_none():
    depth = np.array([[0, 1, 80.001, 1.5 / 256, 2.4 / 256, 255.999, 300, 1e9]], np.float32)
    image = decode(encode_metres(depth))
    assert image.dtype == np.uint16
    assert image.tolist() == [[0, 256, 20480, 2, 2, 65535, 65535, 65535]]


def test_probabilities_and_class_ids():
    boundary = np.array([[0, 0.5, 1, 0.2]], np.float32)
    assert decode(encode_probability(boundary)).tolist() == [[0, 128, 255, 51]]
    semantic = np.random.default_rng(0).integers(0, 255, (37, 41), dtype=np.uint8)
    assert np.array_equal(decode(encode_ids(semantic)), semantic)


def test_every_head_that_is_written_has_an_encoder():
    assert {head.unit for head in HEADS.values() if head.saved_as} <= ENCODERS.keys()
