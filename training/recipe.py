"""Recipes: one TOML file says everything about a training; unknown keys are errors."""

import math
import tomllib
import types
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from runtime.contract import MIN_SIDE
from runtime.errors import InputError
from training.loading.augment import AugmentConfig, require_range
from training.losses import LossConfig

T = TypeVar("T")


def _require(key: str, value: float, *, at_least: float, at_most: float = math.inf) -> None:
    if not (at_least <= value <= at_most and math.isfinite(value)):
        limit = "" if at_most == math.inf else f" and at most {at_most}"
        raise ValueError(f"{key} = {value}; it must be at least {at_least}{limit}")


@dataclass(frozen=True)
class ModelRecipe:
    """Which network, by its name in `models.list_models()`."""

    name: str
    max_depth_m: float = 100.0
    #: The class table, a name in `models.CLASS_TABLES`, that every set's labels are told in.
    classes: Literal["camvid", "cityscapes", "virtual_kitti"] = "camvid"
    #: False = the network's decoders are not gated by the boundary.
    boundary_gating: bool = True
    #: Factor on the sparse depth at the network's input.
    sparse_depth_gain: float = 1.0
    #: Rows of the pictures it is trained for. Goes into the exported file: a camera of many more
    #: rows is brought down to it. None = not known: every frame runs at its own size.
    trained_height: int | None = None

    def __post_init__(self) -> None:
        """Refuse a height that no picture has, with a ValueError that names the key."""
        if self.trained_height is not None:
            _require("trained_height", self.trained_height, at_least=MIN_SIDE)


@dataclass(frozen=True)
class SourceRecipe:
    """One data set of the mixture, or one of the validation sets.

    A key that the kind does not know must keep its default.
    """

    kind: Literal[
        "camvid",
        "cityscapes",
        "kitti_depth",
        "kitti_raw",
        "kitti_stream",
        "rendered",
        "rendered_on_the_fly",
        "virtual_kitti",
        "virtual_kitti_1",
    ]
    #: Folder, relative to one of the ``--data`` folders; none for scenes rendered on the fly.
    path: str = ""
    #: How often it is drawn, relative to the others.
    weight: float = 1.0
    #: The set's own split: train, val, test, selection (KITTI depth), all (Virtual KITTI).
    split: str = "train"
    #: First and last frame of a stream, inclusive.
    first: int = 0
    last: int | None = None
    #: Scenes and variants of Virtual KITTI or rendered scenes; the split's by default.
    scenes: tuple[str, ...] | None = None
    variants: tuple[str, ...] | None = None
    #: File below ``path`` that lists the frames, rows of "scene/variant/number".
    frames: str | None = None
    #: Drives of KITTI raw data; all by default.
    drives: tuple[str, ...] | None = None
    #: Cameras: 0 and 1 of Virtual KITTI 2, 2 and 3 of KITTI; the left one by default.
    cameras: tuple[int, ...] | None = None
    #: KITTI raw: leave out the returns that the camera cannot see behind nearer ones.
    withhold_hidden: bool = False
    #: Rendered on the fly: how many scenes, frames a scene, and the first scene's seed.
    num_scenes: int = 100
    frames_per_scene: int = 4
    scene_seed: int = 0
    #: (height, width) that every frame is brought to first; its own size by default.
    size: tuple[int, int] | None = None
    #: How much the set's labels count, for labels made by a network.
    semantic_weight: float = 1.0
    #: Range of the random magnification; the common one by default.
    scale: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        """Refuse what says nothing about this kind of set, with a ValueError that names the key."""
        for length in self.size or ():
            _require("size", length, at_least=MIN_SIDE)
        if self.scale is not None:
            require_range("scale", self.scale)
        if not (self.path or self.kind == "rendered_on_the_fly"):
            raise ValueError(f"path is missing; a set of kind {self.kind!r} needs one")
        for key, least in (("num_scenes", 1), ("frames_per_scene", 1), ("scene_seed", 0)):
            _require(key, getattr(self, key), at_least=least)
        known = {"kind", "path", "weight", "size", "scale", *_KEYS[self.kind]}
        for item in fields(self):
            if item.name not in known and getattr(self, item.name) != item.default:
                raise ValueError(
                    f"{item.name} means nothing to a set of kind {self.kind!r}; it "
                    f"knows {', '.join(sorted(known))}"
                )

    @property
    def name(self) -> str:
        """What scores of the set are called."""
        return self.path or self.kind


#: What each kind of set can be told, beside what all of them can.
_KEYS: Mapping[str, frozenset[str]] = {
    "camvid": frozenset({"split"}),
    "cityscapes": frozenset({"split"}),
    "kitti_depth": frozenset({"split", "cameras"}),
    "kitti_raw": frozenset({"drives", "cameras", "withhold_hidden"}),
    "kitti_stream": frozenset({"first", "last", "semantic_weight"}),
    "rendered": frozenset({"scenes", "variants", "frames"}),
    "rendered_on_the_fly": frozenset({"variants", "num_scenes", "frames_per_scene", "scene_seed"}),
    "virtual_kitti": frozenset({"split", "scenes", "variants", "frames", "cameras"}),
    "virtual_kitti_1": frozenset({"split", "scenes", "variants", "frames"}),
}


@dataclass(frozen=True)
class DataRecipe:
    """What is drawn, how it is changed and how it is batched."""

    source: tuple[SourceRecipe, ...]
    augment: AugmentConfig = field(default_factory=AugmentConfig)
    #: Of each process.
    batch_size: int = 8
    workers: int = 1
    #: Memory for decoded frames, all workers of a process together [GiB]; 0 = each is decoded
    #: every time.
    cache_gib: float = 0.0
    seed: int = 0
    #: Samples from which the class frequencies for the loss are counted.
    frequency_samples: int = 400

    def __post_init__(self) -> None:
        """Refuse what cannot be drawn, with a ValueError that names the key."""
        _require("source", len(self.source), at_least=1)
        _require("batch_size", self.batch_size, at_least=1)
        _require("seed", self.seed, at_least=0)
        _require("workers", self.workers, at_least=0)
        _require("cache_gib", self.cache_gib, at_least=0)
        _require("frequency_samples", self.frequency_samples, at_least=1)
        for size in self.augment.crop:
            _require("augment.crop", size, at_least=MIN_SIDE)
        for item in self.source:
            if not 0 < item.weight < math.inf:
                raise ValueError(f"source.weight = {item.weight}; it must be positive")


@dataclass(frozen=True)
class OptimizerRecipe:
    """AdamW, or the paper's SGD (momentum 0 is the paper's)."""

    name: Literal["adamw", "sgd"] = "adamw"
    learning_rate: float = 2e-3
    weight_decay: float = 1e-2
    momentum: float = 0.9

    def __post_init__(self) -> None:
        """Refuse negative rates, with a ValueError that names the key."""
        _require("learning_rate", self.learning_rate, at_least=0)
        _require("weight_decay", self.weight_decay, at_least=0)
        _require("momentum", self.momentum, at_least=0, at_most=1)


@dataclass(frozen=True)
class ScheduleRecipe:
    """Linear warm-up, then cosine to ``final_ratio`` of the rate, or constant."""

    steps: int
    warmup_steps: int = 0
    shape: Literal["cosine", "constant"] = "cosine"
    final_ratio: float = 0.0

    def __post_init__(self) -> None:
        """Refuse negative lengths, with a ValueError that names the key."""
        _require("steps", self.steps, at_least=1)
        _require("warmup_steps", self.warmup_steps, at_least=0)
        _require("final_ratio", self.final_ratio, at_least=0, at_most=1)


@dataclass(frozen=True)
class LoopRecipe:
    """How steps are computed and what is kept."""

    #: Type of the network's arithmetic. fp16 scales the loss; a step whose gradients overflow is
    #: left out and the scale is halved.
    autocast: Literal["none", "bf16", "fp16"] = "none"
    channels_last: bool = True
    #: Let torch.compile make kernels of its own: minutes once, faster steps after.
    compile: bool = False
    #: Decay of the averaged weights that ship; 0 = no averaging.
    ema_decay: float = 0.999
    #: Largest norm of the gradient; 0 = no clipping.
    clip_norm: float = 0.0
    #: Share of the log class weights that model.pt's semantic bias gives back (Menon et al. 2021):
    #: weighted training finds rare classes too often. 0 = none, 1 = all.
    logit_adjustment: float = 0.0
    #: Batches, of each process, whose gradients are averaged for one step; batch normalisation
    #: sees each of them alone.
    accumulate: int = 1
    checkpoint_every: int = 500
    log_every: int = 20

    def __post_init__(self) -> None:
        """Refuse intervals below one step, with a ValueError that names the key."""
        _require("checkpoint_every", self.checkpoint_every, at_least=1)
        _require("log_every", self.log_every, at_least=1)
        _require("accumulate", self.accumulate, at_least=1)
        _require("ema_decay", self.ema_decay, at_least=0, at_most=1)
        _require("clip_norm", self.clip_norm, at_least=0)
        _require("logit_adjustment", self.logit_adjustment, at_least=0, at_most=1)


@dataclass(frozen=True)
class ValidationRecipe:
    """Sets that the averaged weights are scored on while training."""

    every: int = 1000
    source: tuple[SourceRecipe, ...] = ()
    #: Frames of each set, evenly spread, that TensorBoard shows as pictures.
    pictures: int = 3

    def __post_init__(self) -> None:
        """Refuse sets whose scores would share a name, with a ValueError that names the key."""
        _require("every", self.every, at_least=1)
        _require("pictures", self.pictures, at_least=0)
        paths = [item.name for item in self.source]
        twice = sorted({path for path in paths if paths.count(path) > 1})
        if twice:
            raise ValueError(f"source has {twice[0]!r} twice; scores are named by the path")


@dataclass(frozen=True)
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
    terms: str = ""


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
    if path.resolve() in above:
        raise InputError(f"{path}: is its own base.")
    try:
        with path.open("rb") as stream:
            table = tomllib.load(stream)
    except OSError as error:
        raise InputError(f"{path}: the recipe cannot be read: {error.strerror}.") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not valid TOML: {error}.") from error
    base = table.pop("base", None)
    if base is None:
        return table
    if not isinstance(base, str):
        raise InputError(f"{path}: base = {base!r}; expected the name of a recipe beside it.")
    return _merge(_read_table(path.parent / base, (*above, path.resolve())), table)


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


def build(kind: type[T], table: Mapping[str, Any], where: str = "") -> T:
    """Build a dataclass from a table, strictly; ``where`` is its place in the file."""
    hints = get_type_hints(kind)
    known = {item.name: item for item in fields(kind)}  # type: ignore[arg-type]
    unknown = sorted(set(table) - set(known))
    if unknown:
        raise InputError(
            f"unknown key {where}{unknown[0]}; known here: {', '.join(known)}. Correct its name."
        )
    missing = [
        name
        for name, item in known.items()
        if name not in table and item.default is MISSING and item.default_factory is MISSING
    ]
    if missing:
        raise InputError(f"missing key {where}{missing[0]}.")
    values = {key: _convert(hints[key], value, f"{where}{key}") for key, value in table.items()}
    try:
        return kind(**values)
    except ValueError as error:  # its text starts with the key
        raise InputError(f"{where}{error}.") from error


def _convert(hint: Any, value: Any, where: str) -> Any:
    origin, arguments = get_origin(hint), get_args(hint)
    if is_dataclass(hint) and isinstance(value, Mapping):
        return build(hint, value, f"{where}.")  # type: ignore[arg-type]
    if origin in (Union, types.UnionType):
        inner = [argument for argument in arguments if argument is not type(None)]
        return None if value is None else _convert(inner[0], value, where)
    if origin is Literal:
        if value in arguments:
            return value
        raise InputError(f"{where} = {value!r}; choose one of {', '.join(map(repr, arguments))}.")
    if origin is tuple and isinstance(value, Sequence) and not isinstance(value, str):
        if arguments[-1] is Ellipsis:
            kinds = [arguments[0]] * len(value)
        elif len(arguments) == len(value):
            kinds = list(arguments)
        else:
            raise InputError(f"{where} needs {len(arguments)} values, got {len(value)}.")
        return tuple(
            _convert(kind, item, f"{where}[{index}]")
            for index, (kind, item) in enumerate(zip(kinds, value, strict=True))
        )
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if (
        isinstance(hint, type)
        and isinstance(value, hint)
        and (hint is bool) == (isinstance(value, bool))
    ):
        return value
    raise InputError(f"{where} = {value!r} has the wrong type; expected {_name(hint)}.")


def _name(hint: Any) -> str:
    return hint.__name__ if isinstance(hint, type) and not get_args(hint) else str(hint)
