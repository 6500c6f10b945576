"""From radiance to the image of a car camera."""

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from training.scenes.arrays import Floats
from training.scenes.rendering.weather import Weather


def expose(radiance: Floats, weather: Weather, rng: Generator) -> NDArray[np.uint8]:
    """Picture (H, W, 3) uint8 RGB of linear radiance (H, W, 3).

    Automatic exposure on the lower part of the picture (what a driver's camera meters), a soft
    shoulder, vignette, slight blur, shot and read noise, sRGB-like gamma.
    """
    height, width = radiance.shape[:2]
    metered = radiance[height // 3 :: 4, ::4].mean(axis=2)
    key = float(np.exp(np.log(metered + 1e-3).mean()))
    image: Floats = radiance * np.float32(0.17 / key * 2.0**weather.exposure)
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j].astype(np.float32)
    image *= (1 - 0.16 * (0.5 * x * x + 0.5 * y * y))[..., None]
    image = np.asarray(cv2.GaussianBlur(image, (3, 3), 0.48))
    shot = np.sqrt(np.clip(image, 0, 1)) * weather.noise + 0.4 * weather.noise
    image = image + shot * rng.standard_normal(image.shape, dtype=np.float32)
    image = np.clip(image, 0, None)
    # Linear up to 0.6; brighter values approach 1 exponentially.
    bright = np.where(image < 0.6, image, 0.6 + 0.4 * (1 - np.exp(-(image - 0.6) / 0.4)))
    return (255 * np.clip(bright, 0, 1) ** (1 / 2.2) + 0.5).astype(np.uint8)
