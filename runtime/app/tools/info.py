"""`ssdnet-info`: the metadata of a model file."""

import json
from dataclasses import asdict
from typing import Annotated, Any

import typer

from runtime.app.run.model_table import describe_bundled_models
from runtime.command.options import Version
from runtime.command.process import print_result, reported_errors
from runtime.engine.predictor import Predictor

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
    """Print what a model file holds: heads, sizes, classes, terms, parity and digest."""
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
        "sha256": predictor.digest,
        "heads": predictor.heads,
        "fixed size": "none" if predictor.free_size else predictor.size,
        "frames a run": "any number" if predictor.free_batch else "one",
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
