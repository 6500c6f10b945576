"""The network of a recipe: built, and started from other weights."""

from collections.abc import Iterable
from dataclasses import field, fields, replace
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag
from pydantic.dataclasses import dataclass
from torch import Tensor

from models import Network, NetworkConfig, create_model
from models.registry import find_network
from runtime.base.errors import InputError
from runtime.contract.contract import MAX_CLASSES, MAX_NAME_LENGTH, ClassInfo
from training.base.limits import STRICT, Side
from training.base.tables import TAGS
from training.datasets.class_mapping import IGNORED, ClassTable, TableName, list_classes
from training.weights.imagenet_weights import COLORS, pretrain
from training.weights.initial_weights import Weights, find_origins, start_from
from training.weights.prune import trunk_of

# Tags of the two forms of `model.classes`.
_NAMED, _OWN = "(named)", "(own)"

_Channel = Annotated[int, Field(ge=0, le=255)]


@dataclass(frozen=True, config=STRICT)
class ClassRecipe:
    """A class of a custom table.

    Attributes:
        name: its name.
        color: its RGB colour in pictures.
        of: the classes of the initial weights with whose scores it begins; (): that of its name.
    """

    name: Annotated[str, Field(min_length=1, max_length=MAX_NAME_LENGTH)]
    color: tuple[_Channel, _Channel, _Channel]
    of: Annotated[tuple[str, ...], Field(max_length=MAX_CLASSES)] = ()


TAGS |= {_NAMED: str, _OWN: ClassRecipe}


@dataclass(frozen=True, config=STRICT)
class ModelRecipe:
    """Which network, by its name in `models.list_models()`.

    Attributes:
        classes: table of the class ids: a name in `models.CLASS_TABLES`, or a custom table.
        trained_height: height [px] of the training images after magnification, stored in the
            exported file: images of a much higher camera are resized to it. None: unknown, so every
            frame runs at its own size.
        pretrained: "imagenet": the encoder starts from weights of ImageNet, see
            `training.weights.imagenet_weights`, and the images are normalised for them.
        config: what differs from the named network's configuration, for example `max_depth_m` and
            `canonical_focal_px`, see `models.NetworkConfig`.
    """

    name: str
    classes: Annotated[
        Annotated[TableName, Tag(_NAMED)]
        | Annotated[
            tuple[ClassRecipe, ...], Field(min_length=1, max_length=MAX_CLASSES), Tag(_OWN)
        ],
        Discriminator(lambda value: _OWN if isinstance(value, list | tuple) else _NAMED),
    ] = "camvid"
    trained_height: Side | None = None
    pretrained: Literal["none", "imagenet"] = "none"
    config: Annotated[dict[str, Any], Field(max_length=100)] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check that no key is given twice, and that there is a network of this configuration."""
        doubled = sorted({item.name for item in fields(self)} & set(self.config))
        if doubled:
            raise ValueError(f"config has {doubled[0]!r}, which is a separate key: {doubled[0]}")
        names = [name.casefold() for name in self.class_names]
        for index, name in enumerate(names):
            if (first := names.index(name)) < index:
                raise ValueError(
                    f"classes has {self.class_names[first]!r} and {self.class_names[index]!r}: "
                    "names must differ beyond upper and lower case"
                )
        if IGNORED in names:
            raise ValueError(
                f"classes has {IGNORED!r}, which stands for pixels without a class: leave it out "
                f"(--ignore {IGNORED}), or give it another name"
            )
        try:
            find_network(self.name)
        except ValueError as error:
            raise ValueError(f"name: {error}") from error
        try:
            self.network_config()
        except ValueError as error:
            raise ValueError(f"config: {error}") from error

    def network_config(self) -> NetworkConfig:
        """Return the network's configuration; ValueError if it cannot be built.

        The normalisation of colours may still change to that of the weights it begins with.
        """
        default = find_network(self.name).config
        values = {**default.to_dict(), **self.config}
        if self.config.get("semantic_head") is False:
            values["classes"] = ()
        config = type(default).from_dict(values)
        return replace(config, classes=list_classes(self.class_table)) if config.classes else config

    def class_id(self, name: str) -> int | None:
        """Return the id of the class of this name, ignoring case; None: no such class."""
        names = [known.lower() for known in self.class_names]
        return names.index(name.lower()) if name.lower() in names else None

    @property
    def class_names(self) -> list[str]:
        """The names of the class ids."""
        return [info.name for info in list_classes(self.class_table)]

    @property
    def relatives(self) -> list[tuple[str, ...]]:
        """For every class, the classes of other weights that it stands for: `of`, or its name."""
        own = () if isinstance(self.classes, str) else self.classes
        return [info.of or (info.name,) for info in own] or [(name,) for name in self.class_names]

    @property
    def class_table(self) -> ClassTable:
        """The classes, as networks and data sets take them."""
        if isinstance(self.classes, str):
            return self.classes
        return tuple(ClassInfo(info.name, info.color) for info in self.classes)


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
    origins: list[list[int]] = []
    if init is not None:
        before = init.network.config
        origins = find_origins(recipe.relatives, before)
        changes |= {"rgb_mean": before.rgb_mean, "rgb_std": before.rgb_std}
        if any(len(rows) > 1 for rows in origins):
            changes["class_rows"] = tuple(max(1, len(rows)) for rows in origins)
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
        start_from(network, init, origins, resumed=resumed)
    return network
