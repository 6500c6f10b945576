"""The folder of a run: its files, and whether it belongs to a recipe."""

import errno
import fcntl
import hashlib
import json
import os
import platform
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import Any

import cv2
import numpy as np
import torch
from tqdm import tqdm

from models.checkpoint import BEST, FINAL, LAST, RECIPE
from runtime import __version__
from runtime.base.errors import InputError
from runtime.files.atomic_write import atomic_write
from runtime.files.own_folder import mark_folder
from runtime.files.read_input import read_text
from training.base.tables import build
from training.run.recipe import Recipe

SCORES = "scores.csv"
PAGE = "validation.html"
TENSORBOARD = "tensorboard"
BATCH = "batch.png"
# Files that a run writes and replaces.
_FILES = [Path(name) for name in (RECIPE, LAST, FINAL, BEST, SCORES, PAGE, TENSORBOARD)]
# Keys of recipe.json: the data's files at the first start, and the folders that held them at the
# last start, in which `ssdnet-eval RUN` finds the validation sets.
_DATA, DATA_FOLDERS = "data_files", "data_folders"
# What differs from the files of the first start, by the facts of `list_data`.
_CHANGES = {
    "files": "{was} files when the run began, now {now}",
    "sha256": "the {files} files have other names than when the run began",
    "bytes": "the files had {was} bytes when the run began, now {now}",
    "content": "the files have another content than when the run began",
}
# Of a larger file this number of blocks [bytes] is compared.
_BLOCKS, _BLOCK = 16, 4096
# Keys that may change when a run is resumed: they affect neither the weights nor the choice of
# best.pt.
_WITHOUT_EFFECT = (
    "recipe.data.workers",
    "recipe.data.cache_gib",
    "recipe.loop.checkpoint_every",
    "recipe.loop.log_every",
    "recipe.terms",
    "recipe.validation.every",
    "recipe.validation.pictures",
)


def prepare_folder(
    out: Path,
    resolved: Mapping[str, Any],
    files: Mapping[str, Mapping[str, Any]],
    roots: Sequence[Path],
) -> None:
    """Make `out` the folder of this training; InputError if it belongs to another one.

    `files` describes the data, see `list_data`, in the folders `roots`. Those of the first
    start stay in recipe.json; a difference to them is a warning on stderr.
    """
    path = out / RECIPE
    with folder_errors(out):
        first = files
        if path.is_file():
            before = read_document(path)
            known = before.get(_DATA) or files
            require_same(before, resolved, path, known, files)
            # A folder that was moved has another path, and the same files.
            moved = {name: item for name, item in files.items() if item in known.values()}
            first = {**{name: known.get(name, {}) for name in files}, **moved}
            for name, item in files.items():
                if text := _difference(first[name], item):
                    text = f"warning: {name}: {text}; the run goes on with other data: choose "
                    text += "another --out to begin with them"
                    tqdm.write(text, file=sys.stderr)
        out.mkdir(parents=True, exist_ok=True)
        folders = [str(root.resolve()) for root in roots]
        document = {**resolved, _DATA: first, DATA_FOLDERS: folders, "versions": versions()}
        atomic_write(path, json.dumps(document, indent=2).encode())


def _difference(was: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """Return in words how the files of a set differ from those of the first start; "" if not.

    Earlier releases listed fewer folders and fewer facts.
    """
    changed = (key for key in _CHANGES if key in was and was[key] != now[key])
    key = next(changed, None)
    return "" if key is None else _CHANGES[key].format(was=was[key], now=now[key], **now)


def list_data(roots: Sequence[Path], paths: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Describe the files of each path, a folder or a file, in the first root that has it.

    The description is their number, their bytes, and the SHA-256 of their names and of their
    content, of which large files give samples. It is the same wherever the folder is.
    """
    described = {}
    for path in paths:
        place = next((root / path for root in roots if (root / path).exists()), None)
        if place is not None:
            walked = os.walk(place, followlinks=True)
            found = (os.path.join(folder, name) for folder, _, files in walked for name in files)
            listed = sorted(found) if place.is_dir() else [str(place)]
            names = [os.path.relpath(name, place) for name in listed]
            digest = hashlib.sha256("\n".join(names).encode(errors="surrogateescape"))
            content = hashlib.sha256()
            for name in filter(os.path.isfile, listed):
                _add_content(content, name)
            described[path] = {
                "files": len(names),
                "bytes": sum(os.path.getsize(name) for name in listed if os.path.exists(name)),
                "sha256": digest.hexdigest(),
                "content": content.hexdigest(),
            }
    return described


def _add_content(digest: Any, path: str) -> None:
    """Add a file to a digest, or evenly spread blocks of one that is larger than they are.

    The last block of a PNG holds a check sum of all its pixels.
    """
    with open(path, "rb") as file:
        last = max(0, os.path.getsize(path) - _BLOCK)
        for start in sorted({last * number // (_BLOCKS - 1) for number in range(_BLOCKS)}):
            file.seek(start)
            digest.update(file.read(_BLOCK))


def versions() -> dict[str, str]:
    """Return the releases of what computes a training."""
    names = {"python": platform.python_version(), "ssdnet": __version__}
    names |= {"torch": str(torch.__version__), "numpy": np.__version__, "opencv": cv2.__version__}
    return names


def read_document(path: Path) -> dict[str, Any]:
    """Read the recipe.json of a run; InputError if it was damaged."""
    try:
        document: dict[str, Any] = json.loads(read_text(path))
        if not isinstance(document["recipe"], dict):
            raise ValueError("its recipe is no table")
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path}: is not the recipe of a run as a training writes it ({error!r}): restore it, "
            "or choose another --out"
        ) from error
    return document


@contextmanager
def lock_folder(out: Path) -> Iterator[None]:
    """Keep other trainings from writing to `out`, and this one from replacing files of others.

    The lock ends with the process. It is a POSIX lock, which workers of the process do not inherit.
    On a file system without locks nothing is locked. Raises InputError and OutputError.
    """
    with folder_errors(out):
        out.mkdir(parents=True, exist_ok=True)
        # A run of an earlier release has a recipe, but no list.
        marker = mark_folder(out, [] if (out / RECIPE).is_file() else _FILES)
        file = marker.open("ab")
    with file:
        try:
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError):
            raise InputError(
                f"{out}: another process trains in it: wait for it, or choose another --out"
            ) from None
        except OSError:  # no locks
            pass
        yield


@contextmanager
def folder_errors(out: Path) -> Iterator[None]:
    """Raise an OSError of the block as an InputError about `out`."""
    try:
        yield
    except OSError as error:
        is_full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        remedy = "free some space and run the command again, or choose" if is_full else "choose"
        raise InputError(
            f"{out}: cannot be written: {error.strerror}: {remedy} another --out"
        ) from error


def require_same(
    before: Mapping[str, Any],
    now: Mapping[str, Any],
    path: Path,
    known: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
    files: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
) -> None:
    """Raise InputError that names the first key in which two trainings differ.

    Keys of `_WITHOUT_EFFECT` are ignored, and so is the path of a set that holds the same files:
    `known` and `files` are the earlier and the present answer of `list_data`. A missing key of
    an older recipe has its default.
    """
    try:
        recipe = asdict(build(Recipe, before.get("recipe")))
    except InputError as error:
        raise InputError(
            f"{path}: belongs to a training whose recipe this release does not accept: {error}: "
            "choose another --out"
        ) from error
    old = _flatten({**{key: before.get(key) for key in now}, "recipe": recipe})
    new = _flatten(now)
    for key in [*old, *(key for key in new if key not in old)]:
        was = known.get(str(old.get(key)))
        if key.endswith("].path") and was is not None and was == files.get(str(new.get(key))):
            continue
        if old.get(key) != new.get(key) and not key.startswith(_WITHOUT_EFFECT):
            final = path.with_name(FINAL)
            remedy = "choose another --out, or resume with the same recipe"
            if final.is_file():
                remedy = f"the run is finished: train on from it, --init {final} and another --out"
            raise InputError(
                f"{path}: belongs to a training with another recipe: "
                f"{key.removeprefix('recipe.')} was {old.get(key)!r}, now it is {new.get(key)!r}: "
                f"{remedy}"
            )


def _flatten(value: Any, place: str = "") -> dict[str, Any]:
    """Return every value by its key: {"recipe.data.source[0].path": ...}."""
    if isinstance(value, Mapping):
        parts = [(f"{place}.{key}".removeprefix("."), item) for key, item in value.items()]
    elif isinstance(value, list | tuple):
        parts = [(f"{place}[{index}]", item) for index, item in enumerate(value)]
    else:
        return {place: value}
    return {key: item for name, part in parts for key, item in _flatten(part, name).items()}
