"""Recipes: one TOML file says everything about a training; unknown keys are errors."""

import json
import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, Union

from pydantic import AfterValidator, Discriminator, Field, Tag, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from runtime.contract import MAX_CLASSES, MAX_NAME_LENGTH, MIN_SIDE, ClassInfo
from runtime.errors import InputError
from runtime.io.read_input import read_toml
from training.datasets.class_mapping import ClassTable, list_classes
from training.datasets.registry import DATASETS
from training.datasets.source_recipe import SourceRecipe
from training.lidar.split import LidarInput
from training.limits import (
    MAX_BATCH_PIXELS,
    MAX_SAMPLES,
    STRICT,
    BatchSize,
    Count,
    DepthRange,
    FocalLength,
    Logit,
    NotNegative,
    Positive,
    Seed,
    Share,
    Side,
    Steps,
    Workers,
    require_window,
)
from training.loading.augment import AugmentConfig
from training.losses import LossConfig

T = TypeVar("T")

if TYPE_CHECKING:
    AnySource = SourceRecipe
else:
    #: A data set of any kind, told apart by its key ``kind``.
    AnySource = Annotated[
        Union[tuple(DATASETS.values())],  # noqa: UP007
        Field(discriminator="kind"),
    ]


#: How the two forms of ``model.classes`` are told apart.
_NAMED, _OWN = "(named)", "(own)"
_Channel = Annotated[int, Field(ge=0, le=255)]


@dataclass(frozen=True, config=STRICT)
class ClassRecipe:
    """A class of a table of one's own: its name, and its red, green and blue in pictures."""

    name: Annotated[str, Field(min_length=1, max_length=MAX_NAME_LENGTH)]
    color: tuple[_Channel, _Channel, _Channel]


#: What pydantic puts into the place of a mistake to say which member of a union it tried.
_TAGS: Mapping[str, type] = {**DATASETS, _NAMED: str, _OWN: ClassRecipe}


@dataclass(frozen=True, config=STRICT)
class ModelRecipe:
    """Which network, by its name in `models.list_models()`."""

    name: str
    max_depth_m: DepthRange = 100.0
    #: Focal length of the canonical camera, see `models.NetworkConfig`: the network is trained on
    #: depth * this / f, f the focal length of each picture as it sees it, magnification included.
    #: A set that does not say its focal length counts as of the canonical camera before it is
    #: magnified. None = plain metres.
    canonical_focal_px: FocalLength | None = None
    #: The table of the class ids: a name in `models.CLASS_TABLES`, or one's own.
    classes: Annotated[
        Annotated[Literal["camvid", "cityscapes", "virtual_kitti"], Tag(_NAMED)]
        | Annotated[
            tuple[ClassRecipe, ...], Field(min_length=1, max_length=MAX_CLASSES), Tag(_OWN)
        ],
        Discriminator(lambda value: _OWN if isinstance(value, list | tuple) else _NAMED),
    ] = "camvid"
    #: False = the network's decoders are not gated by the boundary.
    boundary_gating: bool = True
    #: Factor on the sparse depth at the network's input.
    sparse_depth_gain: Positive = 1.0
    #: Rows of the pictures as it sees them, magnification included. Goes into the exported file: a
    #: camera of many more rows is brought down to it. None = not known: every frame runs at its own
    #: size.
    trained_height: Side | None = None
    #: Other fields of the network's configuration, by their names there, for example
    #: `encoder_blocks = [1, 1, 1, 1]`; the rest stays as it is by the network's name.
    config: Annotated[dict[str, Any], Field(max_length=100)] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse what contradicts itself, with a ValueError that names the key."""
        doubled = sorted({item.name for item in fields(self)} & set(self.config))
        if doubled:
            raise ValueError(f"config has {doubled[0]!r}, which is a key of its own: {doubled[0]}")
        names = [] if isinstance(self.classes, str) else [info.name for info in self.classes]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"classes has {twice[0]!r} twice")

    def class_id(self, name: str) -> int | None:
        """Return the id of the class of this name, in any case of its letters; None = no such."""
        names = [info.name.lower() for info in list_classes(self.class_table)]
        return names.index(name) if name in names else None

    @property
    def class_table(self) -> ClassTable:
        """What `classes` says, as networks and data sets take it."""
        if isinstance(self.classes, str):
            return self.classes
        return tuple(ClassInfo(info.name, info.color) for info in self.classes)


@dataclass(frozen=True, config=STRICT)
class DataRecipe:
    """What is drawn, how it is changed and how it is batched."""

    source: Annotated[tuple[AnySource, ...], Field(min_length=1, max_length=100)]
    augment: AugmentConfig = field(default_factory=AugmentConfig)
    #: Of each process.
    batch_size: BatchSize = 8
    workers: Workers = 1
    #: Memory for decoded frames, all workers of a process together [GiB]; 0 = each is decoded
    #: every time.
    cache_gib: NotNegative = 0.0
    seed: Seed = 0
    #: Train depth to the far end of the range where the class is called "sky" and nothing was
    #: measured.
    sky_depth: bool = False
    #: Samples from which the class frequencies for the loss are counted.
    frequency_samples: Count = 400

    def __post_init__(self) -> None:
        """Refuse what no memory holds, with a ValueError that names the key."""
        crop = self.augment.crop
        if min(crop) < MIN_SIDE:
            raise ValueError(f"augment.crop = {list(crop)}; both must be at least {MIN_SIDE}")
        if self.batch_size * crop[0] * crop[1] > MAX_BATCH_PIXELS:
            raise ValueError(
                f"batch_size = {self.batch_size}: with crops of {crop[0]}x{crop[1]} a batch has "
                f"more than {MAX_BATCH_PIXELS} pixels"
            )
        for index, item in enumerate(self.source):
            if item.scale is not None:
                require_window(f"source[{index}].scale", crop, item.scale)


@dataclass(frozen=True, config=STRICT)
class OptimizerRecipe:
    """AdamW, or the paper's SGD (momentum 0 is the paper's)."""

    name: Literal["adamw", "sgd"] = "adamw"
    learning_rate: NotNegative = 2e-3
    weight_decay: NotNegative = 1e-2
    momentum: Share = 0.9
    #: Parts of the network that are trained, by the beginning of their names ("depth_"); the others
    #: stay as they are, their batch statistics too. () = all.
    only: Annotated[tuple[str, ...], Field(max_length=100)] = ()


@dataclass(frozen=True, config=STRICT)
class ScheduleRecipe:
    """Linear warm-up, then cosine to ``final_ratio`` of the rate, or constant."""

    steps: Steps
    warmup_steps: Annotated[int, Field(ge=0, le=10**8)] = 0
    shape: Literal["cosine", "constant"] = "cosine"
    final_ratio: Share = 0.0


@dataclass(frozen=True, config=STRICT)
class LoopRecipe:
    """How steps are computed and what is kept."""

    #: Type of the network's arithmetic. fp16 scales the loss; a step whose gradients overflow is
    #: left out and the scale is halved.
    autocast: Literal["none", "bf16", "fp16"] = "none"
    channels_last: bool = True
    #: Let torch.compile make kernels of its own.
    compile: bool = False
    #: Decay of the averaged weights that ship; 0 = no averaging.
    ema_decay: Share = 0.999
    #: Largest norm of the gradient; 0 = no clipping.
    clip_norm: NotNegative = 0.0
    #: Share of the log class weights that model.pt's semantic bias gives back (Menon et al. 2021):
    #: weighted training finds rare classes too often. 0 = none, 1 = all.
    logit_adjustment: Share = 0.0
    #: (class, what is added to its logit) in model.pt, where training frames say that a class is
    #: found too often or too seldom; benchmarks/logit_offsets.py finds them.
    logit_offsets: Annotated[tuple[tuple[str, Logit], ...], Field(max_length=255)] = ()
    #: Batches, of each process, whose gradients are averaged for one step; batch normalisation
    #: sees each of them alone.
    accumulate: BatchSize = 1
    checkpoint_every: Steps = 500
    log_every: Steps = 20


def _require_lidar(text: str) -> str:
    try:
        LidarInput.parse(text)
    except InputError as error:
        raise ValueError(str(error).rstrip(".")) from error
    return text


@dataclass(frozen=True, config=STRICT)
class ValidationRecipe:
    """Sets that the averaged weights are scored on while training."""

    every: Steps = 1000
    #: The LiDAR that is fed, as `training.lidar.split.LidarInput` reads it: what the network is
    #: trained with.
    lidar: Annotated[str, AfterValidator(_require_lidar)] = "own"
    source: Annotated[tuple[AnySource, ...], Field(max_length=100)] = ()
    #: Frames of each set, evenly spread, that TensorBoard shows as pictures.
    pictures: Annotated[int, Field(ge=0, le=1000)] = 3
    #: The score that best.pt has the best of, "SET/FIGURE" as "camvid/miou", columns of scores.csv.
    #: "" = of the first set: miou, or mae_m where it has no labels.
    best: str = ""

    def __post_init__(self) -> None:
        """Refuse sets that are mixed up, with a ValueError that names the key."""
        paths = [item.name for item in self.source]
        twice = sorted({path for path in paths if paths.count(path) > 1})
        if twice:
            raise ValueError(f"source has {twice[0]!r} twice; scores are named by the path")
        if self.best and self.best.rpartition("/")[0] not in paths:
            raise ValueError(
                f"best = {self.best!r}; expected SET/FIGURE of one of the sets {paths}, for "
                "example 'camvid/miou'"
            )


@dataclass(frozen=True, config=STRICT)
class Recipe:
    """A whole training, as its TOML file says it."""

    model: ModelRecipe
    data: DataRecipe
    schedule: ScheduleRecipe
    loss: LossConfig = field(default_factory=LossConfig)
    optimizer: OptimizerRecipe = field(default_factory=OptimizerRecipe)
    loop: LoopRecipe = field(default_factory=LoopRecipe)
    validation: ValidationRecipe = field(default_factory=ValidationRecipe)
    #: Data and terms that a model card and an exported file must name.
    terms: Annotated[str, Field(max_length=10_000)] = ""

    def __post_init__(self) -> None:
        """Refuse a training without end, or of classes that are not there, by a ValueError."""
        if self.data.sky_depth and self.model.class_id("sky") is None:
            raise ValueError("data.sky_depth needs a class called 'sky' in model.classes")
        if self.loss.road_weight and self.model.class_id("road") is None:
            raise ValueError("loss.road_weight needs a class called 'road' in model.classes")
        samples = self.schedule.steps * self.data.batch_size * self.loop.accumulate
        if samples > MAX_SAMPLES:
            raise ValueError(
                f"schedule.steps = {self.schedule.steps}: with data.batch_size and "
                f"loop.accumulate these are {samples} samples; at most {MAX_SAMPLES} are drawn"
            )


def read_recipe(path: Path | str, changes: Sequence[str] = ()) -> Recipe:
    """Read a recipe.

    ``base = "other.toml"`` at its top takes another recipe, beside it, and changes single keys of
    it; a list (``data.source``) is replaced as a whole. ``changes`` are further ones, each
    "table.key = value" in TOML's own spelling.

    Raises InputError for a missing file, bad TOML, unknown or mistyped keys.
    """
    table = _read_table(Path(path), ())
    for change in changes:
        try:
            table = _merge(table, tomllib.loads(change))
        except tomllib.TOMLDecodeError as error:
            raise InputError(
                f"{change!r} is not 'table.key = value' in TOML ({error}); text needs quotes."
            ) from error
    try:
        return build(Recipe, table)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _read_table(path: Path, above: tuple[Path, ...]) -> dict[str, Any]:
    """The recipe's table on top of its base's."""
    resolved = Path(os.path.realpath(path))
    if resolved in above:
        raise InputError(f"{path}: is its own base.")
    table = read_toml(path)
    base = table.pop("base", None)
    if base is None:
        return table
    if not isinstance(base, str):
        raise InputError(f"{path}: base = {base!r}; expected the name of a recipe beside it.")
    return _merge(_read_table(path.parent / base, (*above, resolved)), table)


def _merge(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Tables merge key by key; anything else is replaced."""
    merged = dict(base)
    for key, value in changes.items():
        below = merged.get(key)
        merged[key] = (
            _merge(below, value)
            if isinstance(below, Mapping) and isinstance(value, Mapping)
            else value
        )
    return merged


def build(kind: type[T], table: object) -> T:
    """Build ``kind`` from a table of TOML, strictly. Raises InputError that names the place."""
    try:
        # By way of JSON, where a list may be a tuple and yet "3" is no 3.
        return TypeAdapter(kind).validate_json(json.dumps(table))
    except TypeError as error:  # dates and times
        raise InputError(f"{error}; expected text, numbers, true or false.") from error
    except ValidationError as error:
        mistakes = error.errors(include_url=False)
        unknown = [item for item in mistakes if item["type"] == "unexpected_keyword_argument"]
        raise InputError(_describe((unknown or mistakes)[0], kind)) from error


def _describe(mistake: Mapping[str, Any], kind: Any) -> str:
    """What pydantic says of a value, in the words of a recipe."""
    place = mistake["loc"]
    key = _join(place)
    value, context = mistake["input"], mistake.get("ctx", {})
    shown = repr(value) if len(repr(value)) <= 200 else f"{value!r:.200}..."
    match mistake["type"]:
        case "unexpected_keyword_argument":
            known = ", ".join(item.name for item in fields(_table_at(kind, place[:-1])))
            return f"unknown key {key}; known here: {known}. Correct its name."
        case "missing" if isinstance(place[-1], int):
            return f"{_join(place[:-1])} = {shown} has too few values."
        case "missing":
            return f"missing key {key}."
        case "union_tag_not_found":
            return f"missing key {key + '.' * bool(key)}kind."
        case "union_tag_invalid":
            tag, known = context["tag"], context["expected_tags"]
            return f"{key + '.' * bool(key)}kind = {tag!r}; choose one of {known}."
        case "literal_error":
            return f"{key} = {shown}; choose one of {context['expected']}."
        case "value_error" if isinstance(value, dict):  # of a table; its text starts with the key
            return f"{key + '.' * bool(key)}{context['error']}."
        case "value_error":
            return f"{key} = {shown}: {context['error']}."
        case _:
            return f"{key} = {shown}: {mistake['msg'].lower()}."


def _table_at(kind: Any, place: Sequence[str | int]) -> Any:
    """The dataclass of the table at a place below ``kind``."""
    for part in place:
        if part in _TAGS:
            kind = _TAGS[str(part)]
        elif isinstance(part, str):
            kind = next(item.type for item in fields(kind) if item.name == part)
    return kind


def _join(place: Sequence[str | int]) -> str:
    """A place as a recipe's reader calls it: data.source[0].split; tags of unions are none."""
    inner = [part for part in place[:-1] if part not in _TAGS]
    parts = [*inner, *(part for part in place[-1:] if part not in (_NAMED, _OWN))]
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in parts)
    return text.removeprefix(".")
