"""`ssdnet-info`: the metadata of a model file."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from runtime.bundled_models import list_bundled_models
from runtime.command import ERROR, print_result, reported_errors
from runtime.command_options import Version
from runtime.predictor import Predictor
from runtime.run.model_table import describe_bundled_models

INFO_FORMAT, INFO_VERSION = "ssdnet-info", "2.0"

app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)


@app.command(epilog="Exit codes: 0 done; 1 no model that this engine runs; 2 usage.")
def info(
    model: Annotated[
        str | None,
        typer.Argument(
            metavar="[NAME|PATH]",
            help="Name of a bundled model, or path of an ONNX file made by ssdnet-export. "
            "[default: list the bundled models]",
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print a JSON document instead of the table.")
    ] = False,
    _version: Version = False,
) -> None:
    """Print what a model file holds: heads, sizes, classes, terms, parity and digest."""
    with reported_errors("cpu"):
        if model is None:
            listed = json.dumps({"bundled_models": list_bundled_models()})
            text = listed if as_json else describe_bundled_models()
        else:
            with Predictor(model, warmup=0) as predictor:
                described = describe_model(predictor)
            text = json.dumps(described, indent=2) if as_json else model_table(described)
        if not print_result(text):
            raise typer.Exit(ERROR)


def describe_model(predictor: Predictor) -> dict[str, Any]:
    """Return the content of --json: the file, its tensors, and its metadata."""
    return {
        "format": INFO_FORMAT,
        "version": INFO_VERSION,
        "path": predictor.model,
        "bytes": Path(predictor.model).stat().st_size,
        "sha256": predictor.digest,
        "heads": predictor.heads,
        "fixed_size": None if predictor.free_size else predictor.size,
        "free_batch": predictor.free_batch,
        "metadata": asdict(predictor.contract),
    }


def model_table(described: dict[str, Any]) -> str:
    """The document of `describe_model` as a table, a line a fact."""
    metadata = described["metadata"]
    focal_px = metadata["canonical_focal_px"]
    focal = "none: plain metres" if focal_px is None else f"{focal_px:g} px"
    rows = metadata["trained_height"]
    giga_macs = metadata["giga_macs"]
    batch = "any number" if described["free_batch"] else "one"
    facts = [
        ("model", metadata["model_name"]),
        ("file", f"{described['path']} ({described['bytes'] / 1e6:.1f} MB)"),
        ("sha256", described["sha256"]),
        ("schema", metadata["schema_version"]),
        ("heads", ", ".join(described["heads"])),
        ("fixed size", _size(described["fixed_size"])),
        ("verified at", _size(metadata["native_size"])),
        ("trained for", "not known" if rows is None else f"{rows} rows"),
        ("frames a run", batch),
        ("stride", f"{metadata['stride']} px"),
        ("depth range", f"{metadata['max_depth_m']:g} m"),
        ("canonical focal length", focal),
        ("precision", metadata["precision"]),
        *_facts(metadata["quantization"]),
        ("GMACs a frame", "not counted" if giga_macs is None else f"{giga_macs:.3g}"),
        ("accuracy", "" if metadata["accuracy"] else "not measured"),
        *_facts(metadata["accuracy"]),
        ("terms", _plain(metadata["training"].get("terms", "not stated"))),
        ("trained on", _plain(metadata["training"].get("data", "not stated"))),
        ("made by", _plain(metadata["versions"])),
        ("checkpoint sha256", metadata["checkpoint_sha256"]),
        ("parity with PyTorch", "" if metadata["parity"] else "not measured"),
        *((f"  {head}", _plain(figures)) for head, figures in metadata["parity"].items()),
        ("classes", str(len(metadata["classes"]))),
        *(
            (f"  {index}", f"{entry['name']} #{bytes(entry['color']).hex()}")
            for index, entry in enumerate(metadata["classes"])
        ),
    ]
    return "\n".join(f"{_printable(name):24}{_printable(value)}".rstrip() for name, value in facts)


def _facts(document: dict[str, Any] | None) -> list[tuple[str, str]]:
    """Lines of an optional document; of a list of objects each on a line of its own."""
    lines = []
    for name, fact in (document or {}).items():
        listed = isinstance(fact, list) and all(isinstance(entry, dict) for entry in fact)
        lines += [(f"  {name}", _plain(entry)) for entry in (fact if listed else [fact])]
    return lines


def _size(size: tuple[int, int] | None) -> str:
    return "none" if size is None else f"{size[0]} x {size[1]}"


def _plain(value: Any) -> str:
    """A JSON value without the brackets of lists and objects."""
    if isinstance(value, dict):
        return ", ".join(f"{name} {_plain(entry)}" for name, entry in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(_plain, value))
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _printable(text: str) -> str:
    """Text with control characters escaped: a file must not control the terminal."""
    return "".join(
        char if char.isprintable() else char.encode("unicode_escape").decode() for char in text
    )
