"""The data that weights were trained on, also in earlier trainings, and the terms of these data."""

from collections.abc import Iterable

from runtime.base.errors import InputError
from training.run.recipe import Recipe
from training.weights.initial_weights import Weights

# Added to the data and terms of the recipe if ImageNet weights are used.
_IMAGENET = "ImageNet"
IMAGENET_TERMS = (
    "EfficientNet-Lite0's weights: Apache-2.0, trained on the images of ImageNet, which are for "
    "non-commercial research"
)
_SEPARATOR = "; "


def state_provenance(recipe: Recipe, *checkpoints: Weights | None) -> tuple[tuple[str, ...], str]:
    """Return the data on which weights were trained, and their terms, without repetitions.

    Args:
        recipe: recipe of the training.
        checkpoints: initial weights and teacher, whose data count, too; None if not used.
    """
    data = [item.title for item in recipe.data.source]
    terms = [recipe.terms]
    if recipe.model.pretrained == "imagenet":
        data.append(_IMAGENET)
        terms.append(IMAGENET_TERMS)
    for weights in checkpoints:
        if weights is not None:
            data += weights.facts.data
            terms.append(weights.facts.terms)
    parts = (part for text in terms for part in text.split(_SEPARATOR))
    return _unique(data), _SEPARATOR.join(_unique(filter(None, parts)))


def require_own_data(recipe: Recipe, **checkpoints: Weights | None) -> None:
    """Raise InputError if a recipe with `own_data_only` is given weights of other data.

    `checkpoints` are the initial weights and the teacher, by their options; None if not used.
    """
    own = {_IMAGENET, *(item.title for item in recipe.data.source)}
    for option, weights in checkpoints.items():
        if not recipe.own_data_only or weights is None:
            continue
        others = [title for title in weights.facts.data or ("unknown data",) if title not in own]
        if others:
            raise InputError(
                f"--{option} {weights.path.name}: was trained on {', '.join(others)}, whose terms "
                "would be those of this recipe's weights, too: leave it out, or set "
                "own_data_only = false"
            )


def _unique(items: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(items))
