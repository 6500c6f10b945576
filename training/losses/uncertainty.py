"""Loss of the depth's uncertainty: the likelihood of the errors under the predicted scale."""

from torch import Tensor

from training.losses.masked import masked_mean

#: Smallest scale b [m]: the precision of a LiDAR.
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
