"""Structural similarity of depth maps, Eq. 2 and 3."""

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from training.losses.masked import masked_mean

C1 = 1e-4
C2 = 9e-4
WINDOW = 11


class _BoxMean(torch.autograd.Function):
    """Mean over every window inside the map, 11 + 11 additions a window.

    Its adjoint is the same filter on the zero-padded gradient. Average pooling gives the same
    numbers with 121 additions a window.
    """

    @staticmethod
    def forward(ctx: Any, x: Tensor, window: tuple[int, int]) -> Tensor:
        ctx.window = window
        return _window_sums(x, window) / (window[0] * window[1])

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:
        height, width = ctx.window
        padded = F.pad(gradients[0], (width - 1, width - 1, height - 1, height - 1))
        return _window_sums(padded, ctx.window) / (height * width), None


def _window_sums(x: Tensor, window: tuple[int, int]) -> Tensor:
    for dim, length in zip((-2, -1), window, strict=True):
        count = x.shape[dim] - length + 1
        sums = x.narrow(dim, 0, count).clone()
        for offset in range(1, length):
            sums += x.narrow(dim, offset, count)
        x = sums
    return x


def ssim(a: Tensor, b: Tensor, valid: Tensor, *, window: int = WINDOW) -> tuple[Tensor, Tensor]:
    """SSIM of every window, float (N, 1, H', W') in -1..1, and a bool mask of known windows.

    `a`, `b` float (N, 1, H, W) in 0..1, finite; `valid` bool of the same shape. Eq. 3 of every
    `window` x `window` square that lies inside the image (H' = H - window + 1), every pixel of it
    weighing the same; a smaller image gets a window of its own size.

    Our reading: E is taken over the valid pixels of the window, and windows without any are
    marked. The printed sigma is meant as a standard deviation and the printed s as
    (sigma_ab + C3) / (sigma_a sigma_b + C3), as in Wang et al. 2004; with C3 = C2 / 2 the product
    c * s is then (2 sigma_ab + C2) / (sigma_a^2 + sigma_b^2 + C2), without a root whose gradient
    is infinite on flat surfaces.
    """
    height, width = min(window, a.shape[-2]), min(window, a.shape[-1])

    def window_means(*maps: Tensor) -> tuple[Tensor, ...]:
        stacked = torch.cat(maps, dim=1)
        means: Tensor = _BoxMean.apply(stacked, (height, width))  # type: ignore[no-untyped-call]
        return means.chunk(len(maps), dim=1)

    known = valid.to(a.dtype)
    a, b = a * known, b * known
    share, *b_means = window_means(known, b, b * b)
    known_windows = share > 0.5 / (height * width)  # smaller shares are rounding errors
    share = share.clamp(min=0.5 / (height * width))
    mean_b, bb = (mean / share for mean in b_means)
    mean_a, aa, ab = (mean / share for mean in window_means(a, a * a, a * b))
    product = mean_a * mean_b
    squares = mean_a * mean_a + mean_b * mean_b
    variances = (aa + bb - squares).clamp(min=0)
    luminance = (2 * product + C1) / (squares + C1)
    contrast_structure = (2 * (ab - product) + C2) / (variances + C2)
    return luminance * contrast_structure, known_windows


def ssim_loss(prediction: Tensor, target: Tensor, valid: Tensor) -> Tensor:
    """Eq. 2 as a loss: 1 - mean SSIM over the windows that hold ground truth, ().

    Shapes as `ssim`, depth normalised to 0..1. The paper adds the mean SSIM itself, which training
    would minimise; the loss is 1 - SSIM. 0 without ground truth.
    """
    similarity, known = ssim(prediction, target, valid)
    return masked_mean(1 - similarity, known)
