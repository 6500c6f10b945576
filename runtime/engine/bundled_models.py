"""The models that are installed with the engine, in files `assets/NAME.onnx`."""

import os
from importlib import resources
from os import PathLike
from pathlib import Path

from runtime.base.arguments import shown
from runtime.base.errors import InputError

# The model that runs by default.
DEFAULT_MODEL = "ssdnet-lite"

_SUFFIX = ".onnx"


def list_bundled_models() -> list[str]:
    """Return the names of the installed models."""
    return sorted(path.name.removesuffix(_SUFFIX) for path in assets_folder().glob(f"*{_SUFFIX}"))


def find_model(model: str | PathLike[str] | None) -> Path:
    """Return the file of a model.

    Args:
        model: a path or a name. Any `PathLike`, and text that ends in ".onnx" or contains a folder,
            is a path. Other text is a name from `list_bundled_models`, even if the current folder
            has a file of that name ("./NAME" is that file). None: `DEFAULT_MODEL`.

    Returns:
        The path. This function does not check that the file exists.

    Raises:
        InputError: for an unknown name, and for anything that is neither text nor a path.
    """
    if isinstance(model, PathLike):
        return Path(model)
    if not isinstance(model, str | None):
        raise InputError(
            f"model must be a path or a name, got {type(model).__name__}: name an ONNX file, one "
            "of the bundled models, or none for the default one"
        )
    name = DEFAULT_MODEL if model is None else model
    if name.lower().endswith(_SUFFIX) or os.path.dirname(name):
        return Path(name)
    known = list_bundled_models()
    if name not in known:
        raise InputError(
            f"no bundled model is called {shown(name, 200)}; there are: "
            f"{', '.join(known) or 'none, so install ssdnet again'}: name one of these, or an ONNX "
            'file by a path that ends in ".onnx" or holds a folder ("./FILE")'
        )
    return assets_folder() / f"{name}{_SUFFIX}"


def assets_folder() -> Path:
    """Return the folder of the bundled models and their card."""
    return Path(str(resources.files("runtime"))) / "assets"
