"""The kinds of sources. A new one: its file and a line here."""

import os
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from runtime.checks import shown
from runtime.errors import InputError
from runtime.sources.bag import BagSource
from runtime.sources.folders import FolderSource
from runtime.sources.kitti_object import KittiObjectSource
from runtime.sources.kitti_raw import KittiRawSource
from runtime.sources.one_folder import OneFolderSource
from runtime.sources.source import Source
from runtime.sources.source_keys import SOURCE_KEYS, read_keys
from runtime.sources.video import VideoSource

SOURCES: dict[str, type[Source]] = {
    "kitti-raw": KittiRawSource,
    "kitti-object": KittiObjectSource,
    "video": VideoSource,
    "bag": BagSource,
    "one-folder": OneFolderSource,
    "folders": FolderSource,  # last: folders of other kinds contain images, too
}


_PATHS = ("depth", "points", "calibration", "timestamps", "poses")  # options that are paths


class SourcePath(NamedTuple):
    """A recording whose kind is known, and the options that --source has as keys."""

    kind: str
    path: Path
    keys: Mapping[str, Any] = MappingProxyType({})


def detect_source(path: Path) -> SourcePath:
    """Detect the kind of source of a path. Raises InputError with the accepted kinds."""
    for kind, source in SOURCES.items():
        if source.accepts(path):
            return SourcePath(kind, path)
    fault = "is none of these" if os.path.exists(path) else "does not exist; give one of these"
    accepted = "; ".join(source.accepted for source in SOURCES.values())
    raise InputError(f"{path} {fault}: {accepted}. --source KIND:PATH names the kind")


def parse_source(text: str) -> SourcePath:
    """Read "KIND:PATH" or "KIND:PATH,KEY=VALUE,...", see `read_keys`.

    Raises InputError for another form, an unknown kind or key, and a wrong value.
    """
    kind, _, rest = text.partition(":")
    if kind not in SOURCES or not rest or rest.startswith(","):
        raise InputError(
            f"a source is KIND:PATH[,KEY=VALUE...] with one of the kinds {', '.join(SOURCES)}, got "
            f"{shown(text)}"
        )
    path, keys = read_keys(kind, keys_of(kind), rest)
    # The shell does not expand the home in KIND:~/PATH.
    return SourcePath(kind, Path(os.path.expanduser(path)), keys)


def keys_of(kind: str) -> tuple[str, ...]:
    """Return the options of a kind of source that --source takes as keys."""
    return tuple(name for name in SOURCES[kind].options if name in SOURCE_KEYS)


def choose_source(kind: str, path: str | Path, **options: Any) -> Callable[[], Source]:
    """Return a function that opens a source, and that can be pickled.

    Args:
        kind: of SOURCES.
        path: of the recording.
        **options: those of the kind, see its class, paths as text, too; None: not given.

    Returns:
        The function; it raises InputError for a path that is no recording of this kind.

    Raises:
        InputError: for an unknown kind, or for options that the kind does not take.
    """
    given = _checked(kind, options)
    return partial(SOURCES[kind], Path(path), **given)


def choose_cameras(kind: str, path: str | Path, **options: Any) -> Callable[[], dict[str, Source]]:
    """Return what opens a source for each camera; see `choose_source`, `Source.open_cameras`."""
    given = _checked(kind, options)
    return partial(SOURCES[kind].open_cameras, Path(path), **given)


def open_source(kind: str, path: str | Path, **options: Any) -> Source:
    """Open a source; arguments and errors as in `choose_source`."""
    return choose_source(kind, path, **options)()


def _checked(kind: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """The options that are given. Raises InputError as `choose_source`."""
    if kind not in SOURCES:
        raise InputError(
            f"unknown kind of source {shown(kind)}: give one of the kinds {', '.join(SOURCES)}"
        )
    takes = SOURCES[kind].options
    given = {
        name: Path(value) if name in _PATHS and isinstance(value, str) else value
        for name, value in options.items()
        if value is not None
    }
    if foreign := [name for name in given if name not in takes]:
        raise InputError(
            f"a source of the kind {kind} takes {_as_options(takes)}, not {_as_options(foreign)}"
        )
    return given


def _as_options(names: Iterable[str]) -> str:
    return ", ".join(
        f"{name}=" if name in SOURCE_KEYS else f"--{name.replace('_', '-')}" for name in names
    )
