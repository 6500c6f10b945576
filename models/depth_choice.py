"""How the depth is chosen among its candidates: the steps of `models.surface_depth`, in order.

Nothing here has a parameter that is trained. `start_from_returns` replaces the monocular depth
if the picture shows nothing, `choose_surface` reads the channels of the head,
`blend_with_base` averages its choice with the base, and `blend_with_returns` takes the returns.
"""

from typing import NamedTuple, Self

import torch
from torch import Tensor

from models.blocks import hard_sigmoid
from models.surfaces import MIN_DEPTH, BaseRatios, DilatedReturns, Surfaces


class HeadChannels(NamedTuple):
    """The channels of the head's last convolution, each (N, C, h, w), before their activations.

    Attributes:
        surfaces: confidence in the plane, in the farthest and in the nearest surface, C = 3.
        correction: relative correction of the chosen depth, C = 1.
        scale: scale of the error where the candidates agree, C = 1.
        returns: confidence in a return before the predicted depth, in one behind it, and the
            reduction of the error's scale beside a return, C = 3.
    """

    surfaces: Tensor
    correction: Tensor
    scale: Tensor
    returns: Tensor

    @classmethod
    def split(cls, channels: Tensor) -> Self:
        """Split (N, HEAD_CHANNELS, h, w)."""
        return cls(*channels.split(_HEAD_SPLIT, dim=1))


# Channels of each field of `HeadChannels`, and their sum.
_HEAD_SPLIT = [3, 1, 1, 3]
HEAD_CHANNELS = sum(_HEAD_SPLIT)


class Choices(NamedTuple):
    """What the features of the image choose among, each (N, 1, h, w).

    Attributes:
        nearest, farthest, inverse_plane, support, plane_support: see `surfaces.Surfaces`.
        start: normalised depth that the choice starts from, see `start_from_returns`.
        correction_limit: greatest log of the correction, see `limit_correction`.
    """

    nearest: Tensor
    farthest: Tensor
    inverse_plane: Tensor
    support: Tensor
    plane_support: Tensor
    start: Tensor
    correction_limit: Tensor


class Chosen(NamedTuple):
    """A depth and its uncertainty, each (N, 1, h, w).

    Attributes:
        inverse: inverse of the normalised depth, 1..1/MIN_DEPTH.
        scale: scale of the depth's error, of a Laplace distribution, normalised like the depth.
    """

    inverse: Tensor
    scale: Tensor


class BaseMaps(NamedTuple):
    """What is upsampled beside the choice, each (N, 1, h, w).

    Attributes:
        boundary_logits: logit of a boundary.
        log_offset: log ratio of the depth to the base, see `log_offset`.
        relative_scale: scale of the base's error, as a share of the depth.
        weight: weight of the base, see `BaseRatios`.
    """

    boundary_logits: Tensor
    log_offset: Tensor
    relative_scale: Tensor
    weight: Tensor


# The sigmoid of a confidence is stretched beyond 0 and 1 by so much, and then limited.
STRETCH = 0.1
# Greatest log of the factor that corrects the chosen depth: 0.61 to 1.65 times. Not tuned.
MAX_LOG_CORRECTION = 0.5
# Least and greatest log of the ratio of the error's scale to the depth: 0.25 % to 2.7 times the
# depth, so that neither the loss nor its gradient grows without bound. Not tuned.
LOG_SCALE = (-6.0, 1.0)
# Share of the spread of the prediction and the closest return that is added to the error's scale.
SPREAD_SHARE = 0.5


def start_from_returns(monocular: Tensor, surfaces: Surfaces, shows: Tensor) -> Tensor:
    """Return the depth that the choice starts from: the monocular one, if the picture shows any.

    Else it is the plane between the returns, or the farthest surface where there is none: a picture
    that fails must not take the depth with it that was measured.

    Args:
        monocular: normalised depth that is predicted from the image, (N, 1, h, w).
        surfaces: candidate surfaces.
        shows: see `picture_shows`, (N, 1, 1, 1).
    """
    measured = (1.0 - shows) * surfaces.support
    depth = monocular + measured * (surfaces.farthest - monocular)
    return depth + measured * surfaces.plane_support * (1.0 / surfaces.inverse_plane - depth)


def choose_surface(
    head: HeadChannels, choices: Choices, *, unmeasured_share: float, shows: Tensor | float = 1.0
) -> Chosen:
    """Choose among the candidates and the depth to start from.

    First the plane replaces the depth to start from, then the farthest surface what was chosen,
    then the nearest, each weighted by the confidence in it. The result is corrected, by at most
    `correction_limit`. No depth is beyond `unmeasured_share`, unless the farthest surface is. If
    the picture `shows` nothing, see `picture_shows`, the depth to start from is the answer.
    """
    confidences = stretched_sigmoid(head.surfaces) * shows
    in_plane, in_farthest, in_nearest = confidences.split(1, dim=1)
    nearest, farthest, inverse_plane, support, plane_support, depth, limit = choices
    depth = depth + in_plane * plane_support * (1.0 / inverse_plane - depth)
    depth = depth + in_farthest * support * (farthest - depth)
    depth = depth + in_nearest * support * (nearest - depth)
    depth = (depth * torch.exp(limit * torch.tanh(head.correction))).clamp(min=MIN_DEPTH)
    depth = torch.minimum(depth, (farthest * support).clamp(min=unmeasured_share))
    return Chosen(1.0 / depth, depth.detach() * relative_scale(head.scale))


def limit_correction(ratios: BaseRatios, support: Tensor) -> Tensor:
    """Return the greatest log of the correction: close to returns what the two surfaces differ by.

    Where there are no returns it is MAX_LOG_CORRECTION.
    """
    limit = ratios.farthest - ratios.nearest + MAX_LOG_CORRECTION * (1.0 - support)
    return limit.clamp(max=MAX_LOG_CORRECTION)


def stretched_sigmoid(logits: Tensor) -> Tensor:
    """Return a confidence: the sigmoid, stretched to reach 0 and 1, at logits of -2.4 and 2.4.

    It is that of the hard concrete distribution (Louizos et al. 2018). A sigmoid of 0.95 would
    leave 1.5 % of error where the other candidate is a third off. Beyond the limits the gradient is
    that of the stretched sigmoid, so that the confidence can return.
    """
    share, slope = torch.sigmoid(logits), 1.0 + 2.0 * STRETCH
    limited = hard_sigmoid(share, slope, -STRETCH)
    if not torch.is_grad_enabled():
        return limited
    return _straight_through(slope * share - STRETCH, limited)


# Position up to which the answer is the base. A position beyond it is reduced by this value.
DEAD_ZONE = 0.1


def soft_threshold(x: Tensor) -> Tensor:
    """Return x reduced by DEAD_ZONE towards 0 and limited to -1..1; the gradient is that of x."""
    limited = (x - x.clamp(-DEAD_ZONE, DEAD_ZONE)).clamp(-1.0, 1.0)
    return _straight_through(x, limited) if torch.is_grad_enabled() else limited


def log_offset(position: Tensor, offsets: Tensor) -> Tensor:
    """Return the log ratio of the depth to the base, (N, 1, h, w).

    Args:
        position: -1 = nearest surface, 0 = base, 1 = farthest, same shape.
        offsets: log ratios of the nearest and of the farthest surface to the base, (N, 2, h, w).
    """
    nearest, farthest = offsets.split(1, dim=1)
    offset: Tensor = position.clamp(min=0.0) * farthest - position.clamp(max=0.0) * nearest
    return offset


def blend_with_base(chosen: Chosen, inverse_base: Tensor, base: BaseMaps) -> Chosen:
    """Average the chosen depth with the base, which departs to a surface where there are two.

    All are on the grid of BASE_CELL; inverse_base is the inverse depth of the base, (N, 1, H, W).
    """
    moved = (inverse_base * torch.exp(-base.log_offset)).clamp(1.0, 1.0 / MIN_DEPTH)
    inverse = chosen.inverse + base.weight * (moved - chosen.inverse)
    base_scale = base.relative_scale / inverse.detach()
    return Chosen(inverse, chosen.scale + base.weight * (base_scale - chosen.scale))


# Difference of inverse depths [1/m] up to which a LiDAR beside the camera hardly sees past the
# nearer surface: 1.3 pixels of parallax for 1 m between the sensors, at 721.5 pixels of focal
# length. From twice this difference on, the LiDAR sees past it.
PARALLAX = 1.8e-3
# Relative difference of depths two pixels apart on one slanted surface. From twice this difference
# on they belong to two surfaces.
SLOPE = 0.03
# Largest share by which a return beside a pixel reduces the error's scale, which stays positive.
# Not tuned.
MAX_SCALE_REDUCTION = 0.9


def blend_with_returns(
    inverse: Tensor, returns: DilatedReturns, before: Tensor, behind: Tensor, *, max_depth_m: float
) -> tuple[Tensor, Tensor]:
    """Replace the predicted depth by the closest return, weighted by the confidence in it.

    An edge is blurred on the coarser grid of the choice; a return is on one side of it. A LiDAR
    beside the camera sees past near edges, so returns before and behind the predicted depth have
    confidences of their own. Where the parallax between both depths is too small for that, the
    return's depth is used without confidence: at the pixel of the return itself, and beside it if
    the return is farther by more than a slope explains.

    Args:
        inverse: inverse of the predicted depth, see `Chosen`, (N, 1, H, W).
        returns: returns around each pixel.
        before: sigmoid of the confidence in a return before the predicted depth, same shape.
        behind: that of a return behind it.
        max_depth_m: depth [m] of the normalised depth 1.0.

    Returns:
        The depth; and what the spread of the two depths adds to the error's scale.
    """
    depth = 1.0 / inverse
    measured = 1.0 / returns.inverse
    step = measured - depth
    parallax = (inverse - returns.inverse).abs()
    aligned = hard_sigmoid(parallax, -1.0 / (max_depth_m * PARALLAX), 2.0)
    # It begins at a relative difference of SLOPE and is complete at twice SLOPE.
    farther = hard_sigmoid(measured * inverse, 1.0 / SLOPE, -1.0 / SLOPE - 1.0)
    weight = torch.where(step < 0, before, behind)
    weight = (
        torch.maximum(weight, aligned * torch.maximum(returns.at_pixel, farther)) * returns.mask
    )
    change = weight * step
    # The mean distance of both depths from their mean is twice this: w (1 - w) |step|.
    spread = ((1.0 - weight) * change).abs()
    return depth + change, SPREAD_SHARE * spread.detach()


def reduce_scale(scale: Tensor, reduction: Tensor, near: Tensor) -> Tensor:
    """Return the error's scale, (N, 1, h, w), reduced where `near` is 1: beside a return.

    reduction: sigmoid of that of `HeadChannels.returns`.
    """
    return scale * hard_sigmoid(reduction * near, -MAX_SCALE_REDUCTION, 1.0)


def relative_scale(logits: Tensor) -> Tensor:
    """Return the error's scale as a share of the depth, see LOG_SCALE."""
    least, greatest = LOG_SCALE
    return torch.exp(least + (greatest - least) * torch.sigmoid(logits))


def _straight_through(free: Tensor, limited: Tensor) -> Tensor:
    """Return the value of `limited` with the gradient of `free` (Bengio et al. 2013)."""
    return free + (limited - free).detach()
