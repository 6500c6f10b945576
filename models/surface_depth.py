"""The depth head, which decides among the candidates of `models.surfaces`.

Close to returns the depth is the mean of two choices. One is the base, which passes through the
returns; it departs to the nearest or the farthest surface where the geometry of the returns, the
boundary and a few class-like channels say so. Unlike features of the image, these are the same on
other cameras. The other choice reads the features of the image, and decides alone farther from
returns: among the plane between the returns, both surfaces, and its own guess, for where returns
end or an object returns nothing. At the image's size each return then replaces the depth of the
pixels around it, weighted by the network's confidence in it.

In the order of execution: `surfaces.find_candidates`; after the decoders `choose_surface`,
`join_base`, `surfaces.dilate_returns` and `take_returns`.
"""

from typing import NamedTuple, Self

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.blocks import ConvBNReLU, ramp, upsample
from models.lite_decoder import UpBlock
from models.planes import BASE_CELL, CELL
from models.surfaces import (
    FEATURE_CHANNELS,
    MOST_BESIDE,
    NEAREST,
    Beside,
    Candidates,
    Returns,
    Surfaces,
    apart,
    dilate_returns,
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


class SurfaceDepthHead(nn.Module):
    """Depth at the image's size, and the scale of its error, from candidates and features.

    Args:
        channels: channels of the decoders' features, at stride 4.
        at_2_channels: channels of the encoder's features at stride 2.
        at_4_channels: channels of the encoder's features at stride 4.
        refine_channels: channels at stride 2, where the choice is made; 0 = it is made at stride 4.
        separable: whether the BaConv at stride 2 is separable.
        geometry_channels: channels of the convolutions that decide close to returns.
        semantics: whether there are features of the semantic decoder.
        max_depth_m: depth [m] of the normalised depth 1.0.
        farthest_guess: the farthest normalised depth without a return.
    """

    def __init__(
        self,
        channels: int,
        at_2_channels: int,
        at_4_channels: int,
        *,
        refine_channels: int,
        separable: bool,
        geometry_channels: int,
        semantics: bool,
        max_depth_m: float,
        farthest_guess: float,
    ) -> None:
        super().__init__()
        self.max_depth_m, self.farthest_guess = max_depth_m, farthest_guess
        self.embed = nn.Conv2d(FEATURE_CHANNELS, at_4_channels, 1)
        self.guess = nn.Conv2d(channels, 1, 1)
        self.project = nn.Conv2d(FEATURE_CHANNELS, channels, 1)
        # Classes imply surfaces that have no returns: a car has a roof and windows.
        self.semantics = nn.Conv2d(channels, channels, 1) if semantics else None
        self.refinement = None
        if refine_channels:
            self.refinement = UpBlock(channels, at_2_channels, refine_channels, separable=separable)
            self.coarse_head = nn.Conv2d(channels, HEAD_CHANNELS, 1)
        self.head = nn.Conv2d(refine_channels or channels, HEAD_CHANNELS, 1)
        self.cell = CELL // 2 if refine_channels else CELL
        # The class scores are not read: fine-tuning for other classes must not change the depth.
        self.classes = nn.Conv2d(channels, _CLASS_CHANNELS, 1) if semantics else None
        self.geometry = nn.Sequential(
            ConvBNReLU(_RATIO_CHANNELS + (_CLASS_CHANNELS if semantics else 0), geometry_channels),
            ConvBNReLU(geometry_channels, geometry_channels, dilation=2),
            ConvBNReLU(geometry_channels, geometry_channels),
            nn.Conv2d(geometry_channels, 2, 1),
        )

    @torch.no_grad()
    def start_as_base(self) -> None:
        """Let a new head answer with base and plane, and with the guess where there are none."""
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
        at_2: Tensor,
        boundary_logits: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return the depth, its error's scale and the boundary's logits at the image's size.

        Args:
            candidates: candidates of the frame.
            features: features of the depth decoder, on the grid of CELL.
            semantics: features of the semantic decoder, on the same grid.
            at_2: features of the encoder at stride 2.
            boundary_logits: on the grid of CELL; they are upsampled together with the depth.
        """
        guess = self.farthest_guess * torch.sigmoid(self.guess(features))
        guess = torch.minimum(guess, candidates.guess_limit).float()
        beside = candidates.beside
        ratios = torch.cat([beside.near, beside.far], dim=1)
        departures = apart(ratios)
        geometry = self._geometry(candidates, ratios, departures, semantics, boundary_logits)
        place, log_scale = self.geometry(geometry).float().split(1, dim=1)
        features = features + self.project(candidates.features)
        if self.semantics is not None:
            features = features + self.semantics(semantics)
        surfaces, boundary_logits = candidates.surfaces, boundary_logits.float()
        room = correction_room(beside, surfaces.support)
        if self.training:
            # At random the share is set to 0, kept, or doubled, so that neither choice learns to
            # compensate for the other.
            beside = beside._replace(share=beside.share * torch.randint(3, ()).to(beside.share))
        # One upsampling for all maps of a grid: ONNX Runtime splits a Resize by channels.
        base_maps = [
            depart(position(place), departures),
            _relative_scale(log_scale),
            beside.share,
        ]
        if self.refinement is None:
            head = HeadChannels.split(self.head(features).float())
            chosen = choose_surface(head, guess, surfaces, room, reach=self.farthest_guess)
            maps = upsample(torch.cat([*chosen, boundary_logits, *base_maps], dim=1))
            inverse, scale, boundary_logits, *base_maps = maps.split(1, dim=1)
        else:
            coarse = [*surfaces, guess, room, boundary_logits, *base_maps]
            maps = upsample(torch.cat(coarse, dim=1)).split(1, dim=1)
            surfaces = Surfaces(*maps[: len(surfaces)])
            guess, room, boundary_logits, *base_maps = maps[len(surfaces) :]
            refined = self.head(self.refinement(features, at_2))
            head = HeadChannels.split((refined + upsample(self.coarse_head(features))).float())
            inverse, scale = choose_surface(head, guess, surfaces, room, reach=self.farthest_guess)
        inverse, scale = join_base(inverse, scale, candidates.base.base, *base_maps)
        maps = upsample(torch.cat([inverse, scale, boundary_logits], dim=1), factor=BASE_CELL)
        inverse, scale, boundary_logits = maps.split(1, dim=1)
        # One value a cell is enough: the returns give the position of an edge.
        in_returns = torch.sigmoid(head.returns)
        in_returns = F.interpolate(in_returns, scale_factor=float(self.cell), mode="nearest")
        returns = dilate_returns(candidates.measured)
        depth, scale = take_returns(
            inverse, scale, returns, in_returns, max_depth_m=self.max_depth_m
        )
        return depth, scale, boundary_logits

    def _geometry(
        self,
        candidates: Candidates,
        ratios: Tensor,
        departures: Tensor,
        semantics: Tensor | None,
        boundary_logits: Tensor,
    ) -> Tensor:
        """Return the input of the geometry's branch: nothing that depends on camera or LiDAR."""
        surfaces, density = candidates.surfaces, candidates.features[:, -1:]
        maps = [
            ratios,
            5.0 * departures,
            surfaces.support,
            surfaces.reached,
            candidates.beside.share * (1.0 / MOST_BESIDE),
            density,
            torch.sigmoid(boundary_logits.float()),
        ]
        if self.classes is not None:
            maps.append(torch.sigmoid(self.classes(semantics)))
        return torch.cat(maps, dim=1)


# The sigmoid of a confidence is stretched beyond 0 and 1 by so much, and then limited.
STRETCH = 0.1
# Greatest log of the factor that corrects the chosen depth: 0.61 to 1.65 times. Not tuned.
MAX_LOG_CORRECTION = 0.5
# Least and greatest log of the ratio of the error's scale to the depth: 0.25 % to 2.7 times the
# depth, so that neither the loss nor its gradient grows without bound. Not tuned.
LOG_SCALE = (-6.0, 1.0)
# Share of the spread of the prediction and the closest return that is added to the error's scale.
SPREAD_SHARE = 0.5


def choose_surface(
    head: HeadChannels, guess: Tensor, surfaces: Surfaces, room: Tensor, *, reach: float
) -> tuple[Tensor, Tensor]:
    """Choose among the candidates and the guess: the inverse depth, and its error's scale.

    First the plane replaces the guess, then the farthest surface what was chosen, then the nearest,
    each weighted by the confidence in it. The result is corrected, by at most `room`, a log ratio.
    No depth is beyond `reach`, the limit of the guess, unless the farthest surface is.

    Returns:
        Inverse of the normalised depth, (N, 1, h, w), 1..1/NEAREST, and the scale of the depth's
        error, of a Laplace distribution.
    """
    in_plane, in_farthest, in_nearest = confidence(head.surfaces).split(1, dim=1)
    farthest, nearest, support = surfaces.farthest, surfaces.nearest, surfaces.support
    depth = guess + in_plane * surfaces.reached * (1.0 / surfaces.plane - guess)
    depth = depth + in_farthest * support * (farthest - depth)
    depth = depth + in_nearest * support * (nearest - depth)
    depth = (depth * torch.exp(room * torch.tanh(head.correction))).clamp(min=NEAREST)
    depth = torch.minimum(depth, (farthest * support).clamp(min=reach))
    return 1.0 / depth, depth.detach() * _relative_scale(head.scale)


def correction_room(beside: Beside, support: Tensor) -> Tensor:
    """Return the greatest log of the correction: close to returns what the two surfaces differ by.

    Where there are no returns it is MAX_LOG_CORRECTION.
    """
    room = beside.far - beside.near + MAX_LOG_CORRECTION * (1.0 - support)
    return room.clamp(max=MAX_LOG_CORRECTION)


def confidence(logits: Tensor) -> Tensor:
    """Return the sigmoid, stretched so that it reaches 0 and 1, at logits of -2.4 and 2.4.

    A sigmoid of 0.95 would leave 1.5 % of error where the other candidate is a third off. Beyond
    the limits the gradient is that of the stretched sigmoid, so that the confidence can return.
    """
    share, slope = torch.sigmoid(logits), 1.0 + 2.0 * STRETCH
    limited = ramp(share, slope, -STRETCH)
    if not torch.is_grad_enabled():
        return limited
    return _with_gradient_of(slope * share - STRETCH, limited)


# Position up to which the answer is the base. A position beyond it is reduced by this value.
DEAD_ZONE = 0.1


def position(x: Tensor) -> Tensor:
    """Return x reduced by DEAD_ZONE towards 0 and limited to -1..1; the gradient is that of x."""
    limited = (x - x.clamp(-DEAD_ZONE, DEAD_ZONE)).clamp(-1.0, 1.0)
    return _with_gradient_of(x, limited) if torch.is_grad_enabled() else limited


def depart(place: Tensor, departures: Tensor) -> Tensor:
    """Return the log ratio of the depth to the base, (N, 1, h, w).

    Args:
        place: -1 = nearest surface, 0 = base, 1 = farthest, same shape.
        departures: log ratios of the nearest and of the farthest surface to the base, (N, 2, h, w).
    """
    near, far = departures.split(1, dim=1)
    departure: Tensor = place.clamp(min=0.0) * far - place.clamp(max=0.0) * near
    return departure


def join_base(
    inverse: Tensor,
    scale: Tensor,
    base: Tensor,
    departure: Tensor,
    relative_scale: Tensor,
    share: Tensor,
) -> tuple[Tensor, Tensor]:
    """Average the chosen depth with the base, which departs to a surface where there are two.

    Args:
        inverse: inverse of the chosen normalised depth, (N, 1, H, W), like all others on the grid
            of BASE_CELL.
        scale: scale of its error.
        base: inverse depth of the base.
        departure: departure from the base, see `depart`.
        relative_scale: scale of the error of the base, as a share of the depth.
        share: share of the base, see `Beside`.

    Returns:
        Inverse depth and the scale of its error, both of the shape of `inverse`.
    """
    measured = (base * torch.exp(-departure)).clamp(1.0, 1.0 / NEAREST)
    inverse = inverse + share * (measured - inverse)
    return inverse, scale + share * (relative_scale / inverse.detach() - scale)


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


def take_returns(
    inverse: Tensor, scale: Tensor, returns: Returns, confidence: Tensor, *, max_depth_m: float
) -> tuple[Tensor, Tensor]:
    """Replace the predicted depth by the closest return, weighted by the confidence in it.

    At an edge the choice on a coarser grid is a ramp; a return is on one side of it. A LiDAR beside
    the camera sees past near edges, so returns before and behind the predicted depth have
    confidences of their own. Where the parallax between both depths is too small for that, the
    return's depth is used without confidence: at the pixel of the return itself, and beside it if
    the return is farther by more than a slope explains.

    Args:
        inverse: inverse of the predicted depth, which is normalised by `max_depth_m`, (N, 1, H, W).
        scale: scale of the depth's error, same shape.
        returns: returns around each pixel.
        confidence: sigmoids of `HeadChannels.returns`, (N, 3, H, W).
        max_depth_m: depth [m] of the normalised depth 1.0.

    Returns:
        The depth; and the scale, reduced beside a return, plus the spread of the two depths.
    """
    before, behind, reduction = confidence.split(1, dim=1)
    depth = 1.0 / inverse
    measured = 1.0 / returns.inverse
    step = measured - depth
    parallax = (inverse - returns.inverse).abs()
    aligned = ramp(parallax, -1.0 / (max_depth_m * PARALLAX), 2.0)
    # It begins at a relative difference of SLOPE and is complete at twice SLOPE.
    beyond = ramp(measured * inverse, 1.0 / SLOPE, -1.0 / SLOPE - 1.0)
    weight = torch.where(step < 0, before, behind)
    weight = torch.maximum(weight, aligned * torch.maximum(returns.here, beyond)) * returns.near
    moved = weight * step
    # The mean distance of both depths from their mean is twice this: w (1 - w) |step|.
    spread = ((1.0 - weight) * moved).abs()
    scale = scale * ramp(reduction * returns.near, -MAX_SCALE_REDUCTION, 1.0)
    return depth + moved, scale + SPREAD_SHARE * spread.detach()


def _relative_scale(logits: Tensor) -> Tensor:
    """Return the error's scale as a share of the depth, see LOG_SCALE."""
    least, greatest = LOG_SCALE
    return torch.exp(least + (greatest - least) * torch.sigmoid(logits))


def _with_gradient_of(free: Tensor, limited: Tensor) -> Tensor:
    """Return the value of `limited` with the gradient of `free`."""
    return free + (limited - free).detach()
