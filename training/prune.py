"""Pruning of EfficientNet-Lite0's trunk: each block loses the channels of the smallest weights."""

import sys
from collections.abc import Sequence
from dataclasses import replace

from torch import Tensor, nn
from tqdm import tqdm

from models import SSDNetLite
from models.efficientnet_lite import WIDTHS, EfficientNetLite, InvertedResidual, SameConv
from runtime.errors import CheckpointError


def prune_trunk(network: SSDNetLite, widths: Sequence[int]) -> SSDNetLite:
    """Return a copy of a network whose trunk has fewer channels within its blocks.

    Those are kept, in their order, whose depthwise kernel, as batch normalisation scales it, and
    whose projection have the largest L1 norms (Li et al. 2017).

    Args:
        network: with the encoder "efficientnet-lite0"; not changed.
        widths: of the stem and of each block, see `EfficientNetLite`; () = all.

    Raises:
        CheckpointError: if a width is larger than the network's.
    """
    before = network.config.encoder_widths or WIDTHS
    widths = tuple(widths) or WIDTHS
    if len(widths) != len(before) or any(a > b for a, b in zip(widths, before, strict=True)):
        raise CheckpointError(
            f"encoder_widths = {list(widths)}: pruning only narrows a trunk, and this one has "
            f"{list(before)}. Give --init with the wider trunk."
        )
    pruned = SSDNetLite(replace(network.config, encoder_widths=widths))
    pruned.load_state_dict(_without_channels(network, widths))
    tqdm.write(
        f"the trunk was pruned from {sum(before)} to {sum(widths)} channels", file=sys.stderr
    )
    return pruned.train(network.training)


def _without_channels(network: SSDNetLite, widths: Sequence[int]) -> dict[str, Tensor]:
    """Return the weights of a network without the channels that are pruned."""
    state = dict(network.state_dict())
    trunk = network.encoder.trunk
    assert isinstance(trunk, EfficientNetLite)
    blocks = [
        (name, part) for name, part in trunk.named_modules() if isinstance(part, InvertedResidual)
    ]
    # The first block has no expansion: its channels are the stem's.
    makers = ["stem.0", *(f"{name}.expand" for name, _ in blocks[1:])]
    for (name, block), maker, width in zip(blocks, makers, widths, strict=True):
        kept = _largest(block, width)
        for layer in (maker, f"{name}.depthwise"):
            for part in ("0.weight", "1.weight", "1.bias", "1.running_mean", "1.running_var"):
                key = f"encoder.trunk.{layer}.{part}"
                state[key] = state[key][kept]
        key = f"encoder.trunk.{name}.project.0.weight"
        state[key] = state[key][:, kept]
    return state


def _largest(block: InvertedResidual, width: int) -> Tensor:
    """Return the indices of the channels with the largest norms, in their order."""
    conv, norm, project = block.depthwise[0], block.depthwise[1], block.project[0]
    assert isinstance(conv, SameConv)
    assert isinstance(project, SameConv)
    assert isinstance(norm, nn.BatchNorm2d)
    assert norm.running_var is not None
    scale = (norm.weight / (norm.running_var + norm.eps).sqrt()).abs()
    inwards = scale * conv.weight.abs().sum(dim=(1, 2, 3))
    outwards = project.weight.abs().sum(dim=(0, 2, 3))
    return (inwards * outwards).topk(width).indices.sort().values
