"""The depth head of `SSDNetLite`: chooses among measured surfaces, see `models.surfaces`."""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.blocks import upsample
from models.surfaces import (
    COARSE_CELL,
    FEATURE_CHANNELS,
    FINE_CELL,
    HEAD_CHANNELS,
    HeadChannels,
    Measured,
    Surfaces,
    choose_surface,
    dilate_returns,
    measure,
    propagate_surfaces,
    refine_surfaces,
    surface_features,
    take_returns,
)
from models.task_decoder import refinement


class Candidates(NamedTuple):
    """What the returns show: `SurfaceDepthHead.propagate`."""

    measured: Measured
    surfaces: Surfaces
    #: (N, FEATURE_CHANNELS, h, w), on the grid of COARSE_CELL.
    features: Tensor


class SurfaceDepthHead(nn.Module):
    """Depth at the image's size, and the scale of its error, from candidates and features.

    Args:
        channels: of the depth decoder's finest features, and of the semantic decoder's.
        at_2_channels, at_4_channels: of the encoder's features at strides 2 and 4.
        refine_channels: of one more UpBlock, so that the choice is made at stride 2; 0 = none, at
            stride 4.
        use_semantics: whether there are features of a semantic decoder.
        levels: halvings from COARSE_CELL to the coarsest grid.
        max_depth_m: of the network's configuration.
        reach: the largest depth without a return, as a share of ``max_depth_m``.
    """

    def __init__(
        self,
        channels: int,
        *,
        at_2_channels: int,
        at_4_channels: int,
        refine_channels: int,
        use_semantics: bool,
        levels: int,
        max_depth_m: float,
        reach: float,
    ) -> None:
        super().__init__()
        self.levels, self.max_depth_m, self.reach = levels, max_depth_m, reach
        self.embed = nn.Conv2d(FEATURE_CHANNELS, at_4_channels, 1)
        self.project = nn.Conv2d(FEATURE_CHANNELS, channels, 1)
        # Classes imply surfaces without returns: a car has a roof and windows.
        self.semantics = nn.Conv2d(channels, channels, 1) if use_semantics else None
        self.refinement = refinement(channels, at_2_channels, refine_channels)
        self.cell = FINE_CELL if refine_channels else COARSE_CELL
        self.head = nn.Conv2d(refine_channels or channels, HEAD_CHANNELS, 1)

    def ignore_semantics(self) -> None:
        """Zero the layer of the semantics: weights trained without it give the same depth."""
        if self.semantics is not None:
            nn.init.zeros_(self.semantics.weight)

    def propagate(self, depth: Tensor, mask: Tensor) -> Candidates:
        """Return the candidates around each cell; depth and mask as `measure`."""
        measured = measure(depth, mask, max_depth_m=self.max_depth_m)
        surfaces, density = propagate_surfaces(measured, levels=self.levels)
        return Candidates(measured, surfaces, surface_features(surfaces, density))

    def forward(
        self,
        candidates: Candidates,
        features: Tensor,
        semantics: Tensor | None,
        at_2: Tensor,
        regressed: Tensor,
        boundary_logits: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return the depth, its error's scale and the boundary's logits at the image's size.

        features, semantics: of the decoders, on the grid of COARSE_CELL, as the regressed depth and
        the boundary's logits, which are upsampled with the depth; at_2: of the encoder.
        """
        features = features + self.project(candidates.features)
        if self.semantics is not None:
            features = features + self.semantics(semantics)
        head = HeadChannels.split(self.head(self.refinement(features, at_2)).float())
        regressed, boundary_logits = regressed.float(), boundary_logits.float()
        surfaces = candidates.surfaces
        if self.cell == FINE_CELL:
            # One upsampling for all maps of a grid: ONNX Runtime splits a Resize by channels.
            maps = torch.cat([*surfaces, regressed, boundary_logits], dim=1)
            *fine, regressed, boundary_logits = upsample(maps).split(1, dim=1)
            surfaces = refine_surfaces(Surfaces(*fine), candidates.measured)
        depth, scale = choose_surface(head, regressed, surfaces, reach=self.reach)
        maps = upsample(torch.cat([depth, scale, boundary_logits], dim=1), factor=self.cell)
        depth, scale, boundary_logits = maps.split(1, dim=1)
        # One value a cell is enough: the returns give the position of an edge.
        confidence = torch.sigmoid(head.returns)
        confidence = F.interpolate(confidence, scale_factor=float(self.cell), mode="nearest")
        returns = dilate_returns(candidates.measured)
        depth, scale = take_returns(depth, scale, returns, confidence, max_depth_m=self.max_depth_m)
        return depth, scale, boundary_logits
