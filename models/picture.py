"""Whether a picture shows the scene: sharp, lit and not drowned in noise.

Nothing here has a parameter that is trained, so that no picture can mislead it.
"""

import torch
from torch import Tensor

from models.blocks import hard_sigmoid

# Every so many rows and columns are measured.
_STEP = 8
# Mean step between neighbours in a row over the mean step between pixels `_STEP` apart, below which
# a picture is blurred and beyond which it is noise: 0.21 to 0.65 in 1068 pictures by day, up to
# 0.15 in pictures blurred by 3 pixels and more, 0.82 and more with noise of 60 of 255.
BLURRED, SHARP, CLEAR, NOISY = 0.16, 0.19, 0.7, 0.8
# Share of pixels with all channels at `SATURATED`, beyond which a picture is overexposed: up to
# 0.44 by day.
SATURATED, EXPOSED_SHARE, OVEREXPOSED_SHARE = 250.0, 0.46, 0.56
# Share of pixels with a channel of at least `BRIGHT`, below which a picture is dark: 0.078 and more
# by day, 0.006 on a motorway by night.
BRIGHT, DARK_SHARE, LIT_SHARE = 150.0, 0.01, 0.03


def picture_shows(rgb: Tensor) -> Tensor:
    """Return 1 for a picture that shows the scene, 0 for another one, (N, 1, 1, 1).

    rgb: (N, 3, H, W), 0..255, before it is normalised.
    """
    rows = rgb[:, :, ::_STEP]
    green = rows[:, 1:2]
    fine = (green[..., 1:] - green[..., :-1]).abs().mean(dim=(2, 3), keepdim=True)
    coarse = (green[..., _STEP:] - green[..., :-_STEP]).abs().mean(dim=(2, 3), keepdim=True)
    ratio = fine / coarse.clamp(min=1e-3)
    pixels = rows[..., ::_STEP]
    bright = (pixels.amax(dim=1, keepdim=True) >= BRIGHT).to(rgb.dtype)
    saturated = (pixels.amin(dim=1, keepdim=True) >= SATURATED).to(rgb.dtype)
    found = [
        _rise(ratio, BLURRED, SHARP),
        _rise(ratio, NOISY, CLEAR),
        _rise(bright.mean(dim=(2, 3), keepdim=True), DARK_SHARE, LIT_SHARE),
        _rise(saturated.mean(dim=(2, 3), keepdim=True), OVEREXPOSED_SHARE, EXPOSED_SHARE),
    ]
    return torch.cat(found, dim=1).amin(dim=1, keepdim=True)


def _rise(x: Tensor, zero: float, one: float) -> Tensor:
    """Return a ramp from 0 at `zero` to 1 at `one`."""
    return hard_sigmoid(x, 1.0 / (one - zero), -zero / (one - zero))
