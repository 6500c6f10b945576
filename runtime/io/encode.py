"""Encode heads and pictures as the content of PNG and JPEG files.

Encoding shares the processor with inference, so the settings are the cheapest ones.
"""

from collections.abc import Callable
from itertools import chain
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.heads import Encoding

METRES_PNG_SCALE = 256  # units of a 16-bit PNG per metre, as KITTI has it
METRES_PNG_MAX_M = 65535 / METRES_PNG_SCALE
_PNG_STORED = {cv2.IMWRITE_PNG_COMPRESSION: 0, cv2.IMWRITE_PNG_FILTER: cv2.IMWRITE_PNG_FILTER_NONE}
_PNG_RUNS = _PNG_STORED | {
    cv2.IMWRITE_PNG_COMPRESSION: 1,
    cv2.IMWRITE_PNG_STRATEGY: cv2.IMWRITE_PNG_STRATEGY_RLE,
}


def encode_ids(ids: NDArray[np.uint8]) -> memoryview:
    """Encode class ids as an 8-bit PNG."""
    return _encode(".png", ids, _PNG_RUNS)


def encode_metres(metres: NDArray[np.float32]) -> memoryview:
    """Encode metres as a 16-bit PNG, metres x 256 rounded; beyond 255.99 m it holds 65535."""
    near = np.clip(metres, 0, METRES_PNG_MAX_M)
    return _encode(".png", np.rint(near * METRES_PNG_SCALE).astype(np.uint16), _PNG_STORED)


def encode_probability(probability: NDArray[np.float32]) -> memoryview:
    """Encode probabilities as an 8-bit PNG, probability x 255 rounded."""
    return _encode(".png", cv2.convertScaleAbs(probability, alpha=255), _PNG_STORED)


def encode_png(picture: NDArray[np.uint8]) -> memoryview:
    """Encode a picture (H, W, 3), blue first, as a PNG."""
    return _encode(".png", picture, {})


def encode_jpeg(picture: NDArray[np.uint8], *, quality: int = 85) -> memoryview:
    """Encode a picture (H, W, 3), blue first, as a JPEG.

    Raises:
        ValueError: if a side is too long for the format.
    """
    return _encode(".jpg", picture, {cv2.IMWRITE_JPEG_QUALITY: quality})


#: Encoding of a head -> function that encodes its array as the content of a file.
ENCODERS: dict[Encoding, Callable[[NDArray[Any]], memoryview]] = {
    Encoding.IDS_PNG: encode_ids,
    Encoding.METRES_PNG: encode_metres,
    Encoding.PROBABILITY_PNG: encode_probability,
}


def _encode(suffix: str, image: Any, parameters: dict[int, int]) -> memoryview:
    done, content = cv2.imencode(suffix, image, list(chain(*parameters.items())))
    if not done:
        raise ValueError(f"{image.shape[0]} x {image.shape[1]} is too large for {suffix}")
    return content.ravel().data
