"""The network of a recipe: built, and started from other weights."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from torch import Tensor, nn

from models import Network, SSDNetLite, create_model
from models.efficientnet_lite import RGB_MEAN, RGB_STD, WIDTHS
from runtime.errors import CheckpointError, InputError
from training.imagenet_weights import load_imagenet
from training.initial_weights import Weights, start_from
from training.prune import prune_trunk
from training.recipe import ModelRecipe

#: Parts of an `SSDNetLite` whose features the depth alone reads, but for those of the second tuple,
#: which the encoder reads.
DEPTH_ALONE = ("depth_decoder", "surface_depth"), ("surface_depth.embed",)
#: Normalisation in `NetworkConfig` that the ImageNet weights were trained with.
_IMAGENET_COLORS = {"rgb_mean": (RGB_MEAN,) * 3, "rgb_std": (RGB_STD,) * 3}


def build_network(
    recipe: ModelRecipe,
    init: Weights | None,
    *,
    resumed: bool = False,
    pictures: Iterable[Tensor] = (),
) -> Network:
    """Build a recipe's network, with the weights of ``init`` as far as they fit.

    Images are normalised as ``init``'s network does, or as ``pretrained`` weights want, unless the
    recipe says otherwise: the weights know no other values. Pretrained weights are loaded before
    ``init``'s, unless these replace the whole trunk, or the run is ``resumed``; they are pruned for
    a narrower trunk, by their features of ``pictures``, see `prune_trunk`.

    Raises:
        InputError: if the network cannot be built, or ``pretrained`` weights are not for it.
        CheckpointError: if ``pretrained`` weights cannot be read, nothing of ``init`` fits, or its
            trunk has other widths.
    """
    changes: dict[str, Any] = {}
    if init is not None:
        before = init.network.config
        changes |= {"rgb_mean": before.rgb_mean, "rgb_std": before.rgb_std}
    if recipe.pretrained == "imagenet":
        changes |= _IMAGENET_COLORS
    try:
        config = recipe.network_config()
        stated = {key: getattr(config, key) for key in (*recipe.config, "classes")}
        network = create_model(recipe.name, **(changes | stated))
    except (ArithmeticError, ValueError) as error:
        text = f"the recipe's model cannot be built with its classes and config: {error}"
        raise InputError(f"{text}. Change them, or choose another model.name.") from error
    if recipe.pretrained == "imagenet":
        pretrainable = _require_pretrainable(network)
        if not (resumed or (init is not None and isinstance(init.network, SSDNetLite))):
            network = _load_pretrained(pretrainable, pictures)
    if init is not None:
        _require_same_trunk(network, init)
        start_from(network, init, resumed=resumed)
    return network


def _require_same_trunk(network: Network, init: Weights) -> None:
    """Raise CheckpointError for a trunk of other widths, whose layers would be random."""
    source = init.network
    if isinstance(source, SSDNetLite) and isinstance(network, SSDNetLite):
        before, wanted = (item.config.encoder_widths or WIDTHS for item in (source, network))
        if before != wanted:
            raise CheckpointError(
                f"{init.path}: its trunk has other widths than model.config.encoder_widths = "
                f"{list(wanted)}. Set that to {list(before)}, or prune the checkpoint first "
                "(`training.prune.prune_trunk`)."
            )


def _load_pretrained(network: SSDNetLite, pictures: Iterable[Tensor]) -> SSDNetLite:
    """Return the network with weights of ImageNet, pruned for a narrower trunk."""
    widths = network.config.encoder_widths
    wide = SSDNetLite(replace(network.config, encoder_widths=())) if widths else network
    load_imagenet(wide.encoder)
    return prune_trunk(wide, widths, pictures)


def _require_pretrainable(network: Network) -> SSDNetLite:
    """Return the network; InputError if ImageNet weights do not fit it."""
    if not isinstance(network, SSDNetLite):
        raise InputError(
            f"model.pretrained: {network.config.name!r} has no encoder with ImageNet weights. "
            "Choose ssdnet-lite or ssdnet-nano, or leave model.pretrained out."
        )
    for key, wanted in _IMAGENET_COLORS.items():
        if (found := getattr(network.config, key)) != wanted:
            raise InputError(
                f"model.config.{key} = {list(found)}, but the ImageNet weights were trained with "
                f"{list(wanted)}. Leave it out."
            )
    return network


def train_parts(network: Network, only: tuple[str, ...], frozen: tuple[str, ...] = ()) -> None:
    """Put the parts whose names begin with an entry of ``only`` into training mode; () = all.

    The others, and layers at any depth whose names begin with one of ``frozen``, have no gradient
    and constant batch statistics. InputError for a beginning that fits none.
    """
    parts = dict(network.named_children())
    unknown = [start for start in only if not any(name.startswith(start) for name in parts)]
    if unknown:
        raise InputError(
            f"optimizer.only: no part of '{network.config.name}' begins with {unknown[0]!r}; "
            f"it has {', '.join(parts)}."
        )
    network.train()
    for name, part in parts.items():
        trained = not only or name.startswith(only)
        part.requires_grad_(trained)
        if not trained:
            part.eval()
    for start in frozen:
        layers = [part for name, part in network.named_modules() if name.startswith(start)]
        if not layers:
            raise InputError(
                f"optimizer.frozen: no layer of '{network.config.name}' begins with {start!r}; its "
                f"parts are {', '.join(parts)}."
            )
        for layer in layers:
            layer.requires_grad_(False).eval()


def require_encoder(network: Network) -> nn.Module:
    """Return the network's encoder; InputError if it has none."""
    encoder = dict(network.named_children()).get("encoder")
    if encoder is None:
        raise InputError(
            f"optimizer.encoder_rate: '{network.config.name}' has no part called 'encoder'. Leave "
            "it out, or take ssdnet-lite or ssdnet-nano."
        )
    return encoder
