"""The depth head, which decides among the candidates of `models.surfaces`.

The paper's depth head is one 1x1 convolution and a sigmoid. This head departs from it, because a
regressed depth depends on the camera and the LiDAR of the training, and is blurred at edges.

Close to returns the depth is the mean of two choices. One is the base, which passes through the
returns; it departs to the nearest or the farthest surface where the geometry of the returns, the
boundary and a few class-like channels say so. Unlike features of the image, these are the same on
other cameras. The other choice reads the features of the image, and decides alone farther from
returns: among the plane between the returns, both surfaces, and a monocular depth, for where
returns end or an object returns nothing. At the image's size each return then replaces the depth of
the pixels around it, weighted by the network's confidence in it.

In the order of execution: `surfaces.find_candidates`; after the decoders `choose_surface`,
`blend_with_base`, `surfaces.dilate_returns` and `blend_with_returns`.
"""

from typing import NamedTuple, Self, TypeVar

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.blocks import ConvBNReLU, hard_sigmoid, upsample
from models.decoders import AddUpBlock
from models.planes import BASE_CELL, CELL
from models.surfaces import (
    FEATURE_CHANNELS,
    MAX_BASE_WEIGHT,
    MIN_DEPTH,
    BaseRatios,
    Candidates,
    DilatedReturns,
    dilate_returns,
    zero_if_same_surface,
)


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
# `HeadChannels.surfaces` of a new head.
_FIRST_CONFIDENCES = (2.5, -4.0, -4.0)
# Class-like channels that the geometry's branch reads, and its other channels: 16 together, as
# ONNX Runtime computes convolutions in blocks of 8 or 16 channels.
_CLASS_CHANNELS, _RATIO_CHANNELS = 7, 9


class Choices(NamedTuple):
    """What the features of the image choose among, each (N, 1, h, w).

    Attributes:
        nearest, farthest, inverse_plane, support, plane_support: see `surfaces.Surfaces`.
        monocular: normalised depth that is predicted from the image.
        correction_limit: greatest log of the correction, see `limit_correction`.
    """

    nearest: Tensor
    farthest: Tensor
    inverse_plane: Tensor
    support: Tensor
    plane_support: Tensor
    monocular: Tensor
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


class DepthMaps(NamedTuple):
    """The answers of a `SurfaceDepthHead` at the image's size, each (N, 1, H, W).

    Attributes:
        depth: normalised depth.
        scale: scale of its error, normalised like the depth.
        boundary_logits: logit of a boundary.
    """

    depth: Tensor
    scale: Tensor
    boundary_logits: Tensor


class SurfaceDepthHead(nn.Module):
    """Depth at the image's size, and the scale of its error, from candidates and features.

    Args:
        channels: channels of the decoders' features, at stride 4.
        stride2_channels: channels of the encoder's features at stride 2.
        stride4_channels: channels of the encoder's features at stride 4.
        refine_channels: channels at stride 2, where the choice is made; 0 = it is made at stride 4.
        separable: whether the BaConv at stride 2 is separable.
        geometry_channels: channels of the convolutions that decide close to returns.
        semantics: whether there are features of the semantic decoder.
        max_depth_m: depth [m] of the normalised depth 1.0.
        farthest_monocular: the farthest normalised depth without a return.
    """

    def __init__(
        self,
        channels: int,
        stride2_channels: int,
        stride4_channels: int,
        *,
        refine_channels: int,
        separable: bool,
        geometry_channels: int,
        semantics: bool,
        max_depth_m: float,
        farthest_monocular: float,
    ) -> None:
        super().__init__()
        self.max_depth_m, self.farthest_monocular = max_depth_m, farthest_monocular
        self.embed = nn.Conv2d(FEATURE_CHANNELS, stride4_channels, 1)
        self.guess = nn.Conv2d(channels, 1, 1)  # the monocular depth; checkpoints have this name
        self.project = nn.Conv2d(FEATURE_CHANNELS, channels, 1)
        # Classes imply surfaces that have no returns: a car has a roof and windows.
        self.semantics = nn.Conv2d(channels, channels, 1) if semantics else None
        self.refinement = None
        if refine_channels:
            self.refinement = AddUpBlock(
                channels, stride2_channels, refine_channels, separable=separable
            )
            self.coarse_head = nn.Conv2d(channels, HEAD_CHANNELS, 1)
        self.head = nn.Conv2d(refine_channels or channels, HEAD_CHANNELS, 1)
        self.head_stride = CELL // 2 if refine_channels else CELL
        # The class scores are not read: fine-tuning for other classes must not change the depth.
        self.classes = nn.Conv2d(channels, _CLASS_CHANNELS, 1) if semantics else None
        self.geometry = nn.Sequential(
            ConvBNReLU(_RATIO_CHANNELS + (_CLASS_CHANNELS if semantics else 0), geometry_channels),
            ConvBNReLU(geometry_channels, geometry_channels, dilation=2),
            ConvBNReLU(geometry_channels, geometry_channels),
            nn.Conv2d(geometry_channels, 2, 1),
        )

    @torch.no_grad()
    def initialise_as_base(self) -> None:
        """Let a new head answer with base and plane, and where there are none from the image."""
        last = self.geometry[-1]
        assert isinstance(last, nn.Conv2d)
        last.weight.mul_(0.01)  # within DEAD_ZONE, and the gradient reaches the layers before
        if self.semantics is not None:
            nn.init.zeros_(self.semantics.weight)
        chosen = len(_FIRST_CONFIDENCES) + 1  # and the correction
        for layer in [self.head] if self.refinement is None else [self.head, self.coarse_head]:
            for weights in layer.parameters():
                weights[:chosen].zero_()
        *_, bias = self.head.parameters()
        bias[: chosen - 1].copy_(torch.tensor(_FIRST_CONFIDENCES))

    def forward(
        self,
        candidates: Candidates,
        features: Tensor,
        semantics: Tensor | None,
        stride2: Tensor,
        boundary_logits: Tensor,
    ) -> DepthMaps:
        """Return the depth, its error's scale and the boundary's logits at the image's size.

        Args:
            candidates: candidates of the frame.
            features: features of the depth decoder, on the grid of CELL.
            semantics: features of the semantic decoder, on the same grid.
            stride2: features of the encoder at stride 2.
            boundary_logits: on the grid of CELL; they are upsampled together with the depth.
        """
        # The monocular depth, for where nothing is measured.
        monocular = self.farthest_monocular * torch.sigmoid(self.guess(features))
        monocular = torch.minimum(monocular, candidates.monocular_limit).float()
        # Close to returns: a position between the nearest surface, the base and the farthest one.
        ratios, base_weight = candidates.base_ratios, candidates.base_ratios.base_weight
        both = torch.cat([ratios.nearest, ratios.farthest], dim=1)
        offsets = zero_if_same_surface(both)
        geometry = self._geometry(candidates, both, offsets, semantics, boundary_logits)
        position, log_scale = self.geometry(geometry).float().split(1, dim=1)
        # The choice from the features of the image, at stride 4 or 2.
        features = features + self.project(candidates.features)
        if self.semantics is not None:
            features = features + self.semantics(semantics)
        boundary_logits = boundary_logits.float()
        limit = limit_correction(ratios, candidates.surfaces.support)
        choices = Choices(*candidates.surfaces, monocular, limit)
        if self.training:
            # At random the weight is set to 0, kept, or doubled, so that neither choice learns to
            # compensate for the other.
            base_weight = base_weight * torch.randint(3, ()).to(base_weight)
        offset = log_offset(soft_threshold(position), offsets)
        base = BaseMaps(boundary_logits, offset, _relative_scale(log_scale), base_weight)
        if self.refinement is None:
            head = HeadChannels.split(self.head(features).float())
            chosen = choose_surface(head, choices, farthest_monocular=self.farthest_monocular)
            chosen, base = _upsample_together(chosen, base)
        else:
            choices, base = _upsample_together(choices, base)
            refined = self.head(self.refinement(features, stride2))
            head = HeadChannels.split((refined + upsample(self.coarse_head(features))).float())
            chosen = choose_surface(head, choices, farthest_monocular=self.farthest_monocular)
        # Both on the grid of the base, then the returns at the image's size.
        chosen = blend_with_base(chosen, candidates.inverse_base, base)
        return self._add_returns(chosen, base.boundary_logits, head.returns, candidates)

    def _add_returns(
        self, chosen: Chosen, boundary_logits: Tensor, returns: Tensor, candidates: Candidates
    ) -> DepthMaps:
        """Upsample to the image's size and blend with the returns; see `HeadChannels.returns`."""
        maps = upsample(torch.cat([*chosen, boundary_logits], dim=1), factor=BASE_CELL)
        inverse, scale, boundary_logits = maps.split(1, dim=1)
        # One value a cell is enough: the returns give the position of an edge.
        confidence = torch.sigmoid(returns)
        confidence = F.interpolate(confidence, scale_factor=float(self.head_stride), mode="nearest")
        depth, scale = blend_with_returns(
            Chosen(inverse, scale),
            dilate_returns(candidates.sparse_depth),
            confidence,
            max_depth_m=self.max_depth_m,
        )
        return DepthMaps(depth, scale, boundary_logits)

    def _geometry(
        self,
        candidates: Candidates,
        ratios: Tensor,
        offsets: Tensor,
        semantics: Tensor | None,
        boundary_logits: Tensor,
    ) -> Tensor:
        """Return the input of the geometry's branch: nothing that depends on camera or LiDAR."""
        surfaces, density = candidates.surfaces, candidates.features[:, -1:]
        maps = [
            ratios,
            5.0 * offsets,
            surfaces.support,
            surfaces.plane_support,
            candidates.base_ratios.base_weight * (1.0 / MAX_BASE_WEIGHT),
            density,
            torch.sigmoid(boundary_logits.float()),
        ]
        if self.classes is not None:
            maps.append(torch.sigmoid(self.classes(semantics)))
        return torch.cat(maps, dim=1)


_Maps = TypeVar("_Maps", Choices, Chosen)


def _upsample_together(choice: _Maps, base: BaseMaps) -> tuple[_Maps, BaseMaps]:
    """Upsample all maps of a grid at once: ONNX Runtime splits a Resize by channels."""
    maps = upsample(torch.cat([*choice, *base], dim=1)).split(1, dim=1)
    return type(choice)(*maps[: len(choice)]), BaseMaps(*maps[len(choice) :])


# The sigmoid of a confidence is stretched beyond 0 and 1 by so much, and then limited.
STRETCH = 0.1
# Greatest log of the factor that corrects the chosen depth: 0.61 to 1.65 times. Not tuned.
MAX_LOG_CORRECTION = 0.5
# Least and greatest log of the ratio of the error's scale to the depth: 0.25 % to 2.7 times the
# depth, so that neither the loss nor its gradient grows without bound. Not tuned.
LOG_SCALE = (-6.0, 1.0)
# Share of the spread of the prediction and the closest return that is added to the error's scale.
SPREAD_SHARE = 0.5


def choose_surface(head: HeadChannels, choices: Choices, *, farthest_monocular: float) -> Chosen:
    """Choose among the candidates and the monocular depth.

    First the plane replaces the monocular depth, then the farthest surface what was chosen, then
    the nearest, each weighted by the confidence in it. The result is corrected, by at most
    `correction_limit`. No depth is beyond `farthest_monocular`, unless the farthest surface is.
    """
    in_plane, in_farthest, in_nearest = stretched_sigmoid(head.surfaces).split(1, dim=1)
    nearest, farthest, inverse_plane, support, plane_support, depth, limit = choices
    depth = depth + in_plane * plane_support * (1.0 / inverse_plane - depth)
    depth = depth + in_farthest * support * (farthest - depth)
    depth = depth + in_nearest * support * (nearest - depth)
    depth = (depth * torch.exp(limit * torch.tanh(head.correction))).clamp(min=MIN_DEPTH)
    depth = torch.minimum(depth, (farthest * support).clamp(min=farthest_monocular))
    return Chosen(1.0 / depth, depth.detach() * _relative_scale(head.scale))


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
    chosen: Chosen, returns: DilatedReturns, confidence: Tensor, *, max_depth_m: float
) -> tuple[Tensor, Tensor]:
    """Replace the predicted depth by the closest return, weighted by the confidence in it.

    An edge is blurred on the coarser grid of the choice; a return is on one side of it. A LiDAR
    beside the camera sees past near edges, so returns before and behind the predicted depth have
    confidences of their own. Where the parallax between both depths is too small for that, the
    return's depth is used without confidence: at the pixel of the return itself, and beside it if
    the return is farther by more than a slope explains.

    Args:
        chosen: the predicted depth, (N, 1, H, W).
        returns: returns around each pixel.
        confidence: sigmoids of `HeadChannels.returns`, (N, 3, H, W).
        max_depth_m: depth [m] of the normalised depth 1.0.

    Returns:
        The depth; and the scale, reduced beside a return, plus the spread of the two depths.
    """
    before, behind, reduction = confidence.split(1, dim=1)
    depth = 1.0 / chosen.inverse
    measured = 1.0 / returns.inverse
    step = measured - depth
    parallax = (chosen.inverse - returns.inverse).abs()
    aligned = hard_sigmoid(parallax, -1.0 / (max_depth_m * PARALLAX), 2.0)
    # It begins at a relative difference of SLOPE and is complete at twice SLOPE.
    farther = hard_sigmoid(measured * chosen.inverse, 1.0 / SLOPE, -1.0 / SLOPE - 1.0)
    weight = torch.where(step < 0, before, behind)
    weight = (
        torch.maximum(weight, aligned * torch.maximum(returns.at_pixel, farther)) * returns.mask
    )
    change = weight * step
    # The mean distance of both depths from their mean is twice this: w (1 - w) |step|.
    spread = ((1.0 - weight) * change).abs()
    scale = chosen.scale * hard_sigmoid(reduction * returns.mask, -MAX_SCALE_REDUCTION, 1.0)
    return depth + change, scale + SPREAD_SHARE * spread.detach()


def _relative_scale(logits: Tensor) -> Tensor:
    """Return the error's scale as a share of the depth, see LOG_SCALE."""
    least, greatest = LOG_SCALE
    return torch.exp(least + (greatest - least) * torch.sigmoid(logits))


def _straight_through(free: Tensor, limited: Tensor) -> Tensor:
    """Return the value of `limited` with the gradient of `free` (Bengio et al. 2013)."""
    return free + (limited - free).detach()
