"""Loss of the depth's uncertainty: how likely the errors are under the scale that was given."""

from torch import Tensor

from training.losses.masked import masked_mean

#: Scales below this [m] are not told apart: a centimetre is what a LiDAR measures.
_LEAST_SCALE_M = 0.01


def laplace_loss(
    scale: Tensor, prediction: Tensor, target: Tensor, valid: Tensor, *, max_depth_m: float
) -> Tensor:
    """Negative log-likelihood of the depth's errors under Laplace distributions, ().

    Mean of |e| / b + log b, e and b in metres (Kendall and Gal 2017). All (N, 1, H, W), normalised;
    `valid` bool, see `normalise_depth`. The errors are taken as they are: their gradient goes to
    the scale alone, so that what is hard is not given up.
    """
    error = (prediction.detach() - target).abs() * max_depth_m
    metres = (scale * max_depth_m).clamp(min=_LEAST_SCALE_M)
    return masked_mean(error / metres + metres.log(), valid)
