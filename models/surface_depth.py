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

In the order of execution: `surfaces.find_candidates`; after the decoders, of `models.depth_choice`,
`start_from_returns`, `choose_surface`, `blend_with_base` and, with `surfaces.dilate_returns`,
`blend_with_returns` and `reduce_scale`.
"""

from typing import NamedTuple, TypeVar

import torch
from torch import Tensor, nn

from models.blocks import ConvBNReLU, upsample, upsample_nearest
from models.decoders import AddUpBlock
from models.depth_choice import (
    HEAD_CHANNELS,
    BaseMaps,
    Choices,
    Chosen,
    HeadChannels,
    blend_with_base,
    blend_with_returns,
    choose_surface,
    limit_correction,
    log_offset,
    reduce_scale,
    relative_scale,
    soft_threshold,
    start_from_returns,
)
from models.planes import BASE_CELL, CELL
from models.surfaces import (
    FEATURE_CHANNELS,
    MAX_BASE_WEIGHT,
    Candidates,
    dilate_returns,
    zero_if_same_surface,
)

# `HeadChannels.surfaces` of a new head.
_FIRST_CONFIDENCES = (2.5, -4.0, -4.0)
# Class-like channels that the geometry's branch reads, and its other channels: 16 together, as
# ONNX Runtime computes convolutions in blocks of 8 or 16 channels.
_CLASS_CHANNELS, _RATIO_CHANNELS = 7, 9


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
        unmeasured_share: largest normalised depth without a return.
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
        unmeasured_share: float,
    ) -> None:
        super().__init__()
        self.max_depth_m, self.unmeasured_share = max_depth_m, unmeasured_share
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
        shows: Tensor | None = None,
    ) -> DepthMaps:
        """Return the depth, its error's scale and the boundary's logits at the image's size.

        Args:
            candidates: candidates of the frame.
            features: features of the depth decoder, on the grid of CELL.
            semantics: features of the semantic decoder, on the same grid.
            stride2: features of the encoder at stride 2.
            boundary_logits: on the grid of CELL; they are upsampled together with the depth.
            shows: see `picture_shows`; None: every picture is believed.
        """
        # The monocular depth, for where nothing is measured.
        monocular = self.unmeasured_share * torch.sigmoid(self.guess(features))
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
        believed: Tensor | float = 1.0 if shows is None else shows
        if shows is not None:
            monocular = start_from_returns(monocular, candidates.surfaces, shows)
            limit = limit * shows
        choices = Choices(*candidates.surfaces, monocular, limit)
        if self.training:
            # At random the weight is set to 0, kept, or doubled, so that neither choice learns to
            # compensate for the other.
            base_weight = base_weight * torch.randint(3, ()).to(base_weight)
        offset = log_offset(soft_threshold(position), offsets)
        base = BaseMaps(boundary_logits, offset, relative_scale(log_scale), base_weight)
        if self.refinement is None:
            head = HeadChannels.split(self.head(features).float())
            chosen = choose_surface(
                head, choices, unmeasured_share=self.unmeasured_share, shows=believed
            )
            chosen, base = _upsample_together(chosen, base)
        else:
            choices, base = _upsample_together(choices, base)
            refined = self.head(self.refinement(features, stride2))
            head = HeadChannels.split((refined + upsample(self.coarse_head(features))).float())
            chosen = choose_surface(
                head, choices, unmeasured_share=self.unmeasured_share, shows=believed
            )
        # Both on the grid of the base, then the returns at the image's size.
        chosen = blend_with_base(chosen, candidates.inverse_base, base)
        return self._add_returns(chosen, base.boundary_logits, head.returns, candidates)

    def _add_returns(
        self, chosen: Chosen, boundary_logits: Tensor, returns: Tensor, candidates: Candidates
    ) -> DepthMaps:
        """Upsample to the image's size and blend with the returns; see `HeadChannels.returns`.

        The scale is repeated, not upsampled, before the spread at the returns is added.
        """
        maps = upsample(torch.cat([chosen.inverse, boundary_logits], dim=1), factor=BASE_CELL)
        inverse, boundary_logits = maps.split(1, dim=1)
        # One value a cell is enough: the returns give the position of an edge.
        confidence = upsample_nearest(torch.sigmoid(returns), self.head_stride // BASE_CELL)
        before, behind, reduction = confidence.split(1, dim=1)
        depth, spread = blend_with_returns(
            inverse,
            dilate_returns(candidates.sparse_depth),
            upsample_nearest(before, BASE_CELL),
            upsample_nearest(behind, BASE_CELL),
            max_depth_m=self.max_depth_m,
        )
        scale = reduce_scale(chosen.scale, reduction, candidates.near_returns)
        return DepthMaps(depth, upsample_nearest(scale, BASE_CELL) + spread, boundary_logits)

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
