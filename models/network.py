"""The base of every network: its configuration, its inputs and its output at full size."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from types import MappingProxyType, UnionType
from typing import Any, NamedTuple, Self, get_args, get_origin, get_type_hints

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.blocks import upsample, upsample_nearest
from models.classes import CAMVID_CLASSES
from runtime.base.arguments import shown
from runtime.contract.contract import (
    MIN_SIDE,
    ClassInfo,
    check_classes,
    check_focal_length,
    check_max_depth,
    check_name,
    check_stride,
    farthest_return,
)

# Stride of the coarsest grid on which classes are decided. Scores of a coarser grid are upsampled
# to it, and each decision is repeated to full size. Deciding at full size takes a tenth more time.
CLASS_STRIDE = 2
# Limit of the channels of a layer, far beyond any network in use.
MAX_CHANNELS = 8192


class NetworkOutput(NamedTuple):
    """The output of a network; a head that the network lacks is None.

    Attributes:
        semantic_logits: (N, C, H, W) before the soft-max; scores of a coarser grid are repeated,
            see CLASS_STRIDE.
        depths: normalised depth 0..1, times `max_depth_m` gives metres: (N, 1, h_i, w_i), finest
            first. The finest has the image's size.
        boundary_logits: (N, 1, H, W), the logit of P_b.
        depth_uncertainty: (N, 1, H, W), normalised like the depth: the scale b of a Laplace
            distribution of its error. 63 % of the errors are below b, 86 % below 2 b.
        others: other heads of `runtime.contract.heads` by name, (N, 1, H, W): logits of a
            probability, or metres as a share of the range.
    """

    semantic_logits: Tensor | None = None
    depths: tuple[Tensor, ...] | None = None
    boundary_logits: Tensor | None = None
    depth_uncertainty: Tensor | None = None
    others: Mapping[str, Tensor] = MappingProxyType({})


@dataclass(frozen=True)
class NetworkConfig:
    """The settings of every network; a network with more of them adds fields in a subclass.

    Attributes:
        classes: semantic classes in the order of their ids; empty without a semantic head.
        max_depth_m: depth [m] of the normalised output 1.0; returns beyond it are clipped to it.
        canonical_focal_px: focal length [px] of the canonical camera (Yin et al. 2023, Metric3D):
            the input depth is multiplied by this / f and the output depth by f / this, where f is
            the focal length fx [px] of the image that the network gets. Both are done outside the
            network. None = plain metres.
        class_rows: number of rows of scores of each class, see `Network.join_rows`; () = one each.
        rgb_mean, rgb_std: mean and standard deviation of RGB in 0..255, part of the network
            (ImageNet's values).

    Raises:
        ValueError: if a value is outside its range.
    """

    name: str
    classes: tuple[ClassInfo, ...] = CAMVID_CLASSES
    max_depth_m: float = 100.0
    canonical_focal_px: float | None = None
    class_rows: tuple[int, ...] = ()
    rgb_mean: tuple[float, float, float] = (123.675, 116.28, 103.53)
    rgb_std: tuple[float, float, float] = (58.395, 57.12, 57.375)

    def __post_init__(self) -> None:
        """Check the values."""
        check_name(self.name, "name")
        check_classes(self.classes)
        check_max_depth(self.max_depth_m)
        if self.canonical_focal_px is not None:
            check_focal_length(self.canonical_focal_px, "canonical_focal_px")
        check_counts("class_rows", self.class_rows)
        if self.class_rows and len(self.class_rows) != len(self.classes):
            raise ValueError(
                f"class_rows must have one entry per class ({len(self.classes)}), "
                f"got {len(self.class_rows)}"
            )
        if not all(0 < value < float("inf") for value in self.rgb_std):
            raise ValueError(f"rgb_std must be positive, got {self.rgb_std}")

    @property
    def num_classes(self) -> int:
        """Number of semantic classes."""
        return len(self.classes)

    @property
    def num_scores(self) -> int:
        """Number of rows of scores that the semantic head computes, see `Network.join_rows`."""
        return sum(self.class_rows) or self.num_classes

    @property
    def unmeasured_range_m(self) -> float:
        """Largest depth [m] that can be predicted, and learned, without a return."""
        return self.max_depth_m

    def to_dict(self) -> dict[str, Any]:
        """Return the configuration as plain Python values."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Build a configuration from the values of `to_dict`.

        Raises:
            ValueError: for unknown keys, values of the wrong type or outside their range.
        """
        check_fields(cls, values, str(values.get("name", "")))
        hints = get_type_hints(cls)
        return cls(**{key: _checked(value, hints[key], key) for key, value in values.items()})


def check_fields(config: type[NetworkConfig], names: Iterable[object], network: str) -> None:
    """Raise ValueError for names that are not fields."""
    unknown = sorted({str(name) for name in names} - {field.name for field in fields(config)})
    if unknown:
        raise ValueError(
            f"not configuration fields of the network {shown(network)}: {', '.join(unknown)}"
        )


class Network(nn.Module):
    """Base of every network.

    A network implements `predict_coarse`, and names its heads and strides: as class attributes
    where they are fixed, else in its `__init__` before it calls `Network.__init__`. If it has
    classes, `semantic_head` is the last convolution, with a bias, which computes their
    `config.num_scores` scores: training initialises it again if the classes differ.

    Args:
        config: the settings that the network is built from.

    Attributes:
        heads: names of the network's heads, rows of `runtime.contract.heads`.
        stride: ratio of the image to the coarsest grid.
        semantic_stride: ratio of the image to the grid of the semantic logits.
        depth_stride: ratio of the image to the grid of the finest depth and its uncertainty.
        boundary_stride: ratio of the image to the grid of the boundary. That of another head is
            `<head>_stride`, 1 where there is no such attribute.
        depth_layers: layers that the depth alone reads, by the beginnings of their names; training
            them changes no other head. () = none: such a network cannot be adapted without labels.
        shared_depth_layers: those of these layers that other heads read, too.

    Raises:
        ValueError: if there are classes without a semantic head or the other way round.
    """

    heads: tuple[str, ...]
    stride: int
    semantic_stride: int = 1
    depth_stride: int = 1
    boundary_stride: int = 1
    depth_layers: tuple[str, ...] = ()
    shared_depth_layers: tuple[str, ...] = ()
    rgb_mean: Tensor
    rgb_std: Tensor

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        if ("semantic" in self.heads) != bool(config.classes):
            raise ValueError("classes must be given exactly when there is a semantic head")
        check_stride(self.stride)
        self.register_buffer("rgb_mean", torch.tensor(config.rgb_mean).view(1, 3, 1, 1))
        self.register_buffer("rgb_std", torch.tensor(config.rgb_std).view(1, 3, 1, 1))

    def head_stride(self, head: str) -> int:
        """Ratio of the image to the grid of a head."""
        measured = "depth" if head == "depth_uncertainty" else head
        return int(getattr(self, f"{measured}_stride", 1))

    def forward(
        self, rgb: Tensor, sparse_depth: Tensor, *, upsample_semantic: bool = True
    ) -> NetworkOutput:
        """Predict at full size.

        Args:
            rgb: float (N, 3, H, W), RGB in 0..255; H, W >= MIN_SIDE, odd sizes too.
            sparse_depth: float (N, 1, H, W), metres. A value that is 0, negative, NaN, Inf or
                beyond both 250 m and `config.max_depth_m` means no measurement; other returns
                beyond `config.max_depth_m` are clipped to it.
            upsample_semantic: False leaves the semantic logits on their own grid of
                ceil(H / s) x ceil(W / s), s = `semantic_stride`.

        Returns:
            Every head at (H, W); the coarser depths on their own grids.

        Raises:
            ValueError: for other shapes.
        """
        height, width = _check_shapes(rgb, sparse_depth)
        coarse = self.predict_coarse(rgb, sparse_depth)

        def full_size(x: Tensor, head: str) -> Tensor:
            return upsample(x, factor=self.head_stride(head))[:, :, :height, :width]

        logits, depths, boundary = coarse.semantic_logits, coarse.depths, coarse.boundary_logits
        scale, side = coarse.depth_uncertainty, self.semantic_stride
        if logits is not None and upsample_semantic:
            scores, side = to_class_grid(logits, side)
            logits = upsample_nearest(self.join_rows(scores), side)[:, :, :height, :width]
        elif logits is not None:
            logits = self.join_rows(logits)[:, :, : -(-height // side), : -(-width // side)]
        if depths is not None:
            depths = (full_size(depths[0], "depth"), *depths[1:])
        return NetworkOutput(
            logits,
            depths,
            None if boundary is None else full_size(boundary, "boundary"),
            None if scale is None else full_size(scale, "depth_uncertainty"),
            {head: full_size(values, head) for head, values in coarse.others.items()},
        )

    def predict_coarse(self, rgb: Tensor, sparse_depth: Tensor) -> NetworkOutput:
        """Predict on the heads' own grids.

        These are 1 / `semantic_stride` of the image for the semantics, 1 /
        `depth_stride` for the finest depth and its uncertainty and 1 /
        `boundary_stride` for the boundary. The inputs are those of `forward`. A network that pads
        the image at the bottom and right to a multiple of its stride returns grids that cover the
        padding, too.
        """
        raise NotImplementedError

    def join_rows(self, scores: Tensor) -> Tensor:
        """Join the rows of scores of each class: (N, `num_scores`, h, w) to (N, C, h, w).

        The score of a class is the maximum of its rows, so that its answer is that of a network
        whose classes are the rows, joined afterwards. In training it is their log-sum-exp, the
        score of their summed probability, which has a gradient to all of them.
        """
        rows = self.config.class_rows
        if not rows:
            return scores
        join = torch.logsumexp if self.training else torch.amax
        return torch.cat([join(part, 1, keepdim=True) for part in scores.split(rows, 1)], dim=1)

    def normalise_rgb(self, rgb: Tensor) -> Tensor:
        """Subtract the mean of RGB in 0..255 and divide by its standard deviation."""
        mean, std = self.rgb_mean.flatten(), self.rgb_std.flatten()
        return F.batch_norm(rgb, mean, std * std, eps=0.0)  # one operation

    def normalise_depth(self, sparse_depth: Tensor) -> tuple[Tensor, Tensor]:
        """Return the depth as a share 0..1 of the range, 0 = none, and the bool valid mask.

        All (N, 1, H, W). `sparse_depth` is in metres, see `forward`.
        """
        limit = self.config.max_depth_m
        valid_mask = (sparse_depth > 0) & (sparse_depth <= farthest_return(limit))  # false for NaN
        return torch.where(valid_mask, sparse_depth.clamp(max=limit), 0.0) / limit, valid_mask


def to_class_grid(logits: Tensor, stride: int) -> tuple[Tensor, int]:
    """Upsample the class scores to the grid on which classes are decided, and return its stride.

    logits: (N, C, h, w), on a grid of `stride`. See CLASS_STRIDE.
    """
    decided = min(stride, CLASS_STRIDE)
    return upsample(logits, factor=stride // decided), decided


def present_heads(*, semantic: bool, depth: bool) -> tuple[str, ...]:
    """Return the names of the heads; a boundary is always among them."""
    present = {"semantic": semantic, "depth": depth, "boundary": True}
    return tuple(head for head, there in present.items() if there)


def check_counts(
    what: str, counts: Iterable[int], least: int = 1, most: int = MAX_CHANNELS
) -> None:
    """Raise ValueError for a number of layers or channels that cannot be built."""
    for count in counts:
        if not least <= count <= most:
            raise ValueError(f"{what}: expected {least} to {most}, got {count}")


def initialise(module: nn.Module) -> None:
    """Set Xavier weights and zero biases, as the paper does; for `module.apply`."""
    if isinstance(module, nn.Conv2d):
        nn.init.xavier_uniform_(module.weight)
        if module.bias is not None:
            nn.init.zeros_(module.bias)


def _check_shapes(rgb: Tensor, sparse_depth: Tensor) -> tuple[int, int]:
    """Return (height, width); ValueError if a shape is wrong."""
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


def _checked(value: Any, hint: Any, key: str) -> Any:
    """Convert a plain value to the type of a field; ValueError if it does not fit."""
    kind, arguments = get_origin(hint) or hint, get_args(hint)
    if kind is UnionType:  # X | None
        return None if value is None else _checked(value, arguments[0], key)
    if kind is tuple and isinstance(value, list | tuple):
        wanted = arguments[:1] * len(value) if arguments[-1] is Ellipsis else arguments
        if len(wanted) == len(value):
            return tuple(
                _checked(item, each, f"{key}[{index}]")
                for index, (item, each) in enumerate(zip(value, wanted, strict=True))
            )
    if kind is ClassInfo and isinstance(value, Mapping) and value.keys() == {"name", "color"}:
        hints = get_type_hints(ClassInfo)
        return ClassInfo(
            **{k: _checked(value[k], hints[k], f"{key}.{k}") for k in ("name", "color")}
        )
    if kind is float and type(value) is int:
        return value
    if kind in (bool, int, float, str) and type(value) is kind:
        return value
    raise ValueError(f"{key} has the wrong type: {shown(value)}")
