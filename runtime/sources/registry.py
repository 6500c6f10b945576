"""The kinds of sources that are known. A new one: its file, and a line here."""

import inspect
import os
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from runtime.errors import InputError
from runtime.sources.source import Source

#: Kind -> file and class of the source, which is loaded when it is asked for. The class takes a
#: path; its keyword parameters are the options of the kind.
SOURCES = {
    "folders": ("folders", "FolderSource"),
    "kitti-raw": ("kitti_raw", "KittiRawSource"),
    "vkitti": ("virtual_kitti", "VirtualKittiSource"),
    "video": ("video", "VideoSource"),
    "bag": ("bag", "BagSource"),
}


def choose_source(text: str, **options: Any) -> Callable[[], Source]:
    """Return what opens the source that "KIND:PATH" names.

    options: of the kind, see its class; those that are None were not given
    Raises InputError for an unknown kind, without a path, and for options that the kind does not
    take. Opening may raise it for what the path holds.
    """
    kind, _, path = text.partition(":")
    if kind not in SOURCES or not path:
        raise InputError(
            f"a source is KIND:PATH with one of the kinds {', '.join(SOURCES)}, got {text!r:.80}"
        )
    module, name = SOURCES[kind]
    make: Callable[..., Source] = getattr(import_module(f"{__package__}.{module}"), name)
    parameters = inspect.signature(make).parameters.values()
    known = [parameter.name for parameter in parameters if parameter.kind is parameter.KEYWORD_ONLY]
    given = {name: value for name, value in options.items() if value is not None}
    foreign = [name for name in given if name not in known]
    if foreign:
        raise InputError(
            f"a source of the kind {kind} takes {_as_options(known)}, not {_as_options(foreign)}"
        )
    # Of KIND:~/PATH no shell expands the home.
    return partial(make, Path(os.path.expanduser(path)), **given)


def open_source(text: str, **options: Any) -> Source:
    """Open the source that "KIND:PATH" names, see `choose_source`. Raises InputError."""
    return choose_source(text, **options)()


def _as_options(names: list[str]) -> str:
    return ", ".join(f"--{name.replace('_', '-')}" for name in names)
