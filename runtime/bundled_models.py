"""The models that are installed with the engine, files `assets/NAME.onnx`."""

import os
from importlib import resources
from os import PathLike
from pathlib import Path

from runtime.checks import shown
from runtime.errors import ContractError, InputError
from runtime.model_file import load_model_file

#: The model that runs by default.
DEFAULT_MODEL = "ssdnet-lite"

_SUFFIX = ".onnx"

#: Column -> key in a row of `Contract.accuracy`, factor, digits.
_ACCURACY = {"mIoU %": ("miou", 100.0, 1), "MAE mm": ("mae_m", 1000.0, 0)}


def list_bundled_models() -> list[str]:
    """Return the names of the installed models."""
    return sorted(path.name.removesuffix(_SUFFIX) for path in _assets().glob(f"*{_SUFFIX}"))


def describe_bundled_models() -> str:
    """Return a table of the installed models: size, work and accuracy. Raises ContractError."""
    lines = [f"{'model':16}{'MB':>6}{'GMACs':>8}" + "".join(f"{name:>8}" for name in _ACCURACY)]
    notes: dict[str, None] = {}  # in the order of the columns, each once
    for model in list_bundled_models():
        file = load_model_file(find_model(model))
        contract = file.contract
        line = f"{model:16}{len(file.content) / 1e6:6.1f}{_cell(contract.giga_macs, 1)}"
        notes["GMACs of a frame of {} x {}".format(*contract.native_size)] = None
        for name, (key, factor, digits) in _ACCURACY.items():
            rows = (contract.accuracy or {}).get("rows", [])
            row = next((row for row in rows if row[key] is not None), None)
            line += _cell(row and factor * row[key], digits)
            if row is not None:
                notes[f"{name} on {row['data']}, LiDAR {row['lidar']}"] = None
        lines.append(line)
    return "\n".join([*lines, *notes, f"more, and terms: {_assets() / 'MODEL_CARD.md'}"])


def _cell(value: float | None, digits: int) -> str:
    return f"{'n/a':>8}" if value is None else f"{value:8.{digits}f}"


def find_model(model: str | bytes | PathLike[str] | None) -> Path:
    """Return the file of a model.

    Args:
        model: text that ends in ".onnx" or holds a folder, and any `PathLike`, is a path; other
            text is a name of `list_bundled_models`, even where the current folder has a file of
            that name ("./NAME" is that file); None = DEFAULT_MODEL.

    Returns:
        The path; whether there is a file is not checked.

    Raises:
        ContractError: for an unknown name.
        InputError: for anything that is neither text nor a path.
    """
    if isinstance(model, PathLike):
        return Path(os.fsdecode(model))
    if not isinstance(model, str | bytes | None):
        raise InputError(
            f"model must be a path or a name, got {type(model).__name__}: name an ONNX file, one "
            "of the bundled models, or none for the default one"
        )
    name = DEFAULT_MODEL if model is None else os.fsdecode(model)
    if name.lower().endswith(_SUFFIX) or os.path.dirname(name):
        return Path(name)
    known = list_bundled_models()
    if name not in known:
        raise ContractError(
            f"no bundled model is called {shown(name, 200)}; there are: "
            f"{', '.join(known) or 'none, so install ssdnet again'}. Name one of these, or an ONNX "
            'file by a path that ends in ".onnx" or holds a folder ("./FILE")'
        )
    return _assets() / f"{name}{_SUFFIX}"


def _assets() -> Path:
    return Path(str(resources.files("runtime"))) / "assets"
