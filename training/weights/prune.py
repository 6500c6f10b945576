"""Structured pruning of EfficientNet-Lite0's trunk: fewer channels within its blocks."""

import copy
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor, nn
from tqdm import tqdm

from models import Network
from models.blocks import pad_to_multiple
from models.efficientnet_lite import WIDTHS, EfficientNetLite, InvertedResidual, SameConv
from runtime.base.errors import CheckpointError

# Sampled pixels of each picture.
_PIXELS = 6000
# Ridge, as a share of the mean variance, that makes the covariance invertible.
_DAMPING = 1e-3


@dataclass
class _Moments:
    """Count, sum and sum of outer products of the features that a projection reads."""

    count: int = 0
    total: Tensor | float = 0.0
    squares: Tensor | float = 0.0

    def add(self, features: Tensor) -> None:
        """Add features, (N, C, H, W)."""
        pixels = features.permute(0, 2, 3, 1).flatten(0, 2)
        chosen = torch.linspace(0, len(pixels) - 1, min(len(pixels), _PIXELS)).long()
        pixels = pixels[chosen].double()
        self.count += len(pixels)
        self.total = self.total + pixels.sum(dim=0)
        self.squares = self.squares + pixels.T @ pixels

    def mean_and_covariance(self) -> tuple[Tensor, Tensor]:
        """Return mean and covariance, (C,) and (C, C)."""
        mean = torch.as_tensor(self.total) / self.count
        return mean, torch.as_tensor(self.squares) / self.count - torch.outer(mean, mean)


def trunk_of(network: Network) -> EfficientNetLite | None:
    """Return the trunk of EfficientNet-Lite0 of a network, its `encoder`; None without one.

    The configuration of such a network has the widths of the trunk as `encoder_widths`.
    """
    encoder = getattr(network, "encoder", None)
    return encoder if isinstance(encoder, EfficientNetLite) else None


def trunk_widths(network: Network) -> tuple[int, ...]:
    """Return the channels of the stem and of each block of a network's trunk."""
    return tuple(network.config.to_dict()["encoder_widths"]) or WIDTHS


def prune_trunk(network: Network, widths: Sequence[int], pictures: Iterable[Tensor]) -> Network:
    """Return a copy of a network with fewer channels within the trunk's blocks.

    Channels are removed one by one: the one whose removal changes the output of its block least, in
    the mean square over the pictures, while the projection of the other channels is updated to
    compensate. Both have a closed form (Optimal Brain Surgeon, Hassibi and Stork 1993; Frantar and
    Alistarh 2022). Where nothing is to be removed, the network itself is returned.

    Args:
        network: a network with a trunk, see `trunk_of`; it is not changed.
        widths: channels of the stem and of each block, see `EfficientNetLite`; () = all.
        pictures: float (N, 3, H, W), RGB in 0..255, at least one; not read if nothing is removed.

    Raises:
        CheckpointError: if a width is larger than the network's.
    """
    before = trunk_widths(network)
    widths = tuple(widths) or WIDTHS
    if len(widths) != len(before) or any(a > b for a, b in zip(widths, before, strict=True)):
        raise CheckpointError(
            f"encoder_widths = {list(widths)}: pruning only narrows a trunk, and this one has "
            f"{list(before)}: give a network with the wider trunk"
        )
    if widths == before:
        return network
    changed: dict[str, Any] = {"encoder_widths": widths}
    pruned = type(network)(replace(network.config, **changed))
    pruned.load_state_dict(_without_channels(network, widths, pictures))
    tqdm.write(
        f"the trunk was pruned from {sum(before)} to {sum(widths)} channels", file=sys.stderr
    )
    return pruned.train(network.training)


def _without_channels(
    network: Network, widths: Sequence[int], pictures: Iterable[Tensor]
) -> dict[str, Tensor]:
    """Return the weights of a network without the pruned channels."""
    state, blocks = dict(network.state_dict()), _blocks(network)
    # A fused start has two widths before its first block, which are not pruned.
    start = len(widths) - len(blocks)
    before, widths = trunk_widths(network)[start:], widths[start:]
    narrowed = [name for name, old, new in zip(blocks, before, widths, strict=True) if new < old]
    moments = _observe(network, narrowed, pictures)
    # The first block has no expansion: its channels are the stem's.
    makers = [f"{name}.expand" for name in blocks]
    if not start:
        makers[0] = "stem.0"
    for (name, block), maker, width in zip(blocks.items(), makers, widths, strict=True):
        if name not in moments:
            continue
        kept, weight, shift = _choose_channels(block, width, *moments[name].mean_and_covariance())
        for layer in (maker, f"{name}.depthwise"):
            for part in ("0.weight", "1.weight", "1.bias", "1.running_mean", "1.running_var"):
                key = f"encoder.{layer}.{part}"
                state[key] = state[key][kept]
        key = f"encoder.{name}.project"
        state[f"{key}.0.weight"] = weight.to(state[f"{key}.0.weight"])[:, :, None, None]
        state[f"{key}.1.running_mean"] = state[f"{key}.1.running_mean"] + shift.float()
    return state


def _blocks(network: Network) -> dict[str, InvertedResidual]:
    trunk = trunk_of(network)
    assert trunk is not None
    modules = trunk.named_modules()
    return {name: part for name, part in modules if isinstance(part, InvertedResidual)}


@torch.no_grad()
def _observe(
    network: Network, names: Sequence[str], pictures: Iterable[Tensor]
) -> dict[str, _Moments]:
    """Return the moments of the inputs of each block's projection, for images without LiDAR."""
    moments = {name: _Moments() for name in names}
    probe = copy.deepcopy(network).eval()
    blocks = _blocks(probe)
    for name in names:
        blocks[name].project.register_forward_pre_hook(
            lambda _, inputs, name=name: moments[name].add(inputs[0])
        )
    for picture in pictures:
        rgb = pad_to_multiple(picture, network.stride)
        probe(rgb, rgb.new_zeros(rgb[:, :1].shape))
    return moments


def _choose_channels(
    block: InvertedResidual, width: int, mean: Tensor, covariance: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Choose the channels that are kept.

    Returns:
        Their indices, ascending, (width,); the weights of the projection, (C', width); and by how
        much the mean of its output increases, (C',).
    """
    conv, norm = block.project[0], block.project[1]
    assert isinstance(conv, SameConv)
    assert isinstance(norm, nn.BatchNorm2d)
    assert norm.running_var is not None
    scale = (norm.weight / (norm.running_var + norm.eps).sqrt()).detach().double()[:, None]
    whole = conv.weight.detach()[:, :, 0, 0].double()
    damping = _DAMPING * covariance.diagonal().mean() + torch.finfo(covariance.dtype).tiny
    inverse = torch.linalg.inv(covariance + damping * torch.eye(len(mean), dtype=mean.dtype))
    weight, gone = whole.clone(), torch.zeros(len(mean), dtype=torch.bool)
    for _ in range(len(mean) - width):
        cost = (weight * scale).square().sum(dim=0) / inverse.diagonal()
        least = int(cost.masked_fill(gone, torch.inf).argmin())
        step = inverse[least] / inverse[least, least]
        for each in (weight, inverse):  # the column of the removed channel becomes 0
            each.addr_(each[:, least].clone(), step, alpha=-1)
        gone[least] = True
    kept = gone.logical_not().nonzero().flatten()
    return kept, weight[:, kept], weight[:, kept] @ mean[kept] - whole @ mean
