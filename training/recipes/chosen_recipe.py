"""The recipe that a command names: a recipe of the package, or a TOML file.

Settings that a file leaves out come from the training of the weights with which it begins.
"""

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from tqdm import tqdm

from models import NetworkConfig
from models.registry import find_network
from runtime.base.arguments import shown
from runtime.base.errors import InputError
from runtime.files.read_input import read_toml
from training.base.tables import merge
from training.losses import LossConfig
from training.losses.terms import PAIR_TERMS, TERMS
from training.losses.total import gather_weights
from training.recipes.registry import RECIPES
from training.run.optimizer import OptimizerRecipe
from training.run.recipe import LoopRecipe, build_recipe, change
from training.run.run_folder import read_document
from training.run.stages import Stage
from training.weights.initial_weights import Weights, weights_folder


def read_stages(
    text: str, changes: Sequence[str] = (), init: Weights | None = None
) -> tuple[Stage, ...]:
    """Return the stages of a recipe; a file has a single one.

    Args:
        text: a path if it ends in .toml or .json or contains a slash, else the name of a recipe.
            The recipe.json of a run is what was trained, in which nothing is left out.
        changes: changes of every stage, see `build_recipe`.
        init: a checkpoint from which the first stage starts. Settings that a TOML file leaves out
            come from its training and are reported on stderr.

    Raises:
        InputError: if the name is unknown, and in the cases of `build_recipe`.
    """
    if text.endswith(".json"):
        document = read_document(Path(text))
        if (began := document.get("init")) and init is None:
            warning = f"warning: {text}: the run began with {began}: give its --init, too"
            tqdm.write(warning, file=sys.stderr)
        return (Stage("", build_recipe(document["recipe"], text, changes)),)
    if text.endswith(".toml") or "/" in text or "\\" in text:
        table = inherit_settings(read_toml(Path(text)), changes, init)
        return (Stage("", build_recipe(table, text)),)
    if text not in RECIPES:
        raise InputError(
            f"unknown recipe {text!r}; known: {', '.join(RECIPES)}: for a recipe of your own give "
            "a path that ends in .toml or holds a slash"
        )
    stages = RECIPES[text].stages
    for key in _below(_below(change({}, changes), "model"), "config"):
        if len({str(stage.recipe.model.config.get(key)) for stage in stages}) > 1:
            raise InputError(
                f"{text}: model.config.{key} is not the same in all stages, so that it cannot be "
                "set: leave it out, or train by a TOML file"
            )
    return tuple(
        replace(stage, recipe=build_recipe(asdict(stage.recipe), text, changes)) for stage in stages
    )


# Learning rates as a share of those of the earlier training.
RATE_SHARE = 0.25
# The warm-up takes at most this share of the steps.
_WARMUP_SHARE = 0.1
# The keys that are taken over, by table.
_TAKEN: Mapping[str, tuple[str, ...]] = {
    "loss": tuple(LossConfig.__dataclass_fields__),
    "optimizer": ("name", "learning_rate", "encoder_rate", "weight_decay", "momentum", "frozen"),
    "loop": ("clip_norm",),
}
# Settings of the network that `training.run.network` takes itself.
_COLORS = ("rgb_mean", "rgb_std")
_DEFAULTS = {
    "loss": asdict(LossConfig()),
    "optimizer": asdict(OptimizerRecipe()),
    "loop": asdict(LoopRecipe()),
    "schedule": {"warmup_steps": 0},
}


def inherit_settings(
    table: Mapping[str, Any], changes: Sequence[str], init: Weights | None
) -> Mapping[str, Any]:
    """Return a recipe's changed table; settings it lacks come from the earlier training.

    Added settings that are not the default are reported on stderr. For weights of the package the
    recipe of their first stage is used, because it trains all heads.

    Args:
        table: the recipe's table, as read from TOML.
        changes: changes of the recipe, see `training.run.recipe.change`.
        init: the checkpoint that the training begins with; None: there is none.
    """
    table = change(table, changes)
    if init is None:
        return table
    earlier, source = init.facts.recipe, str(init.path)
    classes = _below(earlier, "model").get("classes")
    name = init.path.stem.removeprefix("ssdnet-")
    if init.path.parent == weights_folder() and name in RECIPES:
        earlier, source = asdict(RECIPES[name].stages[0].recipe), name
    settings = _settings(table, earlier, init.network.config, classes)
    if added := ", ".join(_added(settings, table, _DEFAULTS)):
        tqdm.write(f"from the recipe of {source}: {added}", file=sys.stderr)
    return merge(settings, table)


def _settings(
    table: Mapping[str, Any], earlier: Mapping[str, Any], config: NetworkConfig, classes: Any
) -> dict[str, Any]:
    """Return the values of the earlier recipe that fit; nothing for another network."""
    model = _below(table, "model")
    if model.get("name", config.name) != config.name:
        return {}
    earlier = {**earlier, "loss": gather_weights(_below(earlier, "loss"))}
    settings: dict[str, Any] = {
        name: {key: value for key, value in _below(earlier, name).items() if key in keys}
        for name, keys in _TAKEN.items()
    }
    settings["model"] = {"name": config.name, "config": config_changes(config)}
    if classes is not None:
        settings["model"]["classes"] = classes
    _fit_loss(settings["loss"], table, model.get("classes", classes))
    rates = settings["optimizer"]
    for key in ("learning_rate", "encoder_rate"):  # to those of fine-tuning
        if rates.get(key) is not None:
            rates[key] *= RATE_SHARE
    if _below(table, "optimizer").get("name", rates.get("name")) != rates.get("name"):
        settings["optimizer"] = {key: rates[key] for key in ("frozen",) if key in rates}
    steps = _below(table, "schedule").get("steps")
    warmup = _below(earlier, "schedule").get("warmup_steps", 0)
    if isinstance(steps, int):
        settings["schedule"] = {"warmup_steps": min(warmup, int(steps * _WARMUP_SHARE))}
    return settings


def _below(table: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """Return a table inside a table, or an empty one if it does not exist."""
    value = table.get(key)
    return value if isinstance(value, Mapping) else {}


def config_changes(config: NetworkConfig) -> dict[str, Any]:
    """Return the settings that differ from the configuration of the network's name."""
    values, default = config.to_dict(), find_network(config.name).config.to_dict()
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
    weights = _below(loss, "weights")
    loss["weights"] = {name: value for name, value in weights.items() if name not in left_out}


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
