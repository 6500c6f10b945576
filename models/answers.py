"""What the output of a network means: class ids, metres, probabilities."""

import torch
from torch import Tensor
from torch.nn import functional as F

from models.blocks import upsample_nearest
from models.network import CLASS_STRIDE, Network, NetworkOutput
from runtime.contract.contract import NO_CLASS
from runtime.contract.heads import HEADS, Unit


def answers(output: NetworkOutput, max_depth_m: float) -> dict[str, Tensor]:
    """Return the answers of a network at full size.

    Args:
        output: what `Network.forward` returned.
        max_depth_m: `max_depth_m` of the network's configuration.

    Returns:
        Head -> (N, H, W) in the unit of the head, see `runtime.contract.heads`; the class scores as
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
    """Return head -> its map, (N, C, h, w); C is the number of classes, or 1 for other heads."""
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
    """Return the class ids of scores (N, C, h, w): uint8 (N, h, w).

    A pixel with a score of NaN or Inf gets NO_CLASS; an arg-max would return a class there.
    """
    pixels = scores.flatten(2)
    # NaN and Inf propagate into the sum; both become NaN when multiplied by 0. In ONNX Runtime a
    # product with ones takes a ninth of the time of a sum.
    total = pixels.new_ones(1, pixels.shape[1]) @ pixels
    unknown = torch.isnan(total[:, 0] * 0.0)
    ids = pixels.argmax(dim=1).to(torch.uint8)
    # Not a maximum: ONNX Runtime has no maximum of bytes on CUDA.
    no_class = torch.tensor(NO_CLASS, dtype=torch.uint8)
    return torch.where(unknown, no_class, ids).view(-1, *scores.shape[2:])


def with_thin_boundary(found: dict[str, Tensor]) -> dict[str, Tensor]:
    """Thin the boundary of answers with classes, see `thinning`; `answers` to `answers`."""
    if not {"boundary", "semantic"} <= found.keys():
        return found
    factors = thinning(found["semantic"][:, None, ::CLASS_STRIDE, ::CLASS_STRIDE])
    height, width = found["boundary"].shape[-2:]
    factors = upsample_nearest(factors, CLASS_STRIDE)[:, 0, :height, :width]
    return found | {"boundary": found["boundary"] * factors}


def thinning(ids: Tensor) -> Tensor:
    """Return the factors, (N, 1, h, w), that halve a boundary where the classes do not change.

    The boundary decoder works at a quarter of the image's size, so its lines are wide; the borders
    of classes are finer. The classes change at a pixel if the 3 x 3 pixels around it have more than
    one class. The factors are repeated to full size.

    ids: class ids of every second row and column, (N, 1, h, w).
    """
    values = ids.to(torch.float32)
    greatest, negated_least = (F.max_pool2d(each, 3, 1, 1) for each in (values, -values))
    return (greatest + negated_least).clamp(0.5, 1.0)


# Size of the image of `check_output`: odd sides, which no stride divides.
_PROBED = (37, 53)


def check_output(network: Network) -> None:
    """Check what a network returns against what it declares, on one small image of odd sides.

    Raises:
        ValueError: if the network fails on it, lacks a head of `Network.heads` or the layer
            `semantic_head`, or returns other heads, numbers of channels or grids, NaN or Inf, or
            a depth outside 0..1.
    """
    training = network.training
    noise = torch.rand(1, 4, *_PROBED, generator=torch.Generator().manual_seed(0))
    sparse_depth = 50.0 * (noise[:, 3:] - 0.5)  # half of the pixels have no return
    try:
        with torch.no_grad():
            output = network.eval().predict_coarse(255.0 * noise[:, :3], sparse_depth)
    except RuntimeError as error:
        raise ValueError(
            f"predict_coarse fails on an image of {_PROBED[0]}x{_PROBED[1]} ({error}): pad the "
            "image at the bottom and right to a multiple of the stride with models.blocks."
            "pad_to_multiple"
        ) from error
    finally:
        network.train(training)
    if not isinstance(output, NetworkOutput) or not isinstance(output.depths, tuple | None):
        raise ValueError(
            "predict_coarse returned another type: return a NetworkOutput, whose depths are a "
            "tuple, the finest first"
        )
    maps = head_maps(output)
    if found := set(maps).symmetric_difference(network.heads):
        raise ValueError(
            f"heads = {network.heads}, but predict_coarse returned {tuple(maps)}: "
            f"{', '.join(sorted(found))} must be in both or in none"
        )
    for head, values in maps.items():
        _check_map(network, head, values)
    if "semantic" in maps:
        last = getattr(network, "semantic_head", None)
        if not isinstance(getattr(last, "bias", None), Tensor):
            raise ValueError(
                "the network lacks semantic_head with a bias: give the last convolution of the "
                "classes that name, and a bias"
            )


def _check_map(network: Network, head: str, values: Tensor) -> None:
    channels = network.config.num_scores if head == "semantic" else 1
    stride = network.head_stride(head)
    least = [-(-side // stride) for side in _PROBED]
    most = [-(-side // network.stride) * network.stride // stride for side in _PROBED]
    shape = tuple(values.shape)
    if shape[:2] != (1, channels) or not all(
        low <= side <= max(low, high)
        for low, side, high in zip(least, shape[2:], most, strict=True)
    ):
        raise ValueError(
            f"predict_coarse returned {head} as {shape} for an image of {_PROBED[0]}x{_PROBED[1]}; "
            f"expected {(1, channels, *least)}, or as many cells as cover the image padded to a "
            f"multiple of stride = {network.stride}: return that grid, or declare another as "
            f"{head}_stride, which is {stride}"
        )
    if not values.isfinite().all():
        raise ValueError(f"predict_coarse returned NaN or Inf as {head}: return finite values")
    if head == "depth" and not 0 <= float(values.min()) <= float(values.max()) <= 1 + 1e-5:
        raise ValueError(
            f"predict_coarse returned a depth of {float(values.min()):.3g} to "
            f"{float(values.max()):.3g}: return 0..1, shares of max_depth_m = "
            f"{network.config.max_depth_m:g} m"
        )
