"""The entries of comparison.py: what its plan names, and their networks and recipes."""

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from pydantic.dataclasses import dataclass

from models import Network, create_model
from models.registry import NETWORKS
from runtime import Predictor
from runtime.base.errors import InputError
from runtime.engine.bundled_models import find_model
from training.chosen_recipe import read_stages
from training.evaluation.classical import create_method
from training.limits import STRICT
from training.network import build_network
from training.recipe import Recipe
from training.tables import build

ONNX, SCORES, TIMES = "model.onnx", "scores.json", "times.json"


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Entry:
    """A row of the tables: a network trained by a recipe with changes, or one of the other kinds.

    Attributes:
        name: title of the row.
        recipe: recipe that replaces the plan's.
        set: changes of the recipe.
        onnx: a bundled model or an ONNX file, which is not trained.
        network: a name in `NETWORKS`, which is timed with random weights and not trained.
        method: a classical method of depth completion.
        published_miou: published mIoU on CamVid test, in percent, shown for comparison.
    """

    name: str
    recipe: str | None = None
    set: tuple[str, ...] = ()
    onnx: str | None = None
    network: str | None = None
    method: str | None = None
    published_miou: float | None = None

    @property
    def folder(self) -> str:
        """The entry's name as the name of a folder."""
        return re.sub(r"[^\w.-]+", "-", self.name)

    @property
    def is_trained(self) -> bool:
        """Whether the entry needs a recipe."""
        return not (self.onnx or self.network or self.method)


@dataclass(frozen=True, config=STRICT)
class Plan:
    """The content of the file: the recipe and the changes for all, and the entries."""

    recipe: str | None = None
    set: tuple[str, ...] = ()
    entries: tuple[Entry, ...] = ()


# The heads of each entry, in the order of the file.
Heads = Mapping[Entry, Sequence[str]]


def read_plan(path: Path, changes: Sequence[str], only: Sequence[str] | None) -> Plan:
    """Read the file with changes for all, and give each entry its recipe. Raises InputError."""
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        entries = [build(Entry, item) for item in table.pop("entry", [])]
        plan = build(Plan, table)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    folders = [entry.folder for entry in entries]
    twice = sorted({name for name in folders if folders.count(name) > 1})
    if twice:
        raise InputError(f"{path}: two entries are called {twice[0]!r}; give each its name")
    names = [entry.name for entry in entries]
    unknown = sorted(set(only or ()) - set(names))
    if unknown:
        raise InputError(f"--only {unknown[0]!r}: no such entry; known: {', '.join(names)}")
    chosen = []
    for entry in entries:
        if only is not None and entry.name not in only:
            continue
        if entry.is_trained and entry.recipe is None:
            if plan.recipe is None:
                raise InputError(f"{path}: names no recipe to train {entry.name!r} by")
            entry = replace(entry, recipe=plan.recipe)
        chosen.append(entry)
    return Plan(plan.recipe, (*plan.set, *changes), tuple(chosen))


def recipe_of(entry: Entry, plan: Plan) -> Recipe:
    """Return the recipe of an entry with all changes. Raises InputError."""
    assert entry.recipe is not None  # read_plan has set it
    first, *others = read_stages(entry.recipe, [*plan.set, *entry.set])
    if others:
        raise InputError(f"{entry.recipe}: has several stages; expected a recipe of a single run")
    return first.recipe


def heads_of(entry: Entry, plan: Plan) -> tuple[str, ...]:
    """Return the heads of an entry. Raises InputError if it cannot be built."""
    if entry.method is not None:
        create_method(entry.method)
        return ("depth",)
    if entry.network is not None:
        if entry.network not in NETWORKS:
            raise InputError(f"no network {entry.network!r}; known: {', '.join(NETWORKS)}")
        with torch.device("meta"):
            return create_model(entry.network).heads
    if entry.onnx is not None:
        with Predictor(find_model(entry.onnx)) as predictor:
            return predictor.heads
    return build_network(recipe_of(entry, plan).model, None).heads


def network_of(entry: Entry, plan: Plan) -> Network:
    """Return the network of an entry with random weights."""
    name = entry.network or entry.onnx
    if name is not None:
        return create_model(name)
    return build_network(recipe_of(entry, plan).model, None)


def read_json(path: Path) -> dict[str, Any]:
    """Return a JSON document, or {} if it does not exist."""
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
