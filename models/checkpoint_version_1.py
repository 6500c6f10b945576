"""Conversion of checkpoints of version 1, for one release; then this file goes.

In version 1 one class, `SSDNet`, was both of today's networks.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from models.checkpoint import VERSION, read_document, restore, write_document
from runtime.checks import shown
from runtime.errors import CheckpointError, OutputError

#: Network -> fields that only version 1 had, with the values that select this network.
_FIXED: Mapping[str, Mapping[str, object]] = {
    "SSDNet": {
        "encoder_block": "plain",
        "skip_fusion": "concat",
        "semantic_refine_channels": 0,
        "depth_surfaces": False,
        "depth_refine_channels": 0,
        "regressed_depth_m": None,
        "valid_mask_input": False,
        "global_context": False,
    },
    "SSDNetLite": {
        "encoder_block": "residual",
        "skip_fusion": "add",
        "use_rgb": True,
        "use_sparse_depth": True,
        "valid_mask_input": True,
        "sparse_depth_gain": 1.0,
    },
}
#: Beginnings of the names of weights of `SSDNetLite`.
_RENAMED = {
    "stem.": "encoder.stem.",
    "encoder.context.": "context.",
    "surface_stem.": "surface_depth.embed.",
    "surface_project.": "surface_depth.project.",
    "surface_semantics.": "surface_depth.semantics.",
    "depth_refine.": "surface_depth.refinement.",
    "surface_head.": "surface_depth.head.",
}


def convert_checkpoint(old: Path, new: Path) -> None:
    """Convert a version 1 checkpoint: its weights, configuration and training facts.

    Every value of the weights stays as it is.

    Args:
        old: a ``model.pt`` or ``best.pt`` of version 1.
        new: the file to write, of this version.

    Raises:
        CheckpointError: if the file cannot be read or converted, or has the state of an unfinished
            run.
        OutputError: if ``new`` exists.
    """
    if new.exists():
        raise OutputError(f"{new} exists. Give the path of a new file.")
    document = read_document(old)
    if not _is_same(document.get("version"), 1):
        raise CheckpointError(
            f"{old}: checkpoint version {shown(document.get('version'))}; only version 1 can be "
            "converted. Use the file as it is."
        )
    if document["trainer"]:
        raise CheckpointError(
            f"{old}: the state of an unfinished run, which only the release that started it can "
            "resume. Finish the run with that release and convert its model.pt, or train again."
        )
    # The first files do not name their network: there was only one.
    converted = {**document, "version": VERSION, "network": document.get("network", "SSDNet")}
    if converted["network"] == "SSDNet":
        converted |= _split_family(document, old)
    model = restore(converted, old).model
    write_document(new, {**converted, "config": model.config.to_dict()})


def _split_family(document: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Return the network's name, its configuration and its weights."""
    config = {**_FIXED["SSDNet"], **document["config"]}  # fields that a file lacks
    network = "SSDNet" if config["encoder_block"] == "plain" else "SSDNetLite"
    fixed = {**_FIXED[network], "depth_surfaces": network != "SSDNet" and config["depth_head"]}
    other = [key for key, value in fixed.items() if not _is_same(config.get(key, value), value)]
    if other:
        raise CheckpointError(
            f"{path}: no network of this release supports its values of {', '.join(other)}. Use "
            "it with the release that wrote it, or train again."
        )
    kept = {key: value for key, value in config.items() if key not in fixed}
    weights = document["weights"]
    if network == "SSDNetLite":
        weights = {_rename(str(name)): value for name, value in weights.items()}
    return {"network": network, "config": kept, "weights": weights}


def _rename(name: str) -> str:
    for before, now in _RENAMED.items():
        if name.startswith(before):
            return now + name.removeprefix(before)
    return name


def _is_same(value: object, expected: object) -> bool:
    # A tensor has no truth value.
    return isinstance(value, bool | int | float | str | None) and value == expected
