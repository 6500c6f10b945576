"""Changes of a picture's colours."""

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from training.loading.augment_config import AugmentConfig


def move_histograms(
    rgb: NDArray[np.uint8], other: NDArray[np.uint8], share: float
) -> NDArray[np.uint8]:
    """Move the histogram of each channel towards that of another image; at share 1 they are equal.

    Neighbouring pixels look alike, so a sixteenth of them is counted.
    """
    values = np.arange(256)
    table = np.empty((1, 256, 3), np.uint8)
    for channel in range(3):
        ranks, wanted = (
            np.bincount(image[::4, ::4, channel].ravel(), minlength=256).cumsum()
            for image in (rgb, other)
        )
        matched = np.searchsorted(wanted * ranks[-1], ranks * wanted[-1])
        table[0, :, channel] = np.rint(values + share * (matched - values))
    return np.asarray(cv2.LUT(rgb, table), np.uint8)


def change_colors(
    rgb: NDArray[np.uint8], config: AugmentConfig, rng: Generator
) -> NDArray[np.uint8]:
    """Change brightness, contrast, saturation and hue; blur and add noise by probability."""

    def change(most: float) -> float:
        return rng.uniform(-most, most)

    gain = 1 + change(config.contrast)
    offset = 255 * change(config.brightness) * 0.5
    saturation = 0.0 if rng.random() < config.gray else 1 + change(config.saturation)
    hue = np.deg2rad(change(config.hue_deg))
    # One affine map of the colours does all four (YIQ rotation for the hue).
    to_yiq = np.array([[0.299, 0.587, 0.114], [0.596, -0.274, -0.322], [0.211, -0.523, 0.312]])
    cosine, sine = saturation * np.cos(hue), saturation * np.sin(hue)
    turn = np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]])
    matrix = gain * (np.linalg.inv(to_yiq) @ turn @ to_yiq)
    shift = np.full((3, 1), offset + 127.5 * (1 - gain))
    out = cv2.transform(rgb.astype(np.float32), np.hstack([matrix, shift]))
    if rng.random() < config.blur:
        out = cv2.GaussianBlur(out, (0, 0), rng.uniform(0.4, 1.2))
    if rng.random() < config.noise:
        out = out + rng.normal(0, rng.uniform(2, 10), rgb.shape).astype(np.float32)
    return np.clip(out, 0, 255).astype(np.uint8)
