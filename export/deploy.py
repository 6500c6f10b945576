"""The deploy graph: from raw sensor units to answers at full size."""

import torch
from torch import Tensor, nn

from models import Network
from models.answers import class_ids, head_maps, thinning, to_unit
from models.blocks import upsample, upsample_nearest
from models.network import CLASS_STRIDE, to_class_grid
from runtime.contract.heads import HEADS, Unit


class DeployGraph(nn.Module):
    """A network with the inputs and outputs of the contract.

    Args:
        model: the network.
        with_logits: add the class scores to the outputs, if the network has any.
    """

    def __init__(self, model: Network, *, with_logits: bool = False) -> None:
        super().__init__()
        self.model = model
        self.with_logits = with_logits

    @property
    def heads(self) -> tuple[str, ...]:
        """Names of the outputs, in the order in which `forward` returns them."""
        heads: tuple[str, ...] = self.model.heads
        if self.with_logits and "semantic" in heads:
            heads = (*heads, "semantic_logits")
        return heads

    def forward(self, rgb: Tensor, sparse_depth: Tensor) -> tuple[Tensor, ...]:
        """Predict one answer for each of `heads`, at the size of the inputs.

        Args:
            rgb: uint8 (N, H, W, 3), RGB.
            sparse_depth: float32 (N, H, W), metres; the network masks values that are invalid.

        Returns:
            (N, H, W) of the dtype and unit of the head, see `runtime.contract.heads`; class scores
            (N, C, H, W).
        """
        max_depth_m = self.model.config.max_depth_m
        for axis in (1, 2):  # the traced graph computes the padding of both inputs once
            torch._check(sparse_depth.shape[axis] == rgb.shape[axis])
        # Contiguous: the tracer takes a fifth longer for strides of free sides that are permuted.
        image = rgb.to(torch.float32).permute(0, 3, 1, 2).contiguous()
        coarse = self.model.predict_coarse(image, sparse_depth.unsqueeze(1))
        answers = {}
        maps = head_maps(coarse)
        if "semantic" in maps:
            scores, stride = to_class_grid(maps.pop("semantic"), self.model.semantic_stride)
            scores = self.model.join_rows(scores)
            # Repeat and crop class ids (1 byte), not scores (4 bytes a class).
            ids = class_ids(scores)[:, None]
            answers["semantic"] = _crop(upsample_nearest(ids, stride).squeeze(1), rgb)
            step = CLASS_STRIDE // stride
            factors = thinning(_crop(ids[..., ::step, ::step], rgb, CLASS_STRIDE))
            factors = _crop(upsample_nearest(factors, CLASS_STRIDE).squeeze(1), rgb)
            if self.with_logits:
                answers["semantic_logits"] = _crop(upsample_nearest(scores, stride), rgb)

        grids: dict[int, dict[str, Tensor]] = {}
        for head, values in maps.items():
            if HEADS[head].unit is Unit.METRES:  # the product commutes with the upsampling
                values = to_unit(head, values, max_depth_m)
            grids.setdefault(self.model.head_stride(head), {})[head] = values
        for stride, group in grids.items():
            # Upsample all heads as one tensor: ONNX Runtime parallelises Resize over channels, and
            # two tensors of one channel take four times as long.
            if stride > 1:
                full = upsample(torch.cat(list(group.values()), dim=1), factor=stride)
                group = dict(zip(group, full.split(1, dim=1), strict=True))
            answers |= {head: _crop(full.squeeze(1), rgb) for head, full in group.items()}
        for head in maps:
            if HEADS[head].unit is not Unit.METRES:
                answers[head] = to_unit(head, answers[head], max_depth_m)
        if {"boundary", "semantic"} <= answers.keys():
            answers["boundary"] = answers["boundary"] * _crop(factors, rgb)
        return tuple(answers[head] for head in self.heads)


def _crop(x: Tensor, rgb: Tensor, stride: int = 1) -> Tensor:
    """Crop the last two axes, on a grid of `stride`, to the size of the image (N, H, W, 3).

    With a free size the graph has few operations for it; with a fixed size it has none if there is
    nothing to crop.
    """
    size = [-(-side // stride) for side in rgb.shape[1:3]]
    if all(isinstance(side, int) for side in size):
        return x[..., : size[0], : size[1]]
    ends = torch.onnx.ops.symbolic(
        "Shape", [rgb], {"start": 1, "end": 3}, dtype=torch.int64, shape=[2]
    )
    ends = (ends + stride - 1) // stride if stride > 1 else ends
    starts, axes = torch.tensor([0, 0]), torch.tensor([x.ndim - 2, x.ndim - 1])
    return torch.onnx.ops.symbolic(
        "Slice", [x, starts, ends, axes], dtype=x.dtype, shape=[*x.shape[:-2], *size]
    )
