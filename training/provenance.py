"""What the weights of a training come from: the data that they know, and the terms of these."""

from collections.abc import Iterable

from training.initial_weights import Weights
from training.recipe import Recipe

#: Added to the terms of the recipe if ImageNet weights are used.
IMAGENET_TERMS = (
    "ImageNet: research, non-commercial (its weights, EfficientNet-Lite0's, are Apache-2.0)"
)
_SEPARATOR = "; "


def state_provenance(recipe: Recipe, *checkpoints: Weights | None) -> tuple[tuple[str, ...], str]:
    """Return the data that weights were trained on, and their terms, without repetitions.

    Args:
        recipe: of the training.
        checkpoints: initial weights and teacher, whose data count, too; None = not used.
    """
    data = [item.title for item in recipe.data.source]
    terms = [recipe.terms]
    if recipe.model.pretrained == "imagenet":
        data.append("ImageNet")
        terms.append(IMAGENET_TERMS)
    for weights in checkpoints:
        if weights is not None:
            data += weights.facts.data
            terms.append(weights.facts.terms)
    parts = (part for text in terms for part in text.split(_SEPARATOR))
    return _unique(data), _SEPARATOR.join(_unique(filter(None, parts)))


def _unique(items: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(items))
