"""The keys of `--source KIND:PATH,KEY=VALUE`: options of a source that are no flags."""

import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from runtime.checks import check_number, shown
from runtime.errors import InputError
from runtime.geometry.motion import MIDDLE_AFTER, check_scan_stamp
from runtime.geometry.poses import PoseFrame


class SourceKey(NamedTuple):
    """A key.

    Attributes:
        expected: what its value is, in words.
        read: returns the value of a text; ValueError or InputError if it is another.
    """

    expected: str
    read: Callable[[str], Any]


def _number(what: str, least: float, most: float, kind: type[float] = float) -> SourceKey:
    expected = f"{what}, {least:g} to {most:g}"
    return SourceKey(expected, lambda text: kind(check_number("", kind(text), least, most)))


def _read_text(text: str) -> str:
    if not text:
        raise ValueError
    return text


def _read_path(text: str) -> Path:
    return Path(os.path.expanduser(_read_text(text)))  # the shell does not expand KEY=~/FILE


_TRUTH = SourceKey("true or false", lambda text: bool(("false", "true").index(text)))


#: Keyword of the class of a source -> what --source takes for it. The other keywords are flags.
SOURCE_KEYS = {
    "camera": _number("the number of a camera of KITTI", 0, 3, int),
    "depth_scale": _number("units per metre", 1e-3, 1e6),
    "point_columns": _number("the number of float32 per point", 3, 10**6, int),
    "timestamps": SourceKey("a file", _read_path),
    "pose_frame": SourceKey(" or ".join(PoseFrame), PoseFrame),
    "scan_stamp": SourceKey(" or ".join(MIDDLE_AFTER), check_scan_stamp),
    "point_time_column": _number("the number of a column after x, y, z", 3, 10**6, int),
    "rectified": _TRUTH,
    "registered": _TRUTH,
    "image_topic": SourceKey("a topic, or those of several cameras joined by +", _read_text),
    "depth_topic": SourceKey("a topic or none", _read_text),
    "info_topic": SourceKey("a topic", _read_text),
    "pose_topic": SourceKey("a topic or none", _read_text),
}


def read_keys(kind: str, names: Sequence[str], text: str) -> tuple[str, dict[str, Any]]:
    """Read "PATH" or "PATH,KEY=VALUE,...".

    The text is split at each comma that a known key and "=" follow. Path and values may hold other
    commas and equals signs.

    Args:
        kind: of the source, for errors.
        names: the keys that it takes.
        text: what follows the kind.

    Returns:
        The path, and the values by their keys.

    Raises:
        InputError: for an unknown key, a key that is given twice, and a wrong value.
    """
    path, *pairs = re.split(f",({'|'.join(names)})=", text) if names else [text]
    texts = pairs[1::2]
    takes = f"a source of the kind {kind} takes the keys {', '.join(names) or '(none)'}"
    for part in (path, *texts):
        unknown = re.search(r",([\w-]+)=", part)
        if unknown and not os.path.lexists(os.path.expanduser(part)):
            raise InputError(f"{takes}, not {unknown[1]}, and there is no file {shown(part)}")
    values: dict[str, Any] = {}
    for name, value in zip(pairs[::2], texts, strict=True):
        if name in values:
            raise InputError(f"{name} is given twice, the second time as {shown(value)}")
        expected, read = SOURCE_KEYS[name]
        try:
            values[name] = read(value)
        except (ValueError, InputError) as error:
            raise InputError(f"{name} must be {expected}, got {shown(value)}: {takes}") from error
    return path, values
