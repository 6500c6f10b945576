"""Checks of the image: frozen, black, overexposed."""

import numpy as np
from numpy.typing import NDArray

IMAGE_FROZEN = "image_frozen"  # the same bytes as the image before
IMAGE_BLACK = "image_black"  # nearly every pixel is dark
IMAGE_OVEREXPOSED = "image_overexposed"  # half of the pixels are saturated

_GLANCE = 16  # every 16th row and column are compared first
_STEP = 4  # every 4th row and column are checked for brightness
_DARK, _DARK_SHARE = 12, 0.99  # brightest channel, of 255
_BRIGHT, _BRIGHT_SHARE = 250, 0.5  # darkest channel


class ImageHealth:
    """Checks one image of a camera after another."""

    def __init__(self) -> None:
        self._before: NDArray[np.uint8] | None = None

    def check(self, rgb: NDArray[np.uint8]) -> tuple[str, ...]:
        """Return what is wrong with an image, which is kept until the next one."""
        before, self._before = self._before, rgb
        seen = rgb[::_STEP, ::_STEP]
        found = []
        if (
            before is not None
            and before.shape == rgb.shape
            and np.array_equal(before[::_GLANCE, ::_GLANCE], rgb[::_GLANCE, ::_GLANCE])
            and np.array_equal(before, rgb)
        ):
            found.append(IMAGE_FROZEN)
        red, green, blue = seen[..., 0], seen[..., 1], seen[..., 2]
        if np.mean(np.maximum(np.maximum(red, green), blue) <= _DARK) >= _DARK_SHARE:
            found.append(IMAGE_BLACK)
        if np.mean(np.minimum(np.minimum(red, green), blue) >= _BRIGHT) >= _BRIGHT_SHARE:
            found.append(IMAGE_OVEREXPOSED)
        return tuple(found)
