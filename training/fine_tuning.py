"""Fine-tuning: what a recipe leaves out comes from the training of the weights it begins with."""

import sys
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tqdm import tqdm

from models import NetworkConfig, load_checkpoint
from models.registry import NETWORKS
from runtime.checks import shown
from training.initial_weights import list_weights, weights_folder
from training.losses import LossConfig
from training.losses.total import PAIR_TERMS, TERMS
from training.recipe import LoopRecipe, OptimizerRecipe, Recipe, build, merge, read_table
from training.recipe_files import find_recipe

#: Learning rates, as a share of those of the earlier training.
RATE_SHARE = 0.25
#: The warm-up takes at most this share of the steps.
_WARMUP_SHARE = 0.1
#: The keys that are taken, by table.
_TAKEN: Mapping[str, tuple[str, ...]] = {
    "loss": tuple(LossConfig.__dataclass_fields__),
    "optimizer": ("name", "learning_rate", "encoder_rate", "weight_decay", "momentum", "frozen"),
    "loop": ("clip_norm",),
}
#: Settings of the network that `training.network` takes itself.
_COLORS = ("rgb_mean", "rgb_std")
_DEFAULTS = {
    "loss": asdict(LossConfig()),
    "optimizer": asdict(OptimizerRecipe()),
    "loop": asdict(LoopRecipe()),
    "schedule": {"warmup_steps": 0},
}


class EarlierTraining:
    """The training of a checkpoint, for the tables of recipes that begin with its weights.

    Weights of the package were trained in stages, the last of which trains a part of the network:
    their recipe counts without its stages.

    Args:
        init: the checkpoint.

    Raises:
        CheckpointError: if it cannot be read.
    """

    def __init__(self, init: Path) -> None:
        checkpoint = load_checkpoint(init)
        self._config = checkpoint.model.config
        self._classes: Any = checkpoint.facts.recipe.get("model", {}).get("classes")
        self._recipe, self._source = checkpoint.facts.recipe, str(init)
        if init.parent == weights_folder() and init.stem in list_weights():
            self._source = init.stem.removeprefix("ssdnet-")
            table = read_table(find_recipe(self._source))
            table.pop("stage", None)
            self._recipe = asdict(build(Recipe, table))

    def complete(self, table: Mapping[str, Any]) -> dict[str, Any]:
        """Return a recipe's table with the settings of the earlier training where it has none."""
        return merge(self._settings(table), table)

    def report(self, table: Mapping[str, Any]) -> None:
        """Name on stderr what `complete` adds to a table, as far as no default does."""
        added = ", ".join(_added(self._settings(table), table, _DEFAULTS))
        if added:
            tqdm.write(f"from the recipe of {self._source}: {added}", file=sys.stderr)

    def _settings(self, table: Mapping[str, Any]) -> dict[str, Any]:
        """Return what fits a recipe's table; nothing for another network."""
        model = _below(table, "model")
        if model.get("name", self._config.name) != self._config.name:
            return {}
        settings: dict[str, Any] = {
            name: {key: value for key, value in _below(self._recipe, name).items() if key in keys}
            for name, keys in _TAKEN.items()
        }
        settings["model"] = {"name": self._config.name, "config": _changes(self._config)}
        if self._classes is not None:
            settings["model"]["classes"] = self._classes
        _fit_loss(settings["loss"], table, model.get("classes", self._classes))
        _fit_rates(settings["optimizer"], _below(table, "optimizer"))
        steps = _below(table, "schedule").get("steps")
        warmup = _below(self._recipe, "schedule").get("warmup_steps", 0)
        if isinstance(steps, int):
            settings["schedule"] = {"warmup_steps": min(warmup, int(steps * _WARMUP_SHARE))}
        return settings


def _below(table: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """Return a table of a table; an empty one where there is none."""
    value = table.get(key)
    return value if isinstance(value, Mapping) else {}


def _changes(config: NetworkConfig) -> dict[str, Any]:
    """Return what differs from the configuration of the network's name."""
    values, default = config.to_dict(), NETWORKS[config.name].config.to_dict()
    own = {key: value for key, value in values.items() if value != default.get(key)}
    return {key: value for key, value in own.items() if key not in ("classes", *_COLORS)}


def _fit_loss(loss: dict[str, Any], table: Mapping[str, Any], classes: object) -> None:
    """Drop the terms that need a second view, a teacher or a class that the recipe lacks."""
    augment = _below(_below(table, "data"), "augment")
    # A named table has the road; another value is refused with the recipe.
    own = classes if isinstance(classes, list | tuple) else ({"name": "road"},)
    has_road = any(
        isinstance(info, Mapping) and str(info.get("name")).lower() == "road" for info in own
    )
    left_out = set() if augment.get("pair_shift") else set(PAIR_TERMS)
    left_out |= {name for name in TERMS if name.startswith("distilled_")}
    left_out |= set() if has_road else {"road"}
    for term in left_out:
        loss.pop(f"{term}_weight", None)


def _fit_rates(optimizer: dict[str, Any], wanted: Mapping[str, Any]) -> None:
    """Lower the rates to those of fine-tuning; another optimiser has none of them."""
    for key in ("learning_rate", "encoder_rate"):
        if optimizer.get(key) is not None:
            optimizer[key] *= RATE_SHARE
    if wanted.get("name", optimizer.get("name")) != optimizer.get("name"):
        for key in set(optimizer) - {"frozen"}:
            del optimizer[key]


def _added(
    settings: Mapping[str, Any], table: Mapping[str, Any], defaults: Mapping[str, Any]
) -> Iterator[str]:
    """Yield "key = value" of each setting that a table lacks, unless it is the default."""
    for key, value in settings.items():
        if isinstance(value, Mapping):
            below = _added(value, _below(table, key), _below(defaults, key))
            yield from (f"{key}.{text}" for text in below)
        elif key not in table and value != defaults.get(key):
            yield f"{key} = {shown(value)}"
