"""Depth that starts from a base that the returns give, and departs from it to measured surfaces.

Beside returns the depth is the mean of two. One is the base (`models.planes`), which passes through
them, unless the geometry of the returns, the boundary and a few class-like channels say that a
pixel is of the nearest or the farthest surface around: for a mean of 5 m and 80 m is the depth of
no surface. These travel to other cameras; features of the image do not. The other is the choice of
the image, which alone decides farther from returns: the plane between the returns, both surfaces,
or its guess, where returns end or a car returns nothing.
At the image's size each return then replaces the depth of the pixels around it, weighted by the
network's confidence in it. Near and far surfaces kept apart resemble twin surface extrapolation
(Imran et al. 2021).

In the order of execution: `measure`, `propagate_surfaces`, `surface_features`, `limit_guess`; after
the decoder `choose_surface`, `join_base`, `dilate_returns`, `take_returns`.
"""

import math
from typing import NamedTuple, Self

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.blocks import ConvBNReLU, ramp, upsample
from models.lite_decoder import UpBlock
from models.planes import BASE_CELL, CELL, Base, fit_base
from models.pooling import cell_maxima, cell_means, maxima_around, maxima_beside, means_around

#: Least normalised depth of a surface.
NEAREST = 1e-3
#: Returns that no other confirms, see `measure`: within this depth [m], with returns in so many
#: cells around, all of them more than so many times as far.
ISOLATED_M, ISOLATED_CELLS, ISOLATED_RATIO = 10.0, 8, 3.0


class Measured(NamedTuple):
    """The measured depth at the image's size, all (N, 1, H, W), each 0 where nothing is measured.

    Height and width are multiples of CELL.
    """

    #: Normalised.
    depth: Tensor
    #: 1 where measured.
    mask: Tensor
    #: Inverse of the normalised depth, 1..1/NEAREST.
    inverse: Tensor


def measure(depth: Tensor, mask: Tensor, *, max_depth_m: float) -> Measured:
    """Drop near returns that no other return confirms: rain, snow, dust.

    A return within ISOLATED_M is dropped if at least ISOLATED_CELLS of the 24 cells of
    CELL pixels around its own have returns, and all these are more than ISOLATED_RATIO times
    as far: whatever stands so close covers more than one cell. As the dynamic radius outlier
    removal of Charron et al. 2018, on the image's grid: the farther, the smaller a thing may be.

    depth, mask: as `Measured`'s; the depth normalised by ``max_depth_m``.
    """
    inverse = mask / depth.clamp(min=NEAREST)
    cells = cell_maxima(inverse, CELL)
    seen = cells.clamp(max=1.0)  # an inverse depth is at least 1
    count = 25.0 * means_around(seen, 5) - seen
    # Inverse depth beyond which a return is isolated.
    most = torch.where(
        count > ISOLATED_CELLS - 0.5,
        (ISOLATED_RATIO * maxima_beside(cells)).clamp(min=max_depth_m / ISOLATED_M),
        1.0 / NEAREST,
    )
    most = F.interpolate(most, scale_factor=float(CELL), mode="nearest")
    kept = (inverse <= most).to(mask.dtype)
    return Measured(depth * kept, mask * kept, inverse * kept)


#: Windows of the max-pools that propagate a surface into cells without any, one after the other:
#: together they reach 10 cells.
WINDOWS = (3, 5, 7, 9)


class Surfaces(NamedTuple):
    """Candidates of the depth on a grid, and where there are any, each (N, 1, h, w)."""

    #: Normalised depth, NEAREST..1, of the nearest and the farthest surface; undefined where
    #: ``support`` is 0.
    nearest: Tensor
    farthest: Tensor
    #: Inverse of the normalised depth, 1..1/NEAREST; undefined where ``reached`` is 0.
    plane: Tensor
    #: 0..1: returns within reach of WINDOWS, and in reach of the plane's.
    support: Tensor
    reached: Tensor


def propagate_surfaces(measured: Measured) -> tuple[Surfaces, Base, Tensor]:
    """Propagate the measured depth to a grid of cells of CELL pixels.

    Height and width are multiples of ``planes.CELL * 2**planes.LEVELS``. The nearest surface is the
    maximum of inverse depth, smoothed over 3 x 3 cells, the farthest the maximum of depth.

    Returns:
        The surfaces; the base; and the number of measured pixels in a cell, (N, 1, h, w).
    """
    depth, mask, inverse = measured
    extremes = cell_maxima(torch.cat([inverse, depth], dim=1), CELL)
    both = extremes
    for window in WINDOWS:
        both = torch.where(both > 0, both, maxima_around(both, window))
    near, farthest = both.split(1, dim=1)
    support = near.clamp(max=1.0)  # an inverse depth is at least 1
    inverse_mean, known = means_around(torch.cat([near, support], dim=1), 3).split(1, dim=1)
    nearest = known.clamp(min=1e-6) / inverse_mean.clamp(min=1e-6)
    base = fit_base(inverse, mask, extremes)
    surfaces = Surfaces(
        nearest.clamp(NEAREST, 1.0),
        farthest.clamp(NEAREST, 1.0),
        base.plane.clamp(1.0, 1.0 / NEAREST),
        support,
        base.plane.clamp(max=1.0),
    )
    base = base._replace(base=base.base.clamp(1.0, 1.0 / NEAREST))
    return surfaces, base, 4.0 * cell_means(base.returns, CELL // BASE_CELL)


#: Channels of `surface_features`.
FEATURE_CHANNELS = 6


def surface_features(surfaces: Surfaces, count: Tensor) -> Tensor:
    """Features for a convolution: (N, FEATURE_CHANNELS, h, w), each 0..1 and 0 without support."""
    depths = torch.cat([surfaces.nearest, surfaces.farthest, 1.0 / surfaces.plane], dim=1)
    known = torch.cat([surfaces.support, surfaces.support, surfaces.reached], dim=1)
    steps = (1.0 - torch.log(depths) * (1.0 / math.log(NEAREST))) * known
    density = count * (1.0 / CELL**2)
    return torch.cat([steps, surfaces.support, surfaces.reached, density], dim=1)


#: A cell is within the LiDAR's field of view if there is a return up to so many cells above it, and
#: up to so many to each side. Larger values limit the guess in the sky above the scan, too.
LOOKED_ABOVE, LOOKED_BESIDE = 10, 2


def limit_guess(surfaces: Surfaces, count: Tensor) -> Tensor:
    """Return the greatest depth that the guess from the image may have: the farthest surface's.

    A surface without returns, such as a black car or a window, hides the surfaces behind it. Above
    the LiDAR's field of view there is no limit. Shapes as `surface_features`.
    """
    window = (LOOKED_ABOVE + 1, 2 * LOOKED_BESIDE + 1)
    padded = F.pad(count, (LOOKED_BESIDE, LOOKED_BESIDE, LOOKED_ABOVE, 0))
    looked = F.max_pool2d(padded, window, 1).clamp(max=1.0) * surfaces.support
    return 1.0 - looked * (1.0 - surfaces.farthest)


#: Log ratio of a surface to the base up to which they are one surface; from twice as much on they
#: are two.
APART = 0.08
#: Greatest log ratio of a surface to the base.
MOST_APART = 2.5
#: Largest share of the base; the image keeps the rest, and the mean of both is better than either.
MOST_BESIDE = 0.5


class Beside(NamedTuple):
    """What decides the depth beside returns, each (N, 1, h, w) on the grid of CELL."""

    #: Log ratios of the nearest (-MOST_APART..0) and of the farthest surface to the base.
    near: Tensor
    far: Tensor
    #: Share of the base: MOST_BESIDE up to about 2 pixels from a return, 0 beyond about 5.
    share: Tensor


def look_beside(surfaces: Surfaces, base: Base) -> Beside:
    """Compare the surfaces with the base."""
    seen = base.returns.clamp(max=1.0)
    share = (MOST_BESIDE / 2) * (maxima_around(seen, 3) + maxima_around(seen, 5))
    maps = cell_means(torch.cat([base.base, share], dim=1), CELL // BASE_CELL)
    inverse, share = maps.split(1, dim=1)
    near = torch.log(surfaces.nearest * inverse).clamp(-MOST_APART, 0.0)
    far = torch.log(surfaces.farthest * inverse).clamp(0.0, MOST_APART)
    return Beside(near * surfaces.support, far * surfaces.support, share)


def apart(log_ratio: Tensor) -> Tensor:
    """0 for one surface, the log ratio itself for two, see APART."""
    return log_ratio * ramp(log_ratio.abs(), 1.0 / APART, -1.0)


class Candidates(NamedTuple):
    """What the returns show, see `SurfaceDepthHead.propagate`."""

    measured: Measured
    surfaces: Surfaces
    base: Base
    beside: Beside
    #: (N, FEATURE_CHANNELS, h, w), on the grid of CELL.
    features: Tensor
    #: Greatest normalised depth of the guess from the image, (N, 1, h, w), see `limit_guess`.
    guess_limit: Tensor


class HeadChannels(NamedTuple):
    """The channels of the head's last convolution, each (N, C, h, w), before their activations."""

    #: Confidence in the plane, in the farthest and in the nearest surface, C = 3.
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


#: Channels of each field of `HeadChannels`, and their sum; those that a new head starts with.
_HEAD_SPLIT = [3, 1, 1, 3]
HEAD_CHANNELS = sum(_HEAD_SPLIT)
_FIRST_CONFIDENCES = (2.5, -4.0, -4.0)
#: Class-like channels of the geometry's branch, and the others that it reads.
_CLASS_CHANNELS, _RATIO_CHANNELS = 8, 9


class SurfaceDepthHead(nn.Module):
    """Depth at the image's size, and the scale of its error, from candidates and features.

    Args:
        channels: of the decoders' features, at stride 4.
        at_2_channels: of the encoder's features at stride 2.
        at_4_channels: of those at stride 4.
        refine_channels: at stride 2, where the choice is made; 0 = at stride 4.
        geometry_channels: of the convolutions that decide beside returns.
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
        # Classes imply surfaces without returns: a car has a roof and windows.
        self.semantics = nn.Conv2d(channels, channels, 1) if semantics else None
        self.refinement = None
        if refine_channels:
            self.refinement = UpBlock(channels, at_2_channels, refine_channels)
            self.coarse_head = nn.Conv2d(channels, HEAD_CHANNELS, 1)
        self.head = nn.Conv2d(refine_channels or channels, HEAD_CHANNELS, 1)
        self.cell = CELL // 2 if refine_channels else CELL
        # Class-like channels of its own: other classes leave the depth as it is.
        self.classes = nn.Conv2d(channels, _CLASS_CHANNELS, 1) if semantics else None
        self.geometry = nn.Sequential(
            ConvBNReLU(_RATIO_CHANNELS + (_CLASS_CHANNELS if semantics else 0), geometry_channels),
            ConvBNReLU(geometry_channels, geometry_channels, dilation=2),
            ConvBNReLU(geometry_channels, geometry_channels),
            nn.Conv2d(geometry_channels, 2, 1),
        )

    @torch.no_grad()
    def start_as_base(self) -> None:
        """Set the head to base, plane and the guess beyond, without classes or corrections."""
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

    def propagate(self, depth: Tensor, mask: Tensor) -> Candidates:
        """Return the candidates around each cell; depth and mask as `measure`."""
        measured = measure(depth, mask, max_depth_m=self.max_depth_m)
        surfaces, base, count = propagate_surfaces(measured)
        features, limit = surface_features(surfaces, count), limit_guess(surfaces, count)
        beside = look_beside(surfaces, base)
        return Candidates(measured, surfaces, base, beside, features, limit)

    def add_semantics(self, features: Tensor, semantics: Tensor | None) -> Tensor:
        """Add what the semantic decoder's features say of the depth."""
        return features if self.semantics is None else features + self.semantics(semantics)

    def forward(
        self,
        candidates: Candidates,
        features: Tensor,
        semantics: Tensor | None,
        at_2: Tensor,
        boundary_logits: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return the depth, its error's scale and the boundary's logits at the image's size.

        features, semantics: of the decoders, on the grid of CELL, as the boundary's logits,
        which are upsampled with the depth; at_2: of the encoder.
        """
        guess = self.farthest_guess * torch.sigmoid(self.guess(features))
        guess = torch.minimum(guess, candidates.guess_limit)
        geometry = self.geometry(self._geometry(candidates, semantics, boundary_logits)).float()
        features = features + self.project(candidates.features)
        features = self.add_semantics(features, semantics)
        surfaces = candidates.surfaces
        if self.refinement is None:
            found = self.head(features)
        else:
            found = self.head(self.refinement(features, at_2)) + upsample(
                self.coarse_head(features)
            )
            # One upsampling for all maps of a grid: ONNX Runtime splits a Resize by channels.
            maps = upsample(torch.cat([*surfaces, guess, boundary_logits], dim=1))
            *finer, guess, boundary_logits = maps.split(1, dim=1)
            surfaces = Surfaces(*finer)
        head = HeadChannels.split(found.float())
        guess, boundary_logits = guess.float(), boundary_logits.float()
        depth, scale = choose_surface(head, guess, surfaces, reach=self.farthest_guess)
        maps = torch.cat([1.0 / depth, scale, boundary_logits], dim=1)
        maps = upsample(maps, factor=self.cell // BASE_CELL)
        inverse, scale, boundary_logits = maps.split(1, dim=1)
        beside = candidates.beside
        if self.training:
            # One of both alone in two of three steps: neither learns to make up for the other.
            beside = beside._replace(share=beside.share * torch.randint(3, ()).to(beside.share))
        inverse, scale = join_base(inverse, scale, geometry, candidates.base.base, beside)
        maps = upsample(torch.cat([inverse, scale, boundary_logits], dim=1), factor=BASE_CELL)
        inverse, scale, boundary_logits = maps.split(1, dim=1)
        # One value a cell is enough: the returns give the position of an edge.
        in_returns = torch.sigmoid(head.returns)
        in_returns = F.interpolate(in_returns, scale_factor=float(self.cell), mode="nearest")
        returns = dilate_returns(candidates.measured)
        depth, scale = take_returns(
            1.0 / inverse, scale, returns, in_returns, max_depth_m=self.max_depth_m
        )
        return depth, scale, boundary_logits

    def _geometry(
        self, candidates: Candidates, semantics: Tensor | None, boundary_logits: Tensor
    ) -> Tensor:
        """What decides beside returns: nothing that belongs to a rig."""
        surfaces, beside = candidates.surfaces, candidates.beside
        ratios, density = torch.cat(beside[:2], dim=1), candidates.features[:, -1:]
        read = [ratios, 5.0 * apart(ratios), surfaces.support, surfaces.reached]
        read += [
            beside.share * (1.0 / MOST_BESIDE),
            density,
            torch.sigmoid(boundary_logits.float()),
        ]
        if self.classes is not None:
            read.append(torch.sigmoid(self.classes(semantics)))
        return torch.cat(read, dim=1)


#: A position up to this is on the base; beyond, so much less.
DEAD_ZONE = 0.1


def position(x: Tensor) -> Tensor:
    """Return x less DEAD_ZONE on both sides of 0, limited to -1..1; the gradient is x's."""
    limited = (x - x.clamp(-DEAD_ZONE, DEAD_ZONE)).clamp(-1.0, 1.0)
    if not torch.is_grad_enabled():
        return limited
    return x + (limited - x).detach()


def join_base(
    inverse: Tensor, scale: Tensor, geometry: Tensor, base: Tensor, beside: Beside
) -> tuple[Tensor, Tensor]:
    """Average the choice beside returns with the base, departed from where surfaces differ.

    Args:
        inverse: of the chosen normalised depth, (N, 1, H, W), on the grid of BASE_CELL.
        scale: of its error, same shape.
        geometry: position, -1 = nearest surface, 1 = farthest, and scale of the error, before their
            activations, (N, 2, h, w), on the grid of CELL.
        base: inverse depth, shape of ``inverse``.
        beside: on the grid of CELL.
    """
    place, log_scale = geometry.split(1, dim=1)
    place = position(place)
    departure = place.clamp(min=0.0) * apart(beside.far) - place.clamp(max=0.0) * apart(beside.near)
    maps = torch.cat([departure, _relative_scale(log_scale), beside.share], dim=1)
    departure, relative, share = upsample(maps, factor=CELL // BASE_CELL).split(1, dim=1)
    measured = (base * torch.exp(-departure)).clamp(1.0, 1.0 / NEAREST)
    inverse = torch.lerp(inverse, measured, share)
    return inverse, torch.lerp(scale, relative / inverse.detach(), share)


#: Of the sigmoid of a confidence, beyond 0 and 1.
STRETCH = 0.1
#: Greatest log of the factor that corrects the chosen depth: 0.61 to 1.65 times. Not tuned.
MAX_LOG_CORRECTION = 0.5
#: Least and greatest log of the ratio of the error's scale to the depth: 0.25 % to 2.7 times the
#: depth, so that neither the loss nor its gradient grows without bound. Not tuned.
LOG_SCALE = (-6.0, 1.0)
#: Share of the spread of the candidates, see `replace`, that is added to the error's scale.
SPREAD_SHARE = 0.5


def choose_surface(
    head: HeadChannels, guess: Tensor, surfaces: Surfaces, *, reach: float = 1.0
) -> tuple[Tensor, Tensor]:
    """Choose among the candidates and the guess: the depth, and its error's scale.

    Each candidate replaces what was chosen before, weighted by the confidence in it: the plane the
    guess, then the farthest surface, then the nearest. The choice is corrected. No depth is beyond
    ``reach``, that of the guess, unless the farthest surface is.

    Returns the normalised depth, (N, 1, h, w), NEAREST..1, and the scale of its error's Laplace
    distribution.
    """
    in_plane, in_farthest, in_nearest = confidence(head.surfaces).split(1, dim=1)
    farthest, nearest = surfaces.farthest, surfaces.nearest
    plane = 1.0 / surfaces.plane
    depth, spread = replace(guess, 0.0, plane - guess, in_plane * surfaces.reached)
    for candidate, weight in ((farthest, in_farthest), (nearest, in_nearest)):
        depth, spread = replace(depth, spread, candidate - depth, weight * surfaces.support)
    depth = correct(depth, surfaces, head.correction).clamp(min=NEAREST)
    depth = torch.minimum(depth, (farthest * surfaces.support).clamp(min=reach))
    scale = _relative_scale(head.scale)
    return depth, depth.detach() * scale + SPREAD_SHARE * spread.detach()


def _relative_scale(logits: Tensor) -> Tensor:
    """The error's scale as a share of the depth, see LOG_SCALE."""
    least, greatest = LOG_SCALE
    return torch.exp(least + (greatest - least) * torch.sigmoid(logits))


def correct(depth: Tensor, surfaces: Surfaces, logits: Tensor) -> Tensor:
    """Scale the depth, near returns at most by what both surfaces leave open.

    Where they agree there is no room; without returns it is MAX_LOG_CORRECTION.
    """
    disagreement = surfaces.farthest / surfaces.nearest
    room = torch.log(disagreement).clamp(0.0, MAX_LOG_CORRECTION)
    room = MAX_LOG_CORRECTION + surfaces.support * (room - MAX_LOG_CORRECTION)
    return depth * torch.exp(room * torch.tanh(logits))


def confidence(logits: Tensor) -> Tensor:
    """Return the sigmoid, stretched so that it reaches 0 and 1, at logits of -2.4 and 2.4.

    A twentieth of a depth that is a third off would be 1.5 % in every pixel. The gradient is that
    of the stretched sigmoid everywhere, so that what is closed can open.
    """
    share, slope = torch.sigmoid(logits), 1.0 + 2.0 * STRETCH
    limited = ramp(share, slope, -STRETCH)
    if not torch.is_grad_enabled():
        return limited
    stretched = slope * share - STRETCH
    return stretched + (limited - stretched).detach()


def replace(
    depth: Tensor, spread: Tensor | float, step: Tensor, weight: Tensor
) -> tuple[Tensor, Tensor]:
    """Replace a share ``weight`` (0..1) of the depth by a candidate that is ``step`` farther.

    The spread is half the mean distance of the candidates from the depth. Of two it is
    w (1 - w) |step|; of more, this bounds it.
    """
    taken = weight * step
    return depth + taken, (1.0 - weight) * (spread + taken.abs())


#: Radius [pixels] of the square around a return in which it may replace the depth.
RETURN_REACH = 2


class Returns(NamedTuple):
    """The returns around each pixel, all (N, 1, H, W)."""

    #: Inverse of the normalised depth of the closest return, of several as close of the one in
    #: front. 1 where ``near`` is 0.
    inverse: Tensor
    #: 1 where a return is within RETURN_REACH.
    near: Tensor
    #: 1 where a return is at the pixel itself.
    here: Tensor


def dilate_returns(measured: Measured) -> Returns:
    """Dilate the returns by RETURN_REACH pixels."""
    # An inverse depth is at least 1: clamped to 1 it says where there is one.
    inverse, near = measured.inverse, measured.mask
    for _ in range(RETURN_REACH):
        inverse = inverse + (1.0 - near) * maxima_around(inverse, 3)
        near = inverse.clamp(max=1.0)
    return Returns(inverse.clamp(min=1.0), near, measured.mask)


#: Difference of inverse depths [1/m] up to which a LiDAR beside the camera hardly sees past the
#: nearer one: 1.3 pixels of parallax for 1 m between both, at 721.5 pixels of focal length. Up to
#: twice as much counts in part.
PARALLAX = 1.8e-3
#: Relative difference of depths two pixels apart on one slanted surface. Up to twice as much counts
#: in part.
SLOPE = 0.03
#: Largest share by which a return beside a pixel reduces the error's scale, which stays positive.
#: Not tuned.
MAX_SCALE_REDUCTION = 0.9


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
    measured = 1.0 / returns.inverse
    step = measured - depth
    parallax = (inverse - returns.inverse).abs()
    aligned = ramp(parallax, -1.0 / (max_depth_m * PARALLAX), 2.0)
    # From a relative difference of SLOPE on, in full from twice as much.
    beyond = ramp(measured * inverse, 1.0 / SLOPE, -1.0 / SLOPE - 1.0)
    weight = torch.where(step < 0, before, behind)
    weight = torch.maximum(weight, aligned * torch.maximum(returns.here, beyond)) * returns.near
    depth, spread = replace(depth, 0.0, step, weight)
    scale = scale * ramp(reduction * returns.near, -MAX_SCALE_REDUCTION, 1.0)
    return depth, scale + SPREAD_SHARE * spread.detach()
