"""The kinds of sources and their options. A new kind needs a file and a line in `SOURCES`."""

import os
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from runtime.base.arguments import check_number, shown
from runtime.base.errors import InputError
from runtime.geometry.motion import MIDDLE_AFTER, check_scan_stamp
from runtime.geometry.poses import PoseFrame, check_pose_frame
from runtime.geometry.rig import DEFAULT_RIG, Rig
from runtime.recordings.bag import BagSource
from runtime.recordings.folders import FolderSource
from runtime.recordings.kitti_raw import KittiRawSource
from runtime.recordings.layouts import KittiObjectSource, OneFolderSource
from runtime.recordings.source import Source
from runtime.recordings.video import VideoSource

SOURCES: dict[str, type[Source]] = {
    "kitti-raw": KittiRawSource,
    "kitti-object": KittiObjectSource,
    "video": VideoSource,
    "bag": BagSource,
    "one-folder": OneFolderSource,
    "folders": FolderSource,  # last, because folders of other kinds contain images, too
}


class SourceKey(NamedTuple):
    """A key of --source.

    Attributes:
        expected: what its value has to be, in words.
        read: converts the text of a value; raises ValueError or InputError.
    """

    expected: str
    read: Callable[[str], Any]


def _number(what: str, least: float, most: float, kind: type[float] = float) -> SourceKey:
    expected = f"{what}, {least:g} to {most:g}"
    return SourceKey(expected, lambda text: kind(check_number("", kind(text), least, most)))


def _text(text: str) -> str:
    if not text:
        raise ValueError
    return text


def _path(text: str) -> Path:
    return Path(os.path.expanduser(_text(text)))  # the shell does not expand "~" in KEY=~/FILE


_TRUTH = SourceKey("true or false", lambda text: bool(("false", "true").index(text)))
# Keywords of the sources' classes and what --source takes for them. All other keywords are flags.
SOURCE_KEYS = {
    "camera": _number("the number of a camera of KITTI", 0, 3, int),
    "depth_scale": _number("units per metre", 1e-3, 1e6),
    "point_columns": _number("the number of float32 per point", 3, 10**6, int),
    "timestamps": SourceKey("a file", _path),
    "pose_frame": SourceKey(" or ".join(PoseFrame), check_pose_frame),
    "scan_stamp": SourceKey(" or ".join(MIDDLE_AFTER), check_scan_stamp),
    "point_time_column": _number("the number of a column after x, y, z", 3, 10**6, int),
    "rectified": _TRUTH,
    "registered": _TRUTH,
    "image_topic": SourceKey("a topic, or those of several cameras joined by +", _text),
    "depth_topic": SourceKey("a topic or none", _text),
    "info_topic": SourceKey("a topic", _text),
    "pose_topic": SourceKey("a topic, none or odometry", _text),
}
_PATHS = ("depth", "points", "poses")  # options whose values are paths
_RIG_NAMES = {each.name for each in fields(Rig)}


class SourcePath(NamedTuple):
    """A recording whose kind is known, with the values of the keys of --source.

    Attributes:
        kind: one of SOURCES.
        path: path of the recording.
        keys: options of the source.
        rig: the sensors of the car, as far as they are known.
    """

    kind: str
    path: Path
    keys: Mapping[str, Any]
    rig: Rig = DEFAULT_RIG


def detect_source(path: Path) -> SourcePath:
    """Find the kind of source for a path. Raises InputError, which names the accepted kinds."""
    for kind, source in SOURCES.items():
        if source.accepts(path):
            return SourcePath(kind, path, {})
    fault = "is none of these" if os.path.exists(path) else "does not exist; give one of these"
    accepted = "; ".join(source.accepted for source in SOURCES.values())
    raise InputError(f"{path} {fault}: {accepted}; or name the kind with `kind=`")


def parse_source(text: str) -> SourcePath:
    """Read "KIND:PATH" or "KIND:PATH,KEY=VALUE,...".

    The text is split at each comma that is followed by a known key and "=". The path and the values
    may contain other commas and equals signs.

    Raises:
        InputError: if the text has another form, the kind or a key is unknown, a key is given
            twice, or a value is wrong.
    """
    kind, _, rest = text.partition(":")
    if kind not in SOURCES or not rest or rest.startswith(","):
        raise InputError(
            f"a source is KIND:PATH[,KEY=VALUE...] with one of the kinds {', '.join(SOURCES)}, got "
            f"{shown(text)}"
        )
    names = keys_of(kind)
    path, *pairs = re.split(f",({'|'.join(names)})=", rest) if names else [rest]
    takes = f"a source of the kind {kind} takes the keys {', '.join(names) or '(none)'}"
    for part in (path, *pairs[1::2]):
        unknown = re.search(r",([\w-]+)=", part)
        if unknown and not os.path.lexists(os.path.expanduser(part)):
            raise InputError(f"{takes}, not {unknown[1]}, and there is no file {shown(part)}")
    keys: dict[str, Any] = {}
    for name, value in zip(pairs[::2], pairs[1::2], strict=True):
        if name in keys:
            raise InputError(f"{name} is given twice, the second time as {shown(value)}")
        keys[name] = _read_key(name, value, takes)
    rig = Rig(**{name: keys.pop(name) for name in _RIG_NAMES & keys.keys()})
    return SourcePath(kind, _path(path), keys, rig)


def _read_key(name: str, value: str, takes: str) -> Any:
    """Convert the text of a key's value, from --source or from Python. Raises InputError."""
    expected, read = SOURCE_KEYS[name]
    try:
        return read(value)
    except (ValueError, InputError) as error:
        raise InputError(f"{name} must be {expected}, got {shown(value)}: {takes}") from error


def keys_of(kind: str) -> tuple[str, ...]:
    """Return the options of a kind of source that --source takes as keys."""
    return tuple(name for name in _taken(kind) if name in SOURCE_KEYS)


def _taken(kind: str) -> tuple[str, ...]:
    """The options of a kind of source and the attributes of `Rig` that it uses."""
    return (*SOURCES[kind].options, *SOURCES[kind].rig_options)


def choose_source(
    kind: str, path: str | Path, rig: Rig = DEFAULT_RIG, **options: Any
) -> Callable[[], Source]:
    """Return a function that opens a source and can be pickled.

    Args:
        kind: one of SOURCES, or "auto", the kind that accepts the path.
        path: path of the recording.
        rig: the sensors of the car, as far as the recording does not describe them itself.
        **options: options of the kind, see its class. Paths and the keys of --source may be given
            as text; None stands for an option that is not given.

    Returns:
        The function, which raises InputError if the path is not a recording of this kind.

    Raises:
        InputError: if the kind is unknown, or does not use one of the options or attributes of the
            rig.
    """
    kind = detect_source(Path(path)).kind if kind == "auto" else kind
    given = _checked(kind, rig, options)
    return partial(SOURCES[kind], Path(path), rig, **given)


def choose_cameras(
    kind: str, path: str | Path, rig: Rig = DEFAULT_RIG, **options: Any
) -> Callable[[], dict[str, Source]]:
    """Return a function that opens a source for each camera; see `Source.open_cameras`."""
    given = _checked(kind, rig, options)
    return partial(SOURCES[kind].open_cameras, Path(path), rig, **given)


def open_source(kind: str, path: str | Path, rig: Rig = DEFAULT_RIG, **options: Any) -> Source:
    """Open a source; arguments and errors are those of `choose_source`."""
    return choose_source(kind, path, rig, **options)()


def _checked(kind: str, rig: Rig, options: Mapping[str, Any]) -> dict[str, Any]:
    """The options that are given. Raises InputError in the cases of `choose_source`."""
    if kind not in SOURCES:
        raise InputError(
            f"unknown kind of source {shown(kind)}: give one of the kinds {', '.join(SOURCES)}, or "
            "auto"
        )
    if moved := sorted(_RIG_NAMES & options.keys()):
        raise InputError(f"{moved[0]} describes the car: give Rig({moved[0]}=...) after the path")
    given = {name: value for name, value in options.items() if value is not None}
    takes = f"a source of the kind {kind} takes {_as_options(_taken(kind))}"
    if foreign := [name for name in (*given, *rig.given) if name not in _taken(kind)]:
        raise InputError(f"{takes}, not {_as_options(foreign)}")
    for name, value in given.items():
        if isinstance(value, str) and name in SOURCE_KEYS:
            given[name] = _read_key(name, value, takes)
        elif isinstance(value, str) and name in _PATHS:
            given[name] = Path(value)
    return given


def _as_options(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}=`" for name in names)
