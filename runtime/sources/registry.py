"""The kinds of sources. A new one: its file and a line here."""

import os
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

from runtime.errors import InputError
from runtime.sources.bag import BagSource
from runtime.sources.folders import FolderSource
from runtime.sources.kitti_raw import KittiRawSource
from runtime.sources.source import Source
from runtime.sources.video import VideoSource

SOURCES: dict[str, type[Source]] = {
    "kitti-raw": KittiRawSource,
    "video": VideoSource,
    "bag": BagSource,
    "folders": FolderSource,  # last: another kind may hold images, too
}


def detect_kind(path: Path) -> str:
    """Return the kind of source that a path is. Raises InputError with what is accepted."""
    for kind, source in SOURCES.items():
        if source.accepts(path):
            return kind
    fault = "is none of these" if os.path.exists(path) else "does not exist; give one of these"
    accepted = "; ".join(source.accepted for source in SOURCES.values())
    raise InputError(f"{path} {fault}: {accepted}. --source KIND:PATH names the kind")


def choose_source(text: str, **options: Any) -> Callable[[], Source]:
    """Return a function that opens a source, and that can be pickled.

    Args:
        text: "KIND:PATH".
        **options: those of the kind, see its class; None: not given.

    Returns:
        The function; it raises InputError for a path that is no recording of this kind.

    Raises:
        InputError: for an unknown kind, without a path, or for options that the kind does not take.
    """
    kind, _, path = text.partition(":")
    if kind not in SOURCES or not path:
        raise InputError(
            f"a source is KIND:PATH with one of the kinds {', '.join(SOURCES)}, got {text!r:.80}"
        )
    source = SOURCES[kind]
    given = {name: value for name, value in options.items() if value is not None}
    foreign = [name for name in given if name not in source.options]
    if foreign:
        raise InputError(
            f"a source of the kind {kind} takes {_as_options(source.options)}, not "
            f"{_as_options(foreign)}"
        )
    # The shell does not expand the home in KIND:~/PATH.
    return partial(source, Path(os.path.expanduser(path)), **given)


def open_source(text: str, **options: Any) -> Source:
    """Open the source that "KIND:PATH" names; arguments and errors as of `choose_source`."""
    return choose_source(text, **options)()


def _as_options(names: Iterable[str]) -> str:
    return ", ".join(f"--{name.replace('_', '-')}" for name in names)
