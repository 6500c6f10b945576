"""`ssdnet-info`: the metadata of a model file."""

import json
from collections import defaultdict
from dataclasses import asdict
from typing import Annotated, Any

import typer

from runtime.command.options import Version
from runtime.command.process import print_result, reported_errors
from runtime.contract.model_file import load_model_file
from runtime.engine.bundled_models import assets_folder, find_model, list_bundled_models
from runtime.engine.predictor import Predictor

# For each column: key in a row of `Contract.accuracy`, factor, digits.
_ACCURACY = {"mIoU %": ("miou", 100.0, 1), "MAE mm": ("mae_m", 1000.0, 0)}

app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)


@app.command(epilog="Exit codes: 0 done; 1 no model that this engine runs; 2 usage.")
def info(
    model: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME|PATH",
            help="Name of a bundled model, or path of an ONNX file made by ssdnet-export. "
            "[default: list the bundled models]",
        ),
    ] = None,
    _version: Version = False,
) -> None:
    """Print what a model file holds: heads, sizes, classes, terms, parity and SHA-256."""
    with reported_errors("cpu"):
        if model is None:
            text = describe_bundled_models()
        else:
            with Predictor(model, warmup=0) as predictor:
                text = describe_model(predictor)
        print_result(text)


def describe_model(predictor: Predictor) -> str:
    """The file, its tensors, and its metadata as a table with a line for each fact."""
    metadata = asdict(predictor.contract)
    classes = metadata.pop("classes")
    metadata["training"].pop("recipe", None)  # it is a page of text
    facts = {
        "file": str(predictor.model.path),
        "megabytes": predictor.model.path.stat().st_size / 1e6,
        "sha256": predictor.model.sha256,
        "heads": predictor.heads,
        "fixed size": "none" if predictor.model.size is None else predictor.size,
        "frames a run": "any number" if predictor.model.free_batch else "one",
        **{name.replace("_", " "): fact for name, fact in metadata.items()},
        "classes": {
            index: f"{entry['name']} #{bytes(entry['color']).hex()}"
            for index, entry in enumerate(classes)
        },
    }
    lines = []
    for name, fact in facts.items():
        entries = fact if isinstance(fact, dict) else {}
        lines.append((name, "" if entries else _plain(fact)))
        for key, entry in entries.items():
            rows = entry if key == "rows" else [entry]
            lines += [(f"  {key}", _plain(row)) for row in rows]
    # Line feeds are removed, so that a text in the file cannot look like another line.
    return "\n".join(f"{name:24}{' '.join(fact.split())}".rstrip() for name, fact in lines)


def _plain(fact: Any) -> str:
    return fact if isinstance(fact, str) else json.dumps(fact, ensure_ascii=False)


def describe_bundled_models() -> str:
    """Return a table of the installed models: size, work and accuracy. Raises ContractError."""
    lines = [f"{'model':16}{'MB':>6}{'GMACs':>8}" + "".join(f"{name:>8}" for name in _ACCURACY)]
    models = list_bundled_models()
    notes = defaultdict[str, list[str]](list)  # the models that a note is about
    for model in models:
        file = load_model_file(find_model(model))
        contract = file.contract
        line = f"{model:16}{len(file.content) / 1e6:6.1f}{_cell(contract.giga_macs, 1)}"
        notes["GMACs of a frame of {} x {}".format(*contract.native_size)].append(model)
        for name, (key, factor, digits) in _ACCURACY.items():
            rows = (contract.accuracy or {}).get("rows", [])
            row = next((row for row in rows if row[key] is not None), None)
            line += _cell(row and factor * row[key], digits)
            if row is not None:
                notes[f"{name} on {row['data']}, LiDAR {row['lidar']}"].append(model)
        lines.append(line)
    for note, named in notes.items():
        lines.append(note if len(named) == len(models) else f"{note}: {', '.join(named)}")
    return "\n".join([*lines, f"more, and terms: {assets_folder() / 'MODEL_CARD.md'}"])


def _cell(value: float | None, digits: int) -> str:
    return f"{'n/a':>8}" if value is None else f"{value:8.{digits}f}"
