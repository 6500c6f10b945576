"""Dense depth from sparse depth by choosing among surfaces that were measured.

A mean of 5 m and 80 m is the depth of no surface. Three candidates are therefore kept apart around
each pixel: the nearest surface, the farthest, and the mean of inverse depth. The network chooses
among them on a grid. At the image's size each return then replaces the chosen depth of the pixels
around it, weighted by the network's confidence in it. Near and far surfaces kept apart resemble
twin surface extrapolation (Imran et al. 2021), depth propagated before the network bilateral
propagation (Tang et al. 2024).
"""

import math
from typing import NamedTuple, Self

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.blocks import upsample
from models.lite_decoder import UpBlock
from models.pooling import cell_maxima, maxima_around, maxima_beside, means_around
from models.pull_push import pull_push

#: Side of a cell in pixels: of the coarse grid, where surfaces are propagated, and of the fine one.
COARSE_CELL, FINE_CELL = 4, 2
#: Windows of the max-pools that propagate a surface into cells without any, one after the other:
#: together they reach 10 cells.
WINDOWS = (3, 5, 7, 9)
#: Times that the coarse grid is halved for the mean: up to the stride of 32 of the network.
LEVELS = 3
#: Least normalised depth of a surface.
NEAREST = 1e-3
#: Difference of inverse depths [1/m] up to which a LiDAR beside the camera hardly sees past the
#: nearer one: 1.3 pixels of parallax for 1 m between both, at 721.5 pixels of focal length. Up to
#: twice as much counts in part.
PARALLAX = 1.8e-3
#: Relative difference of depths two pixels apart on one slanted surface. Up to twice as much counts
#: in part.
SLOPE = 0.03
#: A return up to this many times as far as a surface, or as near, belongs to it. Not tuned.
SAME_SURFACE = 1.25
#: Greatest log of the factor that corrects the chosen depth: 0.61 to 1.65 times. Not tuned.
MAX_LOG_CORRECTION = 0.5
#: Least and greatest log of the ratio of the error's scale to the depth: 0.25 % to 2.7 times the
#: depth, so that neither the loss nor its gradient grows without bound. Not tuned.
LOG_SCALE = (-6.0, 1.0)
#: Returns that no other confirms, see `measure`: within this depth [m], with returns in so many
#: cells around, all of them more than so many times as far.
ISOLATED_M, ISOLATED_CELLS, ISOLATED_RATIO = 10.0, 8, 3.0
#: Channels of `surface_features`.
FEATURE_CHANNELS = 6
#: Radius [pixels] of the square around a return in which it may replace the depth.
RETURN_REACH = 2
#: Largest share by which a return beside a pixel reduces the error's scale, which stays positive.
#: Not tuned.
MAX_SCALE_REDUCTION = 0.9
#: Share of the spread of the candidates that is added to the error's scale.
SPREAD_SHARE = 0.25


class Measured(NamedTuple):
    """The measured depth at the image's size, all (N, 1, H, W), each 0 where nothing is measured.

    Height and width are multiples of COARSE_CELL.
    """

    #: Normalised.
    depth: Tensor
    #: 1 where measured.
    mask: Tensor
    #: Inverse of the normalised depth, 1..1/NEAREST.
    inverse: Tensor


class Returns(NamedTuple):
    """The returns around each pixel, all (N, 1, H, W)."""

    #: Inverse of the normalised depth of the closest return, of several as close of the one in
    #: front. 1 where ``near`` is 0.
    inverse: Tensor
    #: 1 where a return is within RETURN_REACH.
    near: Tensor
    #: 1 where a return is at the pixel itself.
    here: Tensor


class Surfaces(NamedTuple):
    """Candidates of the normalised depth, each (N, 1, h, w), NEAREST..1, and where there are any.

    ``nearest`` and ``farthest`` are undefined where ``support`` (0..1) is 0, ``mean`` where
    ``mean_support`` (0..1) is 0.
    """

    nearest: Tensor
    farthest: Tensor
    mean: Tensor
    support: Tensor
    mean_support: Tensor


class HeadChannels(NamedTuple):
    """The channels of the head's last convolution, each (N, C, h, w), before their activations."""

    #: Confidence in the mean, the farthest and the nearest surface, C = 3.
    surfaces: Tensor
    #: Relative correction of the chosen depth, C = 1.
    correction: Tensor
    #: Scale of the error where the candidates agree, C = 1.
    scale: Tensor
    #: Confidence in a return before the predicted depth, in one behind it, and the reduction of the
    #: error's scale beside a return, C = 3.
    returns: Tensor

    @classmethod
    def split(cls, channels: Tensor) -> Self:
        """Split (N, HEAD_CHANNELS, h, w)."""
        return cls(*channels.split(_HEAD_SPLIT, dim=1))


#: Channels of each field of `HeadChannels`, and their sum.
_HEAD_SPLIT = [3, 1, 1, 3]
HEAD_CHANNELS = sum(_HEAD_SPLIT)


def measure(depth: Tensor, mask: Tensor, *, max_depth_m: float) -> Measured:
    """Drop near returns that no other return confirms: rain, snow, dust.

    A return within ISOLATED_M is dropped if at least ISOLATED_CELLS of the 24 cells of
    COARSE_CELL pixels around its own have returns, and all these are more than ISOLATED_RATIO times
    as far: whatever stands so close covers more than one cell. As the dynamic radius outlier
    removal of Charron et al. 2018, on the image's grid: the farther, the smaller a thing may be.

    depth, mask: as `Measured`'s; the depth normalised by ``max_depth_m``.
    """
    inverse = mask / depth.clamp(min=NEAREST)
    cells = cell_maxima(inverse, COARSE_CELL)
    seen = (cells > 0).to(cells.dtype)
    count = 25.0 * means_around(seen, 5) - seen
    # Inverse depth beyond which a return is isolated.
    most = torch.where(
        count > ISOLATED_CELLS - 0.5,
        (ISOLATED_RATIO * maxima_beside(cells)).clamp(min=max_depth_m / ISOLATED_M),
        1.0 / NEAREST,
    )
    most = F.interpolate(most, scale_factor=float(COARSE_CELL), mode="nearest")
    kept = (inverse <= most).to(mask.dtype)
    return Measured(depth * kept, mask * kept, inverse * kept)


def propagate_surfaces(measured: Measured) -> tuple[Surfaces, Tensor]:
    """Propagate the measured depth to a grid of cells of COARSE_CELL pixels.

    Height and width are multiples of ``COARSE_CELL * 2**LEVELS``. The nearest surface is the
    maximum of inverse depth, smoothed over 3 x 3 cells, the farthest the maximum of depth, both as
    far as WINDOWS reach; the mean is a pull-push pyramid of inverse depth, which reaches as far as
    its LEVELS. Returns the surfaces, and the share of measured pixels in a cell, (N, 1, h, w).
    """
    depth, mask, inverse = measured
    propagated = cell_maxima(torch.cat([inverse, depth], dim=1), COARSE_CELL)
    for window in WINDOWS:
        propagated = torch.where(propagated > 0, propagated, maxima_around(propagated, window))
    support = (propagated[:, 1:] > 0).to(depth.dtype)
    smooth = means_around(torch.cat([propagated[:, :1], support], dim=1), 3)
    nearest = smooth[:, 1:].clamp(min=1e-6) / smooth[:, :1].clamp(min=1e-6)

    mean, density = pull_push(torch.cat([inverse, mask], dim=1), factor=COARSE_CELL, levels=LEVELS)
    surfaces = Surfaces(
        nearest.clamp(NEAREST, 1.0),
        propagated[:, 1:].clamp(NEAREST, 1.0),
        (mean[:, 1:].clamp(min=1e-6) / mean[:, :1].clamp(min=1e-6)).clamp(NEAREST, 1.0),
        support,
        mean[:, 1:],
    )
    return surfaces, density


def surface_features(surfaces: Surfaces, density: Tensor) -> Tensor:
    """Features for a convolution: (N, FEATURE_CHANNELS, h, w), each 0..1 and 0 without support."""
    depths = torch.cat([surfaces.nearest, surfaces.farthest, surfaces.mean], dim=1)
    known = torch.cat([surfaces.support, surfaces.support, surfaces.mean_support], dim=1)
    steps = (1.0 - torch.log(depths) * (1.0 / math.log(NEAREST))) * known
    return torch.cat([steps, surfaces.support, surfaces.mean_support, density], dim=1)


def refine_surfaces(upsampled: Surfaces, measured: Measured) -> Surfaces:
    """Replace the propagated surfaces by the measured ones in cells of FINE_CELL pixels.

    A return replaces only the surface that it belongs to: a LiDAR beside the camera sees past near
    edges, and a return from behind one would tear it. upsampled: the coarse surfaces on the fine
    grid.
    """
    fine = cell_maxima(torch.cat([measured.inverse, measured.depth], dim=1), FINE_CELL)
    seen = fine[:, 1:] > 0
    nearest = 1.0 / fine[:, :1].clamp(min=1.0)
    farthest = fine[:, 1:].clamp(min=NEAREST)
    between = torch.sqrt(upsampled.nearest * upsampled.farthest)
    on_near = nearest < torch.maximum(between, SAME_SURFACE * upsampled.nearest)
    on_far = farthest > torch.minimum(between, upsampled.farthest * (1.0 / SAME_SURFACE))
    return upsampled._replace(
        nearest=torch.where(seen & on_near, nearest, upsampled.nearest),
        farthest=torch.where(seen & on_far, farthest, upsampled.farthest),
    )


def choose_surface(
    head: HeadChannels, guess: Tensor, surfaces: Surfaces, *, reach: float = 1.0
) -> tuple[Tensor, Tensor]:
    """Choose among the candidates and the guess: the depth, and its error's scale.

    Each candidate in turn replaces the depth chosen before, weighted by its confidence: nested
    sigmoids give any weights that a soft-max can. Without support the guess remains. No depth is
    beyond ``reach``, that of the guess, unless the farthest surface is.

    Returns the normalised depth, (N, 1, h, w), NEAREST..1, and the scale of its error's Laplace
    distribution.
    """
    depth, spread = guess, torch.zeros_like(guess)
    candidates = (
        (surfaces.mean, surfaces.mean_support),
        (surfaces.farthest, surfaces.support),
        (surfaces.nearest, surfaces.support),
    )
    confidences = torch.sigmoid(head.surfaces).split(1, dim=1)
    for confidence, (candidate, support) in zip(confidences, candidates, strict=True):
        depth, spread = replace(depth, spread, candidate - depth, confidence * support)
    correction = torch.exp(MAX_LOG_CORRECTION * torch.tanh(head.correction))
    depth = (depth * correction).clamp(min=NEAREST)
    depth = torch.minimum(depth, (surfaces.farthest * surfaces.support).clamp(min=reach))
    least, greatest = LOG_SCALE
    scale = torch.exp(least + (greatest - least) * torch.sigmoid(head.scale))
    return depth, depth.detach() * scale + SPREAD_SHARE * spread.detach()


def replace(
    depth: Tensor, spread: Tensor | float, step: Tensor, weight: Tensor
) -> tuple[Tensor, Tensor]:
    """Replace a share ``weight`` (0..1) of the depth by a candidate that is ``step`` farther.

    The spread is the mean distance of the candidates from the depth. Of two it is
    2 w (1 - w) |step|; of more, this bounds it.
    """
    taken = weight * step
    return depth + taken, (1.0 - weight) * (spread + 2.0 * taken.abs())


def dilate_returns(measured: Measured) -> Returns:
    """Dilate the returns by RETURN_REACH pixels."""
    inverse = measured.inverse
    for _ in range(RETURN_REACH):
        inverse = torch.where(inverse > 0, inverse, maxima_around(inverse, 3))
    near = (inverse > 0).to(inverse.dtype)
    return Returns(inverse.clamp(min=1.0), near, measured.mask)


def take_returns(
    depth: Tensor, scale: Tensor, returns: Returns, confidence: Tensor, *, max_depth_m: float
) -> tuple[Tensor, Tensor]:
    """Replace the predicted depth by the closest return, weighted by the confidence in it.

    At an edge the choice on a coarser grid is a ramp; a return is on one side of it. A LiDAR beside
    the camera sees past near edges, so returns before and behind the predicted depth have
    confidences of their own. Where the parallax between both depths is too small for that, the
    return is the pixel's: in any case if it is at the pixel itself, and beside it if it is behind
    by more than a slope explains.

    depth, scale (N, 1, H, W): normalised by ``max_depth_m``; confidence (N, 3, H, W): the sigmoids
    of `HeadChannels.returns`. Returns the depth, and the scale, reduced beside a return, with the
    spread of the two depths.
    """
    before, behind, reduction = confidence.split(1, dim=1)
    inverse = 1.0 / depth
    step = 1.0 / returns.inverse - depth
    parallax = (inverse - returns.inverse).abs()
    aligned = (2.0 - parallax * (1.0 / (max_depth_m * PARALLAX))).clamp(0.0, 1.0)
    beyond = (step * inverse * (1.0 / SLOPE) - 1.0).clamp(0.0, 1.0)
    weight = torch.where(step < 0, before, behind)
    weight = torch.maximum(weight, aligned * torch.maximum(returns.here, beyond)) * returns.near
    depth, spread = replace(depth, 0.0, step, weight)
    scale = scale * (1.0 - MAX_SCALE_REDUCTION * reduction * returns.near)
    return depth, scale + SPREAD_SHARE * spread.detach()


class Candidates(NamedTuple):
    """What the returns show, see `SurfaceDepthHead.propagate`."""

    measured: Measured
    surfaces: Surfaces
    #: (N, FEATURE_CHANNELS, h, w), on the grid of COARSE_CELL.
    features: Tensor


class SurfaceDepthHead(nn.Module):
    """Depth at the image's size, and the scale of its error, from candidates and features.

    Args:
        channels: of the decoders' features, at stride 4.
        at_2_channels: of the encoder's features at stride 2.
        at_4_channels: of those at stride 4.
        refine_channels: at stride 2, where the choice is made; 0 = at stride 4.
        semantics: whether there are features of the semantic decoder.
        max_depth_m: depth of 1.0.
        farthest_guess: the farthest normalised depth without a return.
    """

    def __init__(
        self,
        channels: int,
        at_2_channels: int,
        at_4_channels: int,
        *,
        refine_channels: int,
        semantics: bool,
        max_depth_m: float,
        farthest_guess: float,
    ) -> None:
        super().__init__()
        self.max_depth_m, self.farthest_guess = max_depth_m, farthest_guess
        self.embed = nn.Conv2d(FEATURE_CHANNELS, at_4_channels, 1)
        self.guess = nn.Conv2d(channels, 1, 1)
        self.project = nn.Conv2d(FEATURE_CHANNELS, channels, 1)
        # Classes imply surfaces without returns: a car has a roof and windows.
        self.semantics = nn.Conv2d(channels, channels, 1) if semantics else None
        self.refinement = None
        if refine_channels:
            self.refinement = UpBlock(channels, at_2_channels, refine_channels)
            self.coarse_head = nn.Conv2d(channels, HEAD_CHANNELS, 1)
        self.head = nn.Conv2d(refine_channels or channels, HEAD_CHANNELS, 1)
        self.cell = FINE_CELL if refine_channels else COARSE_CELL

    def ignore_semantics(self) -> None:
        """Zero the layer of the semantics: weights trained without it give the same depth."""
        if self.semantics is not None:
            nn.init.zeros_(self.semantics.weight)

    def propagate(self, depth: Tensor, mask: Tensor) -> Candidates:
        """Return the candidates around each cell; depth and mask as `measure`."""
        measured = measure(depth, mask, max_depth_m=self.max_depth_m)
        surfaces, density = propagate_surfaces(measured)
        return Candidates(measured, surfaces, surface_features(surfaces, density))

    def forward(
        self,
        candidates: Candidates,
        features: Tensor,
        semantics: Tensor | None,
        at_2: Tensor,
        boundary_logits: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return the depth, its error's scale and the boundary's logits at the image's size.

        features, semantics: of the decoders, on the grid of COARSE_CELL, as the boundary's logits,
        which are upsampled with the depth; at_2: of the encoder.
        """
        guess = self.farthest_guess * torch.sigmoid(self.guess(features))
        features = features + self.project(candidates.features)
        if self.semantics is not None:
            features = features + self.semantics(semantics)
        surfaces = candidates.surfaces
        if self.refinement is None:
            found = self.head(features)
        else:
            found = self.head(self.refinement(features, at_2)) + upsample(
                self.coarse_head(features)
            )
        head = HeadChannels.split(found.float())
        guess, boundary_logits = guess.float(), boundary_logits.float()
        if self.refinement is not None:
            # One upsampling for all maps of a grid: ONNX Runtime splits a Resize by channels.
            maps = torch.cat([*surfaces, guess, boundary_logits], dim=1)
            *fine, guess, boundary_logits = upsample(maps).split(1, dim=1)
            surfaces = refine_surfaces(Surfaces(*fine), candidates.measured)
        depth, scale = choose_surface(head, guess, surfaces, reach=self.farthest_guess)
        maps = upsample(torch.cat([depth, scale, boundary_logits], dim=1), factor=self.cell)
        depth, scale, boundary_logits = maps.split(1, dim=1)
        # One value a cell is enough: the returns give the position of an edge.
        confidence = torch.sigmoid(head.returns)
        confidence = F.interpolate(confidence, scale_factor=float(self.cell), mode="nearest")
        returns, limit = dilate_returns(candidates.measured), self.max_depth_m
        depth, scale = take_returns(depth, scale, returns, confidence, max_depth_m=limit)
        return depth, scale, boundary_logits
