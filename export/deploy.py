"""The deploy graph: raw sensor units in, answers at full size out."""

import torch
from torch import Tensor, nn

from models import Network
from models.blocks import upsample
from runtime.contract import NO_CLASS


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
        config = self.model.config
        height, width = rgb.shape[1], rgb.shape[2]
        coarse = self.model.predict_coarse(
            rgb.permute(0, 3, 1, 2).to(torch.float32), sparse_depth.unsqueeze(1)
        )
        answers = {}
        if coarse.semantic_logits is not None:
            logits = upsample(coarse.semantic_logits, factor=self.model.semantic_stride)
            # Cropped last: an id is a byte, its scores are 4 bytes a class.
            answers["semantic"] = _best_class(logits)[:, :height, :width]
            answers["semantic_logits"] = logits[:, :, :height, :width]

        grids: dict[int, dict[str, Tensor]] = {}
        if coarse.boundary_logits is not None:
            grids.setdefault(self.model.boundary_stride, {})["boundary"] = coarse.boundary_logits
        if coarse.depths is not None:
            metres = coarse.depths[0] * config.max_depth_m
            grids.setdefault(self.model.depth_stride, {})["depth"] = metres
        if coarse.depth_uncertainty is not None:
            metres = coarse.depth_uncertainty * config.max_depth_m
            grids.setdefault(self.model.depth_stride, {})["depth_uncertainty"] = metres
        for stride, maps in grids.items():
            # One tensor for both: ONNX Runtime splits the work of a Resize by channels, so two of
            # one channel each take four times as long.
            if stride > 1:
                full = upsample(torch.cat(list(maps.values()), dim=1), factor=stride)
                maps = dict(zip(maps, full.split(1, dim=1), strict=True))
            answers |= {head: full[:, 0, :height, :width] for head, full in maps.items()}
        if "boundary" in answers:
            answers["boundary"] = torch.sigmoid(answers["boundary"])
        return tuple(answers[head] for head in self.heads)


def _best_class(logits: Tensor) -> Tensor:
    """Class ids uint8 (N, H, W) of (N, C, H, W); NO_CLASS where a score is NaN or Inf.

    An arg-max says nothing about NaN, and whoever runs the file shall see it. The reshape keeps the
    classes innermost: without it ONNX Runtime moves the transposition behind the ArgMax, which
    then strides through memory and takes twice as long.
    """
    batch, classes, height, width = logits.shape
    scores = logits.permute(0, 2, 3, 1).reshape(-1, classes)
    finite = scores.sum(dim=1) * 0 == 0  # NaN and Inf reach the sum, and times 0 both are NaN
    ids = scores.argmax(dim=1).to(torch.uint8)
    ids = torch.where(finite, ids, torch.tensor(NO_CLASS, dtype=torch.uint8))
    return ids.reshape(batch, height, width)
