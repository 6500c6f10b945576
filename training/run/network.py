"""The network of a recipe: built, and started from other weights."""

from collections.abc import Iterable
from typing import Any

from torch import Tensor

from models import Network, create_model
from runtime.base.errors import InputError
from training.run.recipe import ModelRecipe
from training.weights.imagenet_weights import COLORS, pretrain
from training.weights.initial_weights import Weights, start_from
from training.weights.prune import trunk_of


def build_network(
    recipe: ModelRecipe,
    init: Weights | None,
    *,
    resumed: bool = False,
    pictures: Iterable[Tensor] = (),
) -> Network:
    """Build a recipe's network, with the weights of `init` as far as they fit.

    Images are normalised as `init`'s network does, or as `pretrained` weights want, unless the
    recipe says otherwise: the weights know no other values. Pretrained weights are loaded before
    `init`'s, unless these replace the whole trunk, or the run is `resumed`; they are pruned for
    a narrower trunk, by their features of `pictures`, see `prune_trunk`.

    Raises:
        InputError: if the network cannot be built, or `pretrained` weights are not for it.
        CheckpointError: if `pretrained` weights cannot be read, nothing of `init` fits, or its
            trunk has other widths.
    """
    changes: dict[str, Any] = {}
    if init is not None:
        before = init.network.config
        changes |= {"rgb_mean": before.rgb_mean, "rgb_std": before.rgb_std}
    if recipe.pretrained == "imagenet":
        changes |= COLORS
    try:
        config = recipe.network_config()
        stated = {key: getattr(config, key) for key in (*recipe.config, "classes")}
        network = create_model(recipe.name, **(changes | stated))
    except (ArithmeticError, ValueError) as error:
        text = f"the recipe's model cannot be built with its classes and config: {error}"
        raise InputError(f"{text}: change them, or choose another model.name") from error
    if recipe.pretrained == "imagenet":
        replaced = resumed or (init is not None and trunk_of(init.network) is not None)
        network = pretrain(network, pictures, load=not replaced)
    if init is not None:
        start_from(network, init, resumed=resumed)
    return network
