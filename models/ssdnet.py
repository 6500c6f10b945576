"""SSDNet: semantics, depth and boundaries from one image and one sparse depth map.

Paper: "Simultaneous Semantic Segmentation and Depth Completion with Constraint of Boundary",
Sensors 2020. One encoder, a boundary decoder and two task decoders of boundary-aware convolutions.
"""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from models.blocks import ConvBNReLU, pad_to_multiple, upsample
from models.boundary_decoder import BoundaryDecoder
from models.config import ModelConfig
from models.depth_prior import DepthPrior, pull_push_fill
from models.encoder import build_encoder
from models.task_decoder import TaskDecoder, UpBlock
from runtime.contract import MIN_SIDE


class SSDNetOutput(NamedTuple):
    """What the network says. A head that the network lacks is None."""

    #: (N, C, H, W) before the soft-max.
    semantic_logits: Tensor | None
    #: Normalised depth 0..1, times `max_depth_m` gives metres: (N, 1, h_i, w_i), finest first.
    #: The finest has the image's size.
    depths: tuple[Tensor, ...] | None
    #: (N, 1, H, W), the logit of P_b.
    boundary_logits: Tensor
    #: Logits of B_i, (N, 1, h_i, w_i), finest first.
    side_boundary_logits: tuple[Tensor, ...]


class SSDNet(nn.Module):
    """Every member of the family, built from its configuration."""

    rgb_mean: Tensor
    rgb_std: Tensor

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        self.register_buffer("rgb_mean", torch.tensor(config.rgb_mean).view(1, 3, 1, 1))
        self.register_buffer("rgb_std", torch.tensor(config.rgb_std).view(1, 3, 1, 1))

        width = 3 * config.use_rgb + config.use_sparse_depth * (1 + config.valid_mask_input)
        stem: list[nn.Module] = []
        for channels in config.stem_channels:
            stem.append(ConvBNReLU(width, channels, stride=2))
            width = channels
        self.stem = nn.Sequential(*stem)
        self.prior_stem = (
            nn.Conv2d(len(DepthPrior._fields), width, 1) if config.depth_prior else None
        )
        self.encoder = build_encoder(config, width)
        skips, bottom = self.encoder.skip_channels, self.encoder.bottom_channels
        self.boundary_decoder = BoundaryDecoder(skips, config.boundary_channels)

        finest = config.decoder_channels[-1]
        self.semantic_decoder = self.semantic_refine = self.semantic_head = None
        if config.semantic_head:
            self.semantic_decoder = TaskDecoder(config, skips, bottom)
            width = finest
            if config.semantic_refine_channels:
                width = config.semantic_refine_channels
                self.semantic_refine = UpBlock(
                    finest, config.stem_channels[0], width, config.skip_fusion
                )
            self.semantic_head = nn.Conv2d(width, config.num_classes, 1)
        self.depth_decoder = self.depth_heads = None
        if config.depth_head:
            self.depth_decoder = TaskDecoder(config, skips, bottom)
            self.depth_heads = nn.ModuleList(
                # With a prior the finest head says a correction and how far to trust the prior.
                nn.Conv2d(channels, 2 if config.depth_prior and scale == 0 else 1, 1)
                for scale, channels in enumerate(reversed(config.decoder_channels))
            )
        self.apply(_initialise)

    def forward(self, rgb: Tensor, sparse_depth: Tensor) -> SSDNetOutput:
        """Predict at full size.

        rgb: float (N, 3, H, W), RGB in 0..255. sparse_depth: float (N, 1, H, W), metres; 0,
        negative, NaN, Inf or beyond ``config.max_depth_m`` = no measurement. H, W >= MIN_SIDE, odd
        sizes too. Raises ValueError on other shapes.
        """
        height, width = _check_shapes(rgb, sparse_depth)
        coarse = self.predict_coarse(rgb, sparse_depth)

        def full_size(x: Tensor, stride: int = self.config.output_stride) -> Tensor:
            return upsample(x, factor=stride)[:, :, :height, :width]

        return SSDNetOutput(
            semantic_logits=(
                None
                if coarse.semantic_logits is None
                else full_size(coarse.semantic_logits, self.config.semantic_stride)
            ),
            depths=(
                None if coarse.depths is None else (full_size(coarse.depths[0]), *coarse.depths[1:])
            ),
            boundary_logits=full_size(coarse.boundary_logits),
            side_boundary_logits=coarse.side_boundary_logits,
        )

    def predict_coarse(self, rgb: Tensor, sparse_depth: Tensor) -> SSDNetOutput:
        """Predict on the heads' own grids: 1 / ``config.output_stride`` of the image.

        Semantics are on 1 / ``config.semantic_stride``, finer where they are refined.
        Inputs as `forward`. A network with a strided stem pads the image at the bottom and right
        to a multiple of its stride, so its grids cover the padding too; the others do not pad.
        """
        config = self.config
        exact = bool(config.stem_channels)
        valid_mask = (sparse_depth > 0) & (sparse_depth <= config.max_depth_m)  # False for NaN
        depth = torch.where(valid_mask, sparse_depth, 0.0) / config.max_depth_m
        inputs = []
        if config.use_rgb:
            inputs.append((rgb - self.rgb_mean) / self.rgb_std)
        if config.use_sparse_depth:
            inputs.append(depth * config.sparse_depth_gain)
            if config.valid_mask_input:
                inputs.append(valid_mask.to(depth.dtype))
        x = torch.cat(inputs, dim=1)
        if exact:
            x = pad_to_multiple(x, config.stride)
        prior = None
        stem_features = [x]
        for layer in self.stem:
            stem_features.append(layer(stem_features[-1]))
        x_stem = stem_features[-1]
        if self.prior_stem is not None:
            prior = pull_push_fill(
                x[:, -2:],  # depth and mask, padded
                factor=config.output_stride,
                levels=config.num_skips,
            )
            x_stem = x_stem + self.prior_stem(torch.cat(prior, dim=1))

        skips, bottom = self.encoder(x_stem)
        boundary_logits, sides = self.boundary_decoder(skips, exact=exact)
        boundaries: list[Tensor] | list[None] = [None] * len(sides)
        if config.boundary_gating:
            boundaries = [torch.sigmoid(side) for side in sides]

        semantic_logits = None
        if self.semantic_decoder is not None and self.semantic_head is not None:
            finest = self.semantic_decoder(bottom, skips, boundaries, exact=exact)[0]
            if self.semantic_refine is not None:
                gate = None if boundaries[0] is None else upsample(boundaries[0])
                finest = self.semantic_refine(finest, stem_features[1], gate, exact=exact)
            semantic_logits = self.semantic_head(finest)
        depths = None
        if self.depth_decoder is not None and self.depth_heads is not None:
            features = self.depth_decoder(bottom, skips, boundaries, exact=exact)
            logits = [
                head(feature) for head, feature in zip(self.depth_heads, features, strict=True)
            ]
            if prior is not None:
                logits[0] = _refine(logits[0], prior)
            depths = tuple(torch.sigmoid(logit) for logit in logits)
        return SSDNetOutput(semantic_logits, depths, boundary_logits, tuple(sides))


def _refine(head: Tensor, prior: DepthPrior) -> Tensor:
    """Logit of the depth: a correction plus the prior's logit as far as it is trusted.

    Where nothing supports the prior its share is 0 and the correction alone is the answer.
    """
    correction, trust = head[:, :1], head[:, 1:]
    filled = prior.filled.clamp(1e-3, 1.0 - 1e-3)
    prior_logit = torch.log(filled / (1.0 - filled))
    return correction + torch.sigmoid(trust) * prior.support * prior_logit


def _check_shapes(rgb: Tensor, sparse_depth: Tensor) -> tuple[int, int]:
    """Return (height, width), or raise a ValueError that says what was expected."""
    if rgb.ndim != 4 or rgb.shape[1] != 3:
        raise ValueError(f"rgb must be (N, 3, H, W), got {tuple(rgb.shape)}")
    batch, _, height, width = rgb.shape
    if sparse_depth.shape != (batch, 1, height, width):
        raise ValueError(
            f"sparse_depth must be {(batch, 1, height, width)} to match rgb, "
            f"got {tuple(sparse_depth.shape)}"
        )
    if height < MIN_SIDE or width < MIN_SIDE:
        raise ValueError(f"height and width must be at least {MIN_SIDE}, got {height}x{width}")
    return height, width


def _initialise(module: nn.Module) -> None:
    """Xavier weights and zero biases, as the paper's experiments."""
    if isinstance(module, nn.Conv2d):
        nn.init.xavier_uniform_(module.weight)
        if module.bias is not None:
            nn.init.zeros_(module.bias)
