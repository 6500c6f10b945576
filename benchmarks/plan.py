"""Networks trained, exported and scored from one file: what the programs beside it share.

Whatever is there already, made with the same settings, is not made again.
"""

import argparse
import hashlib
import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from pydantic.dataclasses import dataclass

from export.exporter import export_checkpoint
from runtime.bundled_models import find_model
from runtime.errors import InputError
from runtime.io.atomic_write import atomic_write
from runtime.model_file import load_model_file
from training.datasets.source_recipe import SourceRecipe
from training.evaluation.evaluate import evaluate
from training.initial_weights import find_weights
from training.lidar.split import LidarInput
from training.limits import STRICT
from training.loop import train
from training.recipe import Recipe, build, read_recipe
from training.recipe_files import find_recipe
from training.run_folder import FINAL, RECIPE, name_weights, require_same
from training.stop_signal import StopSignal

ONNX, SCORES = "model.onnx", "scores.json"

#: What the exported files name as their own size, and are verified at; they take any.
_OWN_SIZE = (128, 416)

#: Set -> its recipe, whose path is below --data, and the LiDARs it is scored with.
Sets = Mapping[str, tuple[SourceRecipe, Sequence[str]]]
#: "set lidar" -> figure -> value.
Scores = dict[str, dict[str, float]]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Candidate:
    """What is compared: trained by a recipe with its changes, or an ONNX file."""

    name: str
    #: In place of the plan's.
    recipe: str | None = None
    set: tuple[str, ...] = ()
    init: str | None = None
    onnx: str | None = None

    @property
    def folder(self) -> str:
        """Its name as that of a folder."""
        return re.sub(r"[^\w.-]+", "-", self.name)

    @property
    def is_trained(self) -> bool:
        """Whether it needs a recipe."""
        return self.onnx is None


@dataclass(frozen=True, config=STRICT)
class Plan:
    """The file: changes for all, and the candidates."""

    recipe: str | None = None
    set: tuple[str, ...] = ()
    candidates: tuple[Candidate, ...] = ()


def read_plan(
    path: Path,
    changes: Sequence[str],
    only: Sequence[str] | None,
    *,
    onnx: Sequence[str] = (),
    kind: type[Candidate] = Candidate,
) -> Plan:
    """Read the file; add changes for all and ONNX files. Raises InputError.

    ``kind`` is what its candidates are. Each gets the recipe that it is trained by.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        own = [build(kind, item) for item in table.pop("candidate", [])]
        plan = build(Plan, table)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {error}.") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    candidates = [*own, *(kind(name=Path(text).stem, onnx=text) for text in onnx)]
    folders = [item.folder for item in candidates]
    twice = sorted({name for name in folders if folders.count(name) > 1})
    if twice:
        raise InputError(f"{path}: two candidates are called {twice[0]!r}; give each its name.")
    unknown = sorted(set(only or ()) - {item.name for item in candidates})
    if unknown:
        known = ", ".join(item.name for item in candidates)
        raise InputError(f"--only {unknown[0]!r}: no such candidate; known: {known}.")
    chosen = []
    for item in candidates:
        if only is not None and item.name not in only:
            continue
        if item.is_trained and item.recipe is None:
            if plan.recipe is None:
                raise InputError(f"{path}: names no recipe to train {item.name!r} by.")
            item = replace(item, recipe=plan.recipe)
        chosen.append(item)
    return Plan(plan.recipe, (*plan.set, *changes), tuple(chosen))


def read_candidate(candidate: Candidate, plan: Plan) -> Recipe:
    """Return the recipe that a candidate is trained by, with all changes. Raises InputError."""
    assert candidate.recipe is not None  # read_plan saw to it
    return read_recipe(find_recipe(candidate.recipe), [*plan.set, *candidate.set])


def find_or_make(
    candidate: Candidate, plan: Plan, arguments: argparse.Namespace, stop: StopSignal
) -> Path | None:
    """Return a candidate's ONNX file, trained and exported if it is not there; None if stopped."""
    if candidate.onnx is not None:
        return find_model(candidate.onnx)
    recipe = read_candidate(candidate, plan)
    init = None if candidate.init is None else find_weights(candidate.init)
    out = arguments.runs / candidate.folder
    if (out / FINAL).is_file():
        _require_same(recipe, init, out)
        checkpoint = out / FINAL
    else:
        checkpoint = train(
            recipe, data=arguments.data, out=out, init=init, device=arguments.device, stop=stop
        )
    if stop():
        print(f"stopped; the same command goes on from {checkpoint}")
        return None
    onnx, digest = out / ONNX, hashlib.sha256(checkpoint.read_bytes()).hexdigest()
    if not onnx.is_file() or load_model_file(onnx).contract.checkpoint_sha256 != digest:
        export_checkpoint(checkpoint, onnx, size=_OWN_SIZE, dynamic=True, overwrite=True)
    return onnx


def _require_same(recipe: Recipe, init: Path | None, out: Path) -> None:
    """Raise InputError if a finished run was of another recipe: a table mixes no settings."""
    before = json.loads((out / RECIPE).read_text(encoding="utf-8"))
    now = {"recipe": asdict(recipe), "init": None if init is None else name_weights(init)}
    require_same(before, now, out / RECIPE)


def find_or_score(
    out: Path, sets: Sets, arguments: argparse.Namespace, *, onnx: Path | None, method: str = ""
) -> Scores:
    """Return the figures of a file, or of a classical method, on the sets; kept in ``out``."""
    settings = {
        "scored": method if onnx is None else load_model_file(onnx).sha256,
        "sets": {name: [asdict(recipe), list(lidars)] for name, (recipe, lidars) in sets.items()},
        "limit": arguments.limit,
    }
    settings = json.loads(json.dumps(settings))  # as it is read back
    path = out / SCORES
    if path.is_file():
        known = json.loads(path.read_text(encoding="utf-8"))
        if known["settings"] == settings:
            return dict(known["figures"])
    result: Scores = {}
    for name, (recipe, lidars) in sets.items():
        rows = evaluate(
            [] if onnx is None else [onnx],
            [recipe],
            lidars=[LidarInput.parse(lidar) for lidar in lidars],
            faults=["none"],
            methods=[method] if onnx is None else [],
            threads=arguments.threads,
            limit=arguments.limit,
        )
        result |= {f"{name} {row.lidar}": row.figures for row in rows}
    out.mkdir(parents=True, exist_ok=True)
    document: dict[str, Any] = {"settings": settings, "figures": result}
    atomic_write(path, json.dumps(document, indent=2).encode())
    return result
