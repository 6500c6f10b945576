"""Recipes, which describe a training in a TOML file or in Python; unknown keys are errors."""

import sys
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import field, is_dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field
from pydantic.dataclasses import dataclass
from tqdm import tqdm

from runtime.base.errors import InputError
from training.base.limits import STRICT, BatchSize, NotNegative, Share, Steps
from training.base.tables import build, merge
from training.loading.data_recipe import DataRecipe
from training.losses import LossConfig
from training.losses.terms import PAIR_TERMS
from training.run.network import ModelRecipe
from training.run.optimizer import OptimizerRecipe, ScheduleRecipe
from training.run.validation_recipe import ValidationRecipe
from training.weights.release import ReleaseRecipe

T = TypeVar("T")


@dataclass(frozen=True, config=STRICT)
class LoopRecipe:
    """Arithmetic, averaging and output of the training loop.

    Attributes:
        autocast: type of the network's arithmetic; "none" is float32.
        ema_decay: decay of the averaged weights in model.pt; 0: no averaging.
        ema_keeps_start: whether the average begins with the weights after the first step, of which
            a short training then leaves a part; otherwise it forgets them early.
        clip_norm: largest norm of the gradient; 0: no clipping.
        accumulate: batches per process whose gradients are averaged for one step; batch
            normalisation is over each batch.
        checkpoint_every: steps between two checkpoints; `log_every` is that between two entries of
            the curves; None: see `Recipe`.
    """

    autocast: Literal["none", "bf16"] = "none"
    ema_decay: Share = 0.999
    ema_keeps_start: bool = False
    clip_norm: NotNegative = 0.0
    accumulate: BatchSize = 1
    checkpoint_every: Steps | None = None
    log_every: Steps | None = None


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
