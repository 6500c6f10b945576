"""Faults of a camera: what lenses, exposure and sensors do to a picture."""

from collections.abc import Callable
from typing import Literal

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

Rgb = NDArray[np.uint8]
CameraFault = Literal[
    "blurred", "dark", "noisy", "overexposed", "covered", "black", "grey", "white"
]

# What each fault reaches at a strength of 1: the standard deviation of the blur [px], the share of
# the light that is left, and the electrons of a pixel that is full, of 1000 in a good picture.
MAX_BLUR_PX, LEAST_LIGHT, FEWEST_ELECTRONS = 15.0, 0.05, 8.0
_ELECTRONS, _READ_NOISE = 1000.0, 2.0


def _blurred(rgb: Rgb, strength: float, _: Generator) -> NDArray[np.float32]:
    """Out of focus, water or dirt on the lens."""
    return cv2.GaussianBlur(rgb, (0, 0), MAX_BLUR_PX * strength).astype(np.float32)


def _dark(rgb: Rgb, strength: float, rng: Generator) -> NDArray[np.float32]:
    """Too short an exposure: less light, and the noise of few electrons."""
    light = LEAST_LIGHT**strength
    return _sensed(rgb * np.float32(light), _ELECTRONS, rng)


def _noisy(rgb: Rgb, strength: float, rng: Generator) -> NDArray[np.float32]:
    """Few electrons and a high gain."""
    return _sensed(rgb, _ELECTRONS * (FEWEST_ELECTRONS / _ELECTRONS) ** strength, rng)


def _overexposed(rgb: Rgb, strength: float, _: Generator) -> NDArray[np.float32]:
    """Glare or too long an exposure."""
    return rgb * np.float32(1.0 + 4.0 * strength) + np.float32(150.0 * strength)


def _covered(rgb: Rgb, strength: float, rng: Generator) -> NDArray[np.float32]:
    """Half of the lens is covered, by mud or a leaf, from one of its four sides."""
    height, width = rgb.shape[:2]
    row, column = np.mgrid[:height, :width].astype(np.float32)
    place = (row / height, column / width)[int(rng.integers(2))]
    if rng.random() < 0.5:
        place = 1.0 - place
    clear = np.clip(10.0 * (place - 0.5 * strength), 0.0, 1.0)[..., None]
    return np.asarray(clear * rgb + (1.0 - clear) * rng.uniform(0, 100), np.float32)


def _blank(level: int) -> "Spoiler":
    def spoil(rgb: Rgb, strength: float, _: Generator) -> NDArray[np.float32]:
        return rgb + np.float32(strength) * (np.float32(level) - rgb)

    return spoil


def _sensed(
    rgb: NDArray[np.uint8] | NDArray[np.float32], full: float, rng: Generator
) -> NDArray[np.float32]:
    """Return what a sensor reads if `full` electrons are white: with shot noise and read noise."""
    electrons = rng.poisson(rgb * (full / 255.0)) + rng.normal(0.0, _READ_NOISE, rgb.shape)
    return (electrons * (255.0 / full)).astype(np.float32)


Spoiler = Callable[[Rgb, float, Generator], NDArray[np.float32]]
# The faults by name.
CAMERA_FAULTS: dict[str, Spoiler] = {
    "blurred": _blurred,
    "dark": _dark,
    "noisy": _noisy,
    "overexposed": _overexposed,
    "covered": _covered,
    "black": _blank(0),
    "grey": _blank(128),
    "white": _blank(250),
}


def spoil(rgb: Rgb, fault: str, strength: float, rng: Generator) -> Rgb:
    """Return a picture as a faulty camera takes it, uint8 (H, W, 3).

    A strength of 1 is a picture that shows hardly anything, and of 0 the picture as it is.
    """
    return np.clip(np.rint(CAMERA_FAULTS[fault](rgb, strength, rng)), 0, 255).astype(np.uint8)


def spoil_at_random(rgb: Rgb, strongest: float, rng: Generator) -> Rgb:
    """Return a picture with a random fault of a random strength up to `strongest`."""
    fault = list(CAMERA_FAULTS)[int(rng.integers(len(CAMERA_FAULTS)))]
    return spoil(rgb, fault, strongest * rng.uniform(0.15, 1.0), rng)
