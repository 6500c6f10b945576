"""The kinds of sources that are known. A new one: its file, and a line here."""

import inspect
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from runtime.errors import InputError
from runtime.stream.sources.bag import BagSource
from runtime.stream.sources.folders import FolderSource
from runtime.stream.sources.kitti_raw import KittiRawSource
from runtime.stream.sources.source import Source
from runtime.stream.sources.video import VideoSource
from runtime.stream.sources.virtual_kitti import VirtualKittiSource

#: Kind -> what makes a source of a path; its keyword parameters are the options of the kind.
SOURCES: dict[str, Callable[..., Source]] = {
    "folders": FolderSource,
    "kitti-raw": KittiRawSource,
    "vkitti": VirtualKittiSource,
    "video": VideoSource,
    "bag": BagSource,
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
    parameters = inspect.signature(SOURCES[kind]).parameters.values()
    known = [parameter.name for parameter in parameters if parameter.kind is parameter.KEYWORD_ONLY]
    given = {name: value for name, value in options.items() if value is not None}
    foreign = [name for name in given if name not in known]
    if foreign:
        raise InputError(
            f"a source of the kind {kind} takes {_as_options(known)}, not {_as_options(foreign)}"
        )
    return partial(SOURCES[kind], Path(path), **given)


def open_source(text: str, **options: Any) -> Source:
    """Open the source that "KIND:PATH" names, see `choose_source`. Raises InputError."""
    return choose_source(text, **options)()


def _as_options(names: list[str]) -> str:
    return ", ".join(f"--{name.replace('_', '-')}" for name in names)
