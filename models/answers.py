"""What the output of a network means: class ids, metres, probabilities."""

import torch
from torch import Tensor
from torch.nn import functional as F

from models.blocks import repeat
from models.network import CLASS_STRIDE, NetworkOutput
from runtime.contract import NO_CLASS
from runtime.heads import HEADS, Unit


def answers(output: NetworkOutput, max_depth_m: float) -> dict[str, Tensor]:
    """Return the answers of a network at full size.

    Args:
        output: of `Network.forward`.
        max_depth_m: of the network's configuration.

    Returns:
        Head -> (N, H, W) in the unit of the head, see `runtime.heads`; the class scores as
        "semantic_logits" (N, C, H, W).
    """
    found = {}
    for head, values in head_maps(output).items():
        converted = to_unit(head, values, max_depth_m)
        found[head] = converted if converted.ndim == 3 else converted[:, 0]
    if output.semantic_logits is not None:
        found["semantic_logits"] = output.semantic_logits
    return with_thin_boundary(found)


def head_maps(output: NetworkOutput) -> dict[str, Tensor]:
    """Head -> what the network gives for it, (N, C, h, w) with C = 1 but for the classes."""
    maps = {
        "semantic": output.semantic_logits,
        "boundary": output.boundary_logits,
        "depth": None if output.depths is None else output.depths[0],
        "depth_uncertainty": output.depth_uncertainty,
        **output.others,
    }
    return {head: values for head, values in maps.items() if values is not None}


def to_unit(head: str, values: Tensor, max_depth_m: float) -> Tensor:
    """Convert a head's map to its unit.

    A share of the range becomes metres, a logit a probability, class scores (N, C, H, W) become
    class ids uint8 (N, H, W).
    """
    unit = HEADS[head].unit
    if unit is Unit.METRES:
        return values * max_depth_m
    if unit is Unit.PROBABILITY:
        return torch.sigmoid(values)
    return class_ids(values) if unit is Unit.CLASS_ID else values


def class_ids(scores: Tensor) -> Tensor:
    """Class ids of scores (N, C, h, w), uint8 (N, h, w).

    NO_CLASS where a score is NaN or Inf, which an arg-max hides.
    """
    # NaN and Inf reach the sum; times 0 both are NaN.
    unknown = torch.isnan(scores.sum(dim=1) * 0.0)
    ids = scores.argmax(dim=1).to(torch.uint8)
    # Not a maximum: ONNX Runtime has none of bytes on CUDA.
    no_class = torch.tensor(NO_CLASS, dtype=torch.uint8)
    return torch.where(unknown, no_class, ids)


def with_thin_boundary(found: dict[str, Tensor]) -> dict[str, Tensor]:
    """Halve the probability of a boundary where the classes do not change; `answers` to `answers`.

    The boundary decoder works at a quarter of the image's size, so its lines are wide; those of the
    classes are finer. They change at a pixel of every second row and column if the 3 x 3 of these
    around it have two; the others are as the pixel above and to the left.
    """
    if not {"boundary", "semantic"} <= found.keys():
        return found
    ids = found["semantic"][:, None, ::CLASS_STRIDE, ::CLASS_STRIDE].to(torch.float32)
    # The greatest id around a pixel, and minus the least one.
    signs = ids.new_tensor([1.0, -1.0]).view(1, 2, 1, 1)
    differences = F.max_pool2d(ids * signs, 3, 1, 1).sum(dim=1, keepdim=True).clamp(0.5, 1.0)
    height, width = found["boundary"].shape[-2:]
    differences = repeat(differences, CLASS_STRIDE)[:, 0, :height, :width]
    return found | {"boundary": found["boundary"] * differences}
