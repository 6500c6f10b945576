"""The models that are installed with the engine: each a file `assets/NAME.onnx`."""

import os
from importlib import resources
from os import PathLike
from pathlib import Path

from runtime.errors import ContractError, InputError

#: What runs where no model is named.
DEFAULT_MODEL = "ssdnet-lite"

_SUFFIX = ".onnx"


def list_bundled_models() -> list[str]:
    """Return the names of the installed models."""
    return sorted(path.name.removesuffix(_SUFFIX) for path in _assets().glob(f"*{_SUFFIX}"))


def find_model(model: str | bytes | PathLike[str] | None) -> Path:
    """Return the file of a model that is named by a path, by its name, or not at all.

    None is DEFAULT_MODEL. Text that ends in ".onnx" or holds a folder, and any `PathLike`, is a
    path; other text is a name of `list_bundled_models`, also where a file of that name lies in the
    current folder ("./NAME" is that file): what runs does not depend on where it is started.

    Raises ContractError for an unknown name and InputError for what is no text. A path is not
    looked at.
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
            f"no bundled model is called {name[:200]!r}; there are: "
            f"{', '.join(known) or 'none, so install ssdnet again'}. Name one of these, or an ONNX "
            'file by a path that ends in ".onnx" or holds a folder ("./FILE")'
        )
    return _assets() / f"{name}{_SUFFIX}"


def _assets() -> Path:
    return Path(str(resources.files("runtime"))) / "assets"
