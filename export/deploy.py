"""The deploy graph: raw sensor units in, answers at full size out."""

import torch
from torch import Tensor, nn

from models import Network
from models.answers import head_maps, to_unit
from models.blocks import upsample
from runtime.heads import HEADS, Unit


class DeployGraph(nn.Module):
    """A network between the sensors' units and the answers of the contract.

    ``with_logits`` adds the class scores to the outputs, if the network has any.
    """

    def __init__(self, model: Network, *, with_logits: bool = False) -> None:
        super().__init__()
        self.model = model
        self.with_logits = with_logits

    @property
    def heads(self) -> tuple[str, ...]:
        """Names of the outputs, in the order in which `forward` gives them."""
        heads: tuple[str, ...] = self.model.heads
        if self.with_logits and "semantic" in heads:
            heads = (*heads, "semantic_logits")
        return heads

    def forward(self, rgb: Tensor, sparse_depth: Tensor) -> tuple[Tensor, ...]:
        """Predict one answer a head, at the size of the inputs.

        rgb: uint8 (N, H, W, 3), red first. sparse_depth: float32 (N, H, W), metres; what is no
        measurement is masked by the network. Returns, as far as the network has the head:
        semantic uint8 (N, H, W), NO_CLASS where its scores are not finite, depth float32 (N, H, W)
        in metres, boundary float32 (N, H, W) in 0..1, depth_uncertainty float32 (N, H, W) in
        metres, semantic_logits float32 (N, C, H, W).
        """
        max_depth_m = self.model.config.max_depth_m
        height, width = rgb.shape[1], rgb.shape[2]
        coarse = self.model.predict_coarse(
            rgb.permute(0, 3, 1, 2).to(torch.float32), sparse_depth.unsqueeze(1)
        )
        answers = {}
        maps = head_maps(coarse)
        if "semantic" in maps:
            scores = upsample(maps.pop("semantic"), factor=self.model.semantic_stride)
            # Cropped last: an id is a byte, its scores are 4 bytes a class.
            answers["semantic"] = to_unit("semantic", scores, max_depth_m)[:, :height, :width]
            answers["semantic_logits"] = scores[:, :, :height, :width]

        grids: dict[int, dict[str, Tensor]] = {}
        for head, values in maps.items():
            if HEADS[head].unit is Unit.METRES:  # the product commutes with the upsampling
                values = to_unit(head, values, max_depth_m)
            grids.setdefault(self.model.head_stride(head), {})[head] = values
        for stride, group in grids.items():
            # One tensor for all: ONNX Runtime splits the work of a Resize by channels, so two of
            # one channel each take four times as long.
            if stride > 1:
                full = upsample(torch.cat(list(group.values()), dim=1), factor=stride)
                group = dict(zip(group, full.split(1, dim=1), strict=True))
            answers |= {head: full[:, 0, :height, :width] for head, full in group.items()}
        for head in maps:
            if HEADS[head].unit is not Unit.METRES:
                answers[head] = to_unit(head, answers[head], max_depth_m)
        return tuple(answers[head] for head in self.heads)
