"""Recipes, which describe a training in a TOML file or in Python; unknown keys are errors."""

import sys
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import field, fields, is_dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, Discriminator, Field, Tag
from pydantic.dataclasses import dataclass
from tqdm import tqdm

from models import NetworkConfig
from models.registry import find_network
from runtime.base.errors import InputError
from runtime.contract.contract import MAX_CLASSES, MAX_NAME_LENGTH, MIN_SIDE, ClassInfo
from training.base.limits import (
    STRICT,
    BatchSize,
    NotNegative,
    Positive,
    Seed,
    Share,
    Side,
    Steps,
    Workers,
)
from training.base.tables import TAGS, build, merge
from training.datasets.any_source import AnySource
from training.datasets.class_mapping import IGNORED, ClassTable, TableName, list_classes
from training.lidar.split import LidarInput
from training.loading.augment_config import AugmentConfig
from training.losses import LossConfig
from training.losses.terms import PAIR_TERMS

T = TypeVar("T")
# Tags of the two forms of `model.classes`.
_NAMED, _OWN = "(named)", "(own)"

_Channel = Annotated[int, Field(ge=0, le=255)]


@dataclass(frozen=True, config=STRICT)
class ClassRecipe:
    """A class of a custom table: its name and its RGB colour in pictures."""

    name: Annotated[str, Field(min_length=1, max_length=MAX_NAME_LENGTH)]
    color: tuple[_Channel, _Channel, _Channel]


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
    def class_table(self) -> ClassTable:
        """The classes, as networks and data sets take them."""
        if isinstance(self.classes, str):
            return self.classes
        return tuple(ClassInfo(info.name, info.color) for info in self.classes)


@dataclass(frozen=True, config=STRICT)
class DataRecipe:
    """The data sets, their augmentation and batches.

    Attributes:
        batch_size: batch size of each process; `workers` is the number of workers of each process.
        cache_gib: memory for decoded frames, of all workers of a process together [GiB]; 0: no
            cache.
        sky_depth_m: depth target [m] of unmeasured pixels of the class "sky", canonical if the
            network's depth is; 0: none.
        rare_classes: classes for which `augment.rare_crops` of the crops are chosen.
    """

    source: Annotated[tuple[AnySource, ...], Field(min_length=1, max_length=100)]
    augment: AugmentConfig = field(default_factory=AugmentConfig)
    batch_size: BatchSize = 8
    workers: Workers = 1
    cache_gib: NotNegative = 0.0
    seed: Seed = 0
    sky_depth_m: NotNegative = 0.0
    rare_classes: Annotated[tuple[str, ...], Field(max_length=MAX_CLASSES)] = ()

    def __post_init__(self) -> None:
        """Check the crop, and that there are classes to choose it for."""
        crop = self.augment.size
        if min(crop) < MIN_SIDE:
            raise ValueError(f"augment.crop = {list(crop)}: both must be at least {MIN_SIDE}")
        if self.augment.rare_crops and not self.rare_classes:
            raise ValueError("augment.rare_crops needs rare_classes, names of model.classes")


@dataclass(frozen=True, config=STRICT)
class OptimizerRecipe:
    """AdamW, or the paper's SGD (momentum 0 is the paper's).

    Attributes:
        encoder_rate: rate of the encoder; one schedule scales both. None: `learning_rate`.
        only: parts of the network that are trained, by the beginning of their names ("depth_"); the
            others are frozen with their batch statistics. Empty: all.
        frozen: layers that are not trained, by the beginning of their names ("encoder.stem"); their
            batch statistics are constant, too.
    """

    name: Literal["adamw", "sgd"] = "adamw"
    learning_rate: NotNegative = 2e-3
    encoder_rate: NotNegative | None = None
    weight_decay: NotNegative = 1e-2
    momentum: Share = 0.9
    only: Annotated[tuple[str, ...], Field(max_length=100)] = ()
    frozen: Annotated[tuple[str, ...], Field(max_length=100)] = ()


@dataclass(frozen=True, config=STRICT)
class ScheduleRecipe:
    """Linear warm-up, then a cosine to 0 or a constant rate."""

    steps: Steps
    warmup_steps: Annotated[int, Field(ge=0, le=10**8)] = 0
    shape: Literal["cosine", "constant"] = "cosine"

    def __post_init__(self) -> None:
        """Check that the warm-up ends."""
        if self.warmup_steps > self.steps:
            raise ValueError(
                f"warmup_steps = {self.warmup_steps}: longer than the run of steps = {self.steps}"
            )


@dataclass(frozen=True, config=STRICT)
class LoopRecipe:
    """Arithmetic, averaging and output of the training loop.

    Attributes:
        autocast: type of the network's arithmetic; "none" is float32.
        ema_decay: decay of the averaged weights in model.pt; 0: no averaging.
        clip_norm: largest norm of the gradient; 0: no clipping.
        accumulate: batches per process whose gradients are averaged for one step; batch
            normalisation is over each batch.
        checkpoint_every: steps between two checkpoints; `log_every` is that between two entries of
            the curves; None: see `Recipe`.
    """

    autocast: Literal["none", "bf16"] = "none"
    ema_decay: Share = 0.999
    clip_norm: NotNegative = 0.0
    accumulate: BatchSize = 1
    checkpoint_every: Steps | None = None
    log_every: Steps | None = None


@dataclass(frozen=True, config=STRICT)
class ReleaseRecipe:
    """How the weights in model.pt and best.pt differ from the averaged ones.

    Attributes:
        logit_adjustment: share of the log class weights that is subtracted from the semantic bias
            (Menon et al. 2021), because training with class weights predicts rare classes too
            often. 0: nothing, 1: all.
    """

    logit_adjustment: Share = 0.0


def _require_lidar(text: str) -> str:
    try:
        LidarInput.parse(text)
    except InputError as error:
        raise ValueError(str(error)) from error
    return text


@dataclass(frozen=True, config=STRICT)
class ValidationRecipe:
    """Data sets on which the averaged weights are scored during training.

    Attributes:
        every: steps between two validations; None: see `Recipe`.
        lidar: the LiDAR input of the validation, see `training.lidar.split.LidarInput`.
        farthest_m: farthest true depth [m] that is scored.
        pictures: number of frames of each set, at equal distances, that TensorBoard shows as
            pictures.
        best: score by which best.pt is chosen, "SET/SCORE", for example "camvid/miou"; scores are
            the columns of scores.csv. "": that of the first set, miou, or mae_m if it has no
            labels.
    """

    every: Steps | None = None
    lidar: Annotated[str, AfterValidator(_require_lidar)] = "own"
    farthest_m: Positive = 100.0
    source: Annotated[tuple[AnySource, ...], Field(max_length=100)] = ()
    pictures: Annotated[int, Field(ge=0, le=1000)] = 2
    best: str = ""

    def __post_init__(self) -> None:
        """Check the names of the sets and of the best score."""
        titles = [item.title for item in self.source]
        twice = sorted({title for title in titles if titles.count(title) > 1})
        if twice:
            raise ValueError(
                f"source has two sets with the title {twice[0]!r}, so their scores could not be "
                "told apart: give each its own `name`"
            )
        if self.best and self.best.rpartition("/")[0] not in titles:
            raise ValueError(
                f"best = {self.best!r}; expected SET/SCORE of one of the sets {titles}, for "
                "example 'camvid/miou'"
            )


@dataclass(frozen=True, config=STRICT)
class Recipe:
    """A training: the tables of a recipe.

    How often the loop writes, if the recipe does not say it, follows from the number of steps.

    Attributes:
        terms: data and terms that a model card and an exported file must state.
        own_data_only: whether initial weights and a teacher are refused that were trained on other
            data than the recipe's, because the terms of these would be those of the weights, too.
    """

    model: ModelRecipe
    data: DataRecipe
    schedule: ScheduleRecipe
    loss: LossConfig = field(default_factory=LossConfig)
    optimizer: OptimizerRecipe = field(default_factory=OptimizerRecipe)
    loop: LoopRecipe = field(default_factory=LoopRecipe)
    release: ReleaseRecipe = field(default_factory=ReleaseRecipe)
    validation: ValidationRecipe = field(default_factory=ValidationRecipe)
    terms: Annotated[str, Field(max_length=10_000)] = ""
    own_data_only: bool = False

    def __post_init__(self) -> None:
        """Check the classes and the views that data and loss need."""
        for name in self.data.rare_classes:
            if self.model.class_id(name) is None:
                raise ValueError(f"data.rare_classes: {name!r} is not a class of model.classes")
        for key, value, name in (
            ("data.sky_depth_m", self.data.sky_depth_m, "sky"),
            ("loss.weights.road", self.loss.weight("road"), "road"),
        ):
            if value and self.model.class_id(name) is None:
                raise ValueError(f"{key} needs a class called {name!r} in model.classes")
        pair_terms = [name for name in PAIR_TERMS if self.loss.weight(name)]
        if pair_terms and not self.data.augment.pair_shift:
            raise ValueError(
                f"loss.weights.{min(pair_terms)} compares two views of a frame: set "
                "data.augment.pair_shift"
            )

    @property
    def rare_ids(self) -> tuple[int, ...]:
        """The ids of `DataRecipe.rare_classes`."""
        ids = (self.model.class_id(name) for name in self.data.rare_classes)
        return tuple(index for index in ids if index is not None)

    @property
    def log_every(self) -> int:
        """Steps between two entries of the curves; by default a hundredth of all, at most 20."""
        return self.loop.log_every or self._share_of_steps(100, 20)

    @property
    def checkpoint_every(self) -> int:
        """Steps between two checkpoints; by default a tenth of all, at most 500."""
        return self.loop.checkpoint_every or self._share_of_steps(10, 500)

    @property
    def validate_every(self) -> int:
        """Steps between two validations; by default a fifth of all, at most 1000."""
        return self.validation.every or self._share_of_steps(5, 1000)

    def _share_of_steps(self, parts: int, most: int) -> int:
        return max(1, min(most, self.schedule.steps // parts))


def derive(recipe: T, **changes: Any) -> T:
    """Return a recipe with other keys; a mapping changes keys of a table, or of the weights."""
    for key, value in changes.items():
        if is_dataclass(table := getattr(recipe, key)) and isinstance(value, Mapping):
            changes[key] = derive(table, **value)
        elif key == "weights":
            changes[key] = {**table, **value}
    return replace(recipe, **changes)  # type: ignore[type-var]


def build_recipe(table: Mapping[str, Any], name: Path | str, changes: Sequence[str] = ()) -> Recipe:
    """Build a recipe from its table.

    Args:
        table: the recipe, as TOML has it.
        name: its file or name, for messages.
        changes: see `change`.

    Raises:
        InputError: for changes that are not TOML, unknown keys or values of the wrong type.
    """
    try:
        return build(Recipe, change(table, changes))
    except InputError as error:
        raise InputError(f"{name}: {error}") from error


def change(table: Mapping[str, Any], changes: Sequence[str]) -> dict[str, Any]:
    """Return a table with changes, each "table.key = value" in TOML.

    A list (`data.source`) is replaced as a whole.
    """
    changed, warmup = dict(table), _warmup(table)
    for text in changes:
        try:
            changed = merge(changed, tomllib.loads(text))
        except tomllib.TOMLDecodeError as error:
            raise InputError(
                f"{text!r} is not 'table.key = value' in TOML ({error}): put text in quotes"
            ) from error
    steps = _warmup(changed, "steps")
    if steps < _warmup(table, "steps") and steps < warmup == _warmup(changed):
        shorter = steps // 10
        changed = merge(changed, {"schedule": {"warmup_steps": shorter}})
        text = f"schedule.warmup_steps = {shorter}: {warmup} do not fit into {steps} steps"
        tqdm.write(text, file=sys.stderr)
    return changed


def _warmup(table: Mapping[str, Any], key: str = "warmup_steps") -> int:
    schedule = table.get("schedule")
    value = schedule.get(key) if isinstance(schedule, Mapping) else None
    return value if isinstance(value, int) else 0
