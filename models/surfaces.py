"""Depth that starts from a base that the returns give, and departs from it to measured surfaces.

The base (`models.planes`) passes through the returns and is a plane between them. The network
learns one number a pixel, where to depart from it: to the nearest or the farthest surface around,
for a mean of 5 m and 80 m is the depth of no surface. Near returns it is from the geometry of the
returns, the boundary and a few class-like channels, which travel to other cameras; far from them it
is from the image, whose guess there replaces the base. At the image's size each return then
replaces the depth of the pixels around it, weighted by the network's confidence in it. Near and far
surfaces kept apart resemble twin surface extrapolation (Imran et al. 2021).

In the order of execution: `measure`, `propagate_surfaces`, `surface_features`, `limit_guess`; after
the decoder `choose_surface`, `to_image_size`, `dilate_returns`, `take_returns`.
"""

import math
from typing import NamedTuple, Self

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.blocks import ConvBNReLU, ramp, upsample
from models.planes import BASE_CELL, CELL, fit_base
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
    #: Inverse of the normalised depth, 1..1/NEAREST: the plane, and the base of which it is the
    #: mean in a cell; undefined where ``reached`` is 0.
    plane: Tensor
    base: Tensor
    #: 0..1: returns within reach of WINDOWS, and in reach of the plane's.
    support: Tensor
    reached: Tensor
    #: 0..1: returns beside, 1 up to about 2 pixels from one, 0 beyond about 5.
    beside: Tensor
    #: 0..1: no return near, see `far_from_returns`.
    far: Tensor


def propagate_surfaces(measured: Measured) -> tuple[Surfaces, Tensor, Tensor]:
    """Propagate the measured depth to a grid of cells of CELL pixels.

    Height and width are multiples of ``planes.CELL * 2**planes.LEVELS``. The nearest surface is the
    maximum of inverse depth, smoothed over 3 x 3 cells, the farthest the maximum of depth.

    Returns:
        The surfaces; the base, 1..1/NEAREST, on cells of BASE_CELL pixels; and the number of
        measured pixels in a cell of CELL pixels, (N, 1, h, w).
    """
    depth, mask, inverse = measured
    extremes = cell_maxima(torch.cat([inverse, depth], dim=1), CELL)
    both, distance = extremes, torch.zeros_like(mask[:, :, ::CELL, ::CELL])
    for window in WINDOWS:
        unseen = 1.0 - both[:, :1].clamp(max=1.0)  # an inverse depth is at least 1
        distance = distance + unseen * (window // 2)
        both = torch.where(both > 0, both, maxima_around(both, window))
    near, farthest = both.split(1, dim=1)
    support = near.clamp(max=1.0)
    inverse_mean, known = means_around(torch.cat([near, support], dim=1), 3).split(1, dim=1)
    nearest = known.clamp(min=1e-6) / inverse_mean.clamp(min=1e-6)
    plane, base, count = fit_base(inverse, mask, extremes)
    base = base.clamp(1.0, 1.0 / NEAREST)
    seen = count.clamp(max=1.0)
    beside = maxima_around(seen, 3) + maxima_around(seen, 5)
    means = cell_means(torch.cat([base, 0.5 * beside, 4.0 * count], dim=1), CELL // BASE_CELL)
    coarse_base, beside, count = means.split(1, dim=1)
    surfaces = Surfaces(
        nearest.clamp(NEAREST, 1.0),
        farthest.clamp(NEAREST, 1.0),
        plane.clamp(1.0, 1.0 / NEAREST),
        coarse_base,
        support,
        plane.clamp(max=1.0),
        beside,
        far_from_returns(distance, support, count),
    )
    return surfaces, base, count


#: Distance to a return, in spacings of the returns, up to which nothing is far; all is from the
#: second on.
FAR = (2.0, 4.0)


def far_from_returns(distance: Tensor, support: Tensor, count: Tensor) -> Tensor:
    """0 between the returns, 1 where they end or a surface returns nothing, (N, 1, h, w).

    The spacing is that of as many returns spread evenly over where they reach. A scan of few lines
    has few returns: between its lines nothing is far that is far between many.

    Args:
        distance: to a return, at most, in cells; undefined without support.
        support: see `Surfaces`.
        count: of returns in a cell.
    """
    area, returns = (maps.sum(dim=(2, 3), keepdim=True) for maps in (support, count))
    spacings = distance * torch.rsqrt(area.clamp(min=1.0) / returns.clamp(min=1.0))
    start, end = FAR
    far = ramp(spacings, 1.0 / (end - start), -start / (end - start))
    return 1.0 - support * (1.0 - far)


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


def departures(surfaces: Surfaces) -> tuple[Tensor, Tensor]:
    """Return the log ratios of the nearest (-MOST_APART..0) and farthest surface to the base."""
    near = torch.log(surfaces.nearest * surfaces.base).clamp(-MOST_APART, 0.0)
    far = torch.log(surfaces.farthest * surfaces.base).clamp(0.0, MOST_APART)
    return near * surfaces.support, far * surfaces.support


def apart(log_ratio: Tensor) -> Tensor:
    """0 for one surface, the log ratio itself for two, see APART."""
    return log_ratio * ramp(log_ratio.abs(), 1.0 / APART, -1.0)


class Candidates(NamedTuple):
    """What the returns show, see `SurfaceDepthHead.propagate`."""

    measured: Measured
    surfaces: Surfaces
    #: Inverse of the normalised depth on cells of BASE_CELL pixels.
    base: Tensor
    #: (N, FEATURE_CHANNELS, h, w), on the grid of CELL.
    features: Tensor
    #: Greatest normalised depth of the guess from the image, (N, 1, h, w), see `limit_guess`.
    guess_limit: Tensor


class HeadChannels(NamedTuple):
    """What both branches of the head predict, each (N, C, h, w), before their activations."""

    #: Where to depart from the base: -1 to the nearest, 1 to the farthest surface, C = 1.
    position: Tensor
    #: Scale of the error where base and guess agree, C = 1.
    scale: Tensor
    #: Of the image: confidence in the base, against the guess, C = 1.
    in_base: Tensor
    #: Of the geometry: confidence in a return before the predicted depth, in one behind it, and the
    #: reduction of the error's scale beside a return, C = 3.
    returns: Tensor

    @classmethod
    def join(cls, image: Tensor, geometry: Tensor, beside: Tensor) -> Self:
        """Join both branches: beside returns position and scale are from the geometry.

        image: (N, IMAGE_CHANNELS, h, w); geometry: (N, GEOMETRY_CHANNELS, h, w).
        """
        both, in_base = image.split([2, 1], dim=1)
        near, returns = geometry.split([2, 3], dim=1)
        position, scale = torch.lerp(both, near, beside).split(1, dim=1)
        return cls(position, scale, in_base, returns)


#: Channels of the last convolution of each branch.
GEOMETRY_CHANNELS, IMAGE_CHANNELS = 5, 3
#: Confidence in the base, before its activation, that a new head starts with.
_FIRST_CONFIDENCE = 2.5
#: Class-like channels of the geometry's branch.
_CLASS_CHANNELS = 8


class SurfaceDepthHead(nn.Module):
    """Depth at the image's size, and the scale of its error, from candidates and features.

    Args:
        channels: of the decoders' features, at stride 4.
        at_4_channels: of the encoder's features at stride 4.
        geometry_channels: of the convolutions of the geometry's branch.
        semantics: whether there are features of the semantic decoder.
        max_depth_m: depth of 1.0.
        farthest_guess: the farthest normalised depth without a return.
    """

    def __init__(
        self,
        channels: int,
        at_4_channels: int,
        *,
        geometry_channels: int,
        semantics: bool,
        max_depth_m: float,
        farthest_guess: float,
    ) -> None:
        super().__init__()
        self.max_depth_m, self.farthest_guess = max_depth_m, farthest_guess
        self.embed = nn.Conv2d(FEATURE_CHANNELS, at_4_channels, 1)
        self.guess = nn.Conv2d(channels, 1, 1)
        self.project = nn.Conv2d(FEATURE_CHANNELS + 3, channels, 1)
        # Classes imply surfaces without returns: a car has a roof and windows. The geometry reads
        # class-like channels of its own: other classes leave the depth as it is.
        self.semantics = nn.Conv2d(channels, channels, 1) if semantics else None
        self.classes = nn.Conv2d(channels, _CLASS_CHANNELS, 1) if semantics else None
        self.compare = ConvBNReLU(channels, channels)
        self.image = nn.Conv2d(channels, IMAGE_CHANNELS, 1)
        read = 9 + (_CLASS_CHANNELS if semantics else 0)
        self.geometry = nn.Sequential(
            ConvBNReLU(read, geometry_channels),
            ConvBNReLU(geometry_channels, geometry_channels, dilation=2),
            ConvBNReLU(geometry_channels, geometry_channels),
            nn.Conv2d(geometry_channels, GEOMETRY_CHANNELS, 1),
        )

    @torch.no_grad()
    def start_as_base(self) -> None:
        """Set the head to the base and the guess beyond it, without classes or departures."""
        if self.semantics is not None:
            nn.init.zeros_(self.semantics.weight)
        # Positions within DEAD_ZONE, whose gradient reaches the layers before.
        last = self.geometry[-1]
        assert isinstance(last, nn.Conv2d)
        for weights in (last.weight[:1], self.image.weight):
            weights.mul_(0.01)
        assert self.image.bias is not None
        self.image.bias[-1] = _FIRST_CONFIDENCE

    def propagate(self, depth: Tensor, mask: Tensor) -> Candidates:
        """Return the candidates around each cell; depth and mask as `measure`."""
        measured = measure(depth, mask, max_depth_m=self.max_depth_m)
        surfaces, base, count = propagate_surfaces(measured)
        features = surface_features(surfaces, count)
        return Candidates(measured, surfaces, base, features, limit_guess(surfaces, count))

    def forward(
        self,
        candidates: Candidates,
        features: Tensor,
        semantics: Tensor | None,
        boundary_logits: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return the depth, its error's scale and the boundary's logits at the image's size.

        features, semantics: of the decoders, on the grid of CELL, as the boundary's logits, which
        are upsampled with the depth.
        """
        surfaces = candidates.surfaces
        guess = self.farthest_guess * torch.sigmoid(self.guess(features).float())
        guess = torch.minimum(guess, candidates.guess_limit)
        away = departures(surfaces)
        of_guess = torch.log(guess.clamp(min=NEAREST) * surfaces.base) * surfaces.reached
        ratios = torch.cat([candidates.features, *away, of_guess], dim=1)
        features = features + self.project(ratios)
        if self.semantics is not None:
            features = features + self.semantics(semantics)
        features = features + self.compare(features)
        boundary_logits = boundary_logits.float()
        geometry = self.geometry(self._geometry(candidates, away, semantics, boundary_logits))
        head = HeadChannels.join(self.image(features).float(), geometry.float(), surfaces.beside)
        depth, scale = choose_surface(head, guess, surfaces, away)
        inverse, scale, boundary_logits = to_image_size(
            depth, scale, boundary_logits, surfaces, candidates.base
        )
        # One value a cell is enough: the returns give the position of an edge.
        in_returns = torch.sigmoid(head.returns)
        in_returns = F.interpolate(in_returns, scale_factor=float(CELL), mode="nearest")
        returns = dilate_returns(candidates.measured)
        depth, scale = take_returns(
            inverse, scale, returns, in_returns, max_depth_m=self.max_depth_m
        )
        return depth, scale, boundary_logits

    def _geometry(
        self,
        candidates: Candidates,
        away: tuple[Tensor, Tensor],
        semantics: Tensor | None,
        boundary_logits: Tensor,
    ) -> Tensor:
        """What the geometry's branch reads: nothing that belongs to a rig."""
        surfaces, density = candidates.surfaces, candidates.features[:, -1:]
        ratios = torch.cat(away, dim=1)
        read = [
            ratios,
            apart(ratios) * 5.0,
            surfaces.support,
            surfaces.reached,
            surfaces.beside,
            density,
            torch.sigmoid(boundary_logits),
        ]
        if self.classes is not None:
            read.append(torch.sigmoid(self.classes(semantics)))
        return torch.cat(read, dim=1)


#: Of the sigmoid of a confidence, beyond 0 and 1.
STRETCH = 0.1
#: A position up to this is on the base; beyond, so much less.
DEAD_ZONE = 0.1
#: Least and greatest log of the ratio of the error's scale to the depth: 0.25 % to 2.7 times the
#: depth, so that neither the loss nor its gradient grows without bound. Not tuned.
LOG_SCALE = (-6.0, 1.0)
#: Share of the spread of the candidates, see `replace`, that is added to the error's scale.
SPREAD_SHARE = 0.5


def choose_surface(
    head: HeadChannels, guess: Tensor, surfaces: Surfaces, away: tuple[Tensor, Tensor]
) -> tuple[Tensor, Tensor]:
    """Depart from the base where surfaces differ, and replace it by the guess far from returns.

    away: see `departures`. Returns the normalised depth, (N, 1, h, w), NEAREST..1, and the scale of
    its error's Laplace distribution.
    """
    near, far = (apart(log_ratio) for log_ratio in away)
    place = position(head.position)
    departure = place.clamp(min=0.0) * far - place.clamp(max=0.0) * near
    measured = torch.exp(departure) / surfaces.base
    in_base = (1.0 - surfaces.far * (1.0 - confidence(head.in_base))) * surfaces.reached
    depth, spread = replace(guess, 0.0, measured - guess, in_base)
    depth = depth.clamp(NEAREST, 1.0)
    least, greatest = LOG_SCALE
    scale = torch.exp(least + (greatest - least) * torch.sigmoid(head.scale))
    return depth, depth.detach() * scale + SPREAD_SHARE * spread.detach()


def position(x: Tensor) -> Tensor:
    """Return x less DEAD_ZONE on both sides of 0, limited to -1..1; the gradient is x's."""
    limited = (x - x.clamp(-DEAD_ZONE, DEAD_ZONE)).clamp(-1.0, 1.0)
    if not torch.is_grad_enabled():
        return limited
    return x + (limited - x).detach()


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


#: Log ratio to the base up to which the depth of a cell takes the base's detail inside it; from
#: twice as much on it takes none.
ON_BASE = 0.05


def to_image_size(
    depth: Tensor, scale: Tensor, boundary_logits: Tensor, surfaces: Surfaces, base: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Upsample the choice; where it is the base, with the detail of the base inside a cell.

    Returns the inverse of the normalised depth, the scale and the boundary's logits.
    """
    on_base = ramp(torch.log(depth * surfaces.base).abs(), -1.0 / ON_BASE, 2.0) * surfaces.reached
    # One upsampling for all maps of a grid: ONNX Runtime splits a Resize by channels.
    maps = [1.0 / depth, scale, boundary_logits, surfaces.base, on_base]
    finer = upsample(torch.cat(maps, dim=1), factor=CELL // BASE_CELL)
    others, coarse_base, on_base = finer.split([3, 1, 1], dim=1)
    inverse, *others = others.split(1, dim=1)
    inverse = (inverse + on_base * (base - coarse_base)).clamp(1.0, 1.0 / NEAREST)
    full = upsample(torch.cat([inverse, *others], dim=1), factor=BASE_CELL)
    inverse, scale, boundary_logits = full.split(1, dim=1)
    return inverse, scale, boundary_logits


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
#: Largest share by which a return beside a pixel reduces the error's scale, which stays positive.
#: Not tuned.
MAX_SCALE_REDUCTION = 0.9


def take_returns(
    inverse: Tensor, scale: Tensor, returns: Returns, confidence: Tensor, *, max_depth_m: float
) -> tuple[Tensor, Tensor]:
    """Replace the predicted depth by the closest return, weighted by the confidence in it.

    At an edge the choice on a coarser grid is a ramp; a return is on one side of it. A LiDAR beside
    the camera sees past near edges, so returns before and behind the predicted depth have
    confidences of their own. Where the parallax between both depths is too small for that, a return
    is the depth of its pixel.

    inverse, scale (N, 1, H, W): the inverse depth, normalised by ``max_depth_m``, and its error's
    scale; confidence (N, 3, H, W): the sigmoids of `HeadChannels.returns`. Returns the depth, and
    the scale, reduced beside a return, with the spread of the two depths.
    """
    before, behind, reduction = confidence.split(1, dim=1)
    depth = 1.0 / inverse
    parallax = returns.inverse - inverse
    aligned = ramp(parallax.abs(), -1.0 / (max_depth_m * PARALLAX), 2.0)
    weight = torch.where(parallax > 0, before, behind) * returns.near
    weight = torch.maximum(weight, aligned * returns.here)
    depth, spread = replace(depth, 0.0, 1.0 / returns.inverse - depth, weight)
    scale = scale * ramp(reduction * returns.near, -MAX_SCALE_REDUCTION, 1.0)
    return depth, scale + SPREAD_SHARE * spread.detach()
