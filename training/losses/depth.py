"""Losses of depth: Eq. 2-4, errors in metres, and the likelihood of the uncertainty."""

import torch
import torch.nn.functional as F
from torch import Tensor

from training.losses.masked import masked_mean, split_into_blocks

# Smaller normalised depths are clipped to this value before a ratio is taken.
_NEAREST = 1e-3


def normalise_depth(
    depth: Tensor, max_depth_m: float, unmeasured_range_m: float
) -> tuple[Tensor, Tensor]:
    """Split metres into normalised depth 0..1 and a bool mask of what was measured.

    `depth` float (N, 1, H, W) [m]; 0, negative, NaN, Inf and values beyond `unmeasured_range_m`
    are no measurement.
    """
    valid = (depth > 0) & (depth <= unmeasured_range_m)
    return torch.where(valid, depth, 0.0) / max_depth_m, valid


def depth_at_scale(target: Tensor, valid: Tensor, grid: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Return the mean of the valid pixels under each cell of a coarser grid, and a mask.

    `target` is float (N, 1, H, W), 0 where not `valid`; a cell without a valid pixel is invalid.
    """
    if target.shape[-2:] == grid:
        return target, valid
    blocks, side = split_into_blocks(torch.cat((target, valid.to(target.dtype)), dim=1), grid)
    mean, share = F.avg_pool2d(blocks, side).chunk(2, dim=1)
    known = share > 0.5 / side**2
    return torch.where(known, mean / share.clamp(min=0.5 / side**2), 0.0), known


def paper_depth_loss(prediction: Tensor, target: Tensor, valid: Tensor) -> Tensor:
    """Eq. 4 at one scale: 0.4 * mean |e| + 0.4 * mean e^2 + 0.2 * (1 - mean SSIM), ().

    e: error of the normalised depth at valid pixels. The weights are the paper's.
    """
    error = prediction - target
    loss = 0.4 * masked_mean(error.abs(), valid) + 0.4 * masked_mean(error.square(), valid)
    return loss + 0.2 * ssim_loss(prediction, target, valid)


def metric_depth_loss(
    prediction: Tensor,
    target: Tensor,
    valid: Tensor,
    *,
    max_depth_m: float,
    l2: float,
    log: float,
    unmeasured_share: float,
) -> Tensor:
    """Mean |e| + l2 * mean e^2 + log * mean |log ratio|, the error e in metres, at one scale, ().

    Not in the paper: LiDAR targets are too sparse for the windows of SSIM. Far pixels dominate
    errors in metres; the log ratio of prediction and target weighs near and far pixels equally.

    Args:
        prediction: float (N, 1, h, w), normalised depth.
        target: float (N, 1, h, w), normalised depth.
        valid: bool (N, 1, h, w).
        max_depth_m: metres of the normalised depth 1.
        l2: weight of the squared error [1/m].
        log: weight of the log ratio [m].
        unmeasured_share: largest normalised depth without a return, the target of the sky.
            Predictions beyond it have no error there.
    """
    prediction = torch.where(
        target < unmeasured_share, prediction, prediction.clamp(max=unmeasured_share)
    )
    error = (prediction - target) * max_depth_m
    ratio = log_ratio(prediction, torch.where(valid, target, 1.0))
    return masked_mean(error.abs() + l2 * error.square() + log * ratio.abs(), valid)


def log_ratio(depth: Tensor, other: Tensor) -> Tensor:
    """Log ratio of two maps of normalised depth."""
    return (depth.clamp(min=_NEAREST) / other.clamp(min=_NEAREST)).log()


C1 = 1e-4
C2 = 9e-4
WINDOW = 11


def ssim(a: Tensor, b: Tensor, valid: Tensor) -> tuple[Tensor, Tensor]:
    """SSIM of every window, float (N, 1, H', W') in -1..1, and a bool mask of known windows.

    `a`, `b` float (N, 1, H, W) in 0..1, finite; `valid` bool of the same shape. Eq. 3 of every
    `WINDOW` x `WINDOW` square that lies inside the image (H' = H - WINDOW + 1), every pixel of it
    weighing the same; a smaller image gets a window of its own size.

    Our reading: E is taken over the valid pixels of the window, and windows without any are
    marked. The printed sigma is meant as a standard deviation and the printed s as
    (sigma_ab + C3) / (sigma_a sigma_b + C3), as in Wang et al. 2004; with C3 = C2 / 2 the product
    c * s is then (2 sigma_ab + C2) / (sigma_a^2 + sigma_b^2 + C2), without a root whose gradient
    is infinite on flat surfaces.
    """
    height, width = min(WINDOW, a.shape[-2]), min(WINDOW, a.shape[-1])

    def window_means(*maps: Tensor) -> tuple[Tensor, ...]:
        # A column, then a row: a tenth of the additions of the whole square.
        columns = F.avg_pool2d(torch.cat(maps, dim=1), (height, 1), stride=1)
        return F.avg_pool2d(columns, (1, width), stride=1).chunk(len(maps), dim=1)

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
    """Return Eq. 2 as a loss: 1 - mean SSIM over the windows that hold ground truth, ().

    The shapes are those of `ssim`, with depth normalised to 0..1. The paper adds the mean SSIM
    itself, which training would minimise; the loss is 1 - SSIM. It is 0 without ground truth.
    """
    similarity, known = ssim(prediction, target, valid)
    return masked_mean(1 - similarity, known)


# Smallest scale b [m]: the precision of a LiDAR.
_LEAST_SCALE_M = 0.01


def laplace_loss(
    scale: Tensor, prediction: Tensor, target: Tensor, valid: Tensor, *, max_depth_m: float
) -> Tensor:
    """Negative log-likelihood of the depth's errors under Laplace distributions, ().

    Mean of |e| / b + log b, e and b in metres (Kendall and Gal 2017). All (N, 1, H, W), normalised;
    `valid` bool, see `normalise_depth`. The errors are detached: the gradient goes to the scale
    only, so that the depth of difficult pixels is still learned.
    """
    error = (prediction.detach() - target).abs() * max_depth_m
    metres = (scale * max_depth_m).clamp(min=_LEAST_SCALE_M)
    return masked_mean(error / metres + metres.log(), valid)
