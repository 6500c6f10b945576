"""Folders whose content may be replaced: a hidden file in each lists the files written there.

Only files on this list are ever removed or replaced. All other files belong to the user.
"""

import json
import os
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

from runtime.base.errors import InputError, OutputError
from runtime.files.atomic_write import (
    atomic_write,
    remove_leftover,
    require_replaceable,
    temporary_path,
    try_lock,
)
from runtime.files.read_input import read_text

MARKER = ".ssdnet"
_TEXT = "Written by ssdnet, which may replace the files of this list, and nothing else here.\n"


@contextmanager
def atomic_folder(path: Path, *, overwrite: bool = False) -> Iterator[Path]:
    """Make a folder that gets its name when the block ends; after an error it is removed.

    Args:
        path: the folder's name; its parents are created.
        overwrite: whether an earlier folder of this function is replaced. A folder that holds any
            other file is never replaced.

    Yields:
        The folder to fill. It has a hidden path until the block ends.

    Raises:
        OutputError: as for `atomic_file`, and if a folder exists that may not be replaced. The
            existing files are then unchanged.
    """
    with temporary_path(path, make_parents=True) as made:
        _require_own_folder(path, overwrite=overwrite)
        made.mkdir()
        yield made
        _write_list(made, sorted(entry.relative_to(made) for entry in made.rglob("*")))
        _require_own_folder(path, overwrite=overwrite)
        if path.exists():  # the hidden folder is removed with all that it holds
            path.rename(Path(tempfile.mkdtemp(dir=made.parent)) / path.name)
        made.rename(path)


def require_folder_free(path: Path, *, overwrite: bool = False) -> None:
    """Raise the OutputError of `atomic_folder` if the folder cannot be created or replaced."""
    _require_own_folder(path, overwrite=overwrite)
    with temporary_path(path, make_parents=True):
        pass


@contextmanager
def locked_folder(path: Path) -> Iterator[None]:
    """Keep other processes that call this function out of a folder, which is created.

    Raises:
        OutputError: if another process is inside, or the folder cannot be created.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        folder = os.open(path, os.O_RDONLY)
    except OSError as error:
        raise OutputError(_cannot_make(path, error)) from error
    try:
        if not try_lock(folder):
            raise OutputError(
                f"another run is writing into {path}: wait for its end, or choose another `out=`"
            )
        yield
    finally:
        os.close(folder)


def make_own_folder(path: Path, files: Sequence[Path], *, overwrite: bool = False) -> None:
    """Make a folder into which files will be written one by one.

    Args:
        path: a new or empty folder or, with `overwrite`, an earlier folder of this function. The
            files of the earlier folder are removed in the order of its list.
        files: the paths that will be written, relative to `path`.
        overwrite: whether earlier files are replaced.

    Raises:
        OutputError: if the folder cannot be used, or if writing there would replace a file that
            is not on the list or follow a link. The existing files are then unchanged.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        used = any(path.iterdir())
        if used and not overwrite:
            raise OutputError(
                f"the output folder {path} is not empty: choose another `out=`, or replace an "
                "earlier run with `overwrite=True`"
            )
        earlier = _read_list(path) if used else []
        _require_own(path, files, set(earlier))
        for file in earlier:
            if not (path / file.parent).is_symlink():
                if _is_file(path / file):
                    (path / file).unlink()
                remove_leftover(path / file)
        for folder in {path / file.parent for file in files}:
            folder.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(_cannot_make(path, error)) from error
    _write_list(path, files, overwrite=True)


def mark_folder(path: Path, files: Sequence[Path]) -> Path:
    """Write the list of a folder whose files will be replaced as they grow; return its path.

    An existing list is kept. Raises OutputError if one of the files exists and is not listed.
    """
    if not (path / MARKER).exists():
        _require_own(path, files, set())
        _write_list(path, files)
    return path / MARKER


def _require_own(path: Path, files: Iterable[Path], earlier: set[Path]) -> None:
    """Raise OutputError if a file exists that is not on the list, or a folder is a link."""
    for folder in {path / file.parent for file in files}:
        if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
            raise OutputError(
                f"{folder} is a link or a file where a folder is written: remove it, or choose "
                "another `out=`"
            )
    for file in files:
        if os.path.lexists(path / file) and not (file in earlier and _is_file(path / file)):
            raise OutputError(
                f"{path / file} does not belong to the earlier result, but would be replaced: move "
                "it away, or choose another `out=`"
            )


def _require_own_folder(path: Path, *, overwrite: bool) -> None:
    """Raise OutputError if a folder exists there that may not be replaced."""
    if not os.path.lexists(path):
        return
    require_replaceable(path, overwrite=overwrite)
    if path.is_symlink() or not path.is_dir():
        raise OutputError(f"{path} is a link or a file: choose another name")
    entries = list(path.rglob("*"))
    written_by_us = {MARKER, *map(str, _read_list(path))} if entries else set()
    for entry in entries:
        if entry.is_symlink() or str(entry.relative_to(path)) not in written_by_us:
            raise OutputError(
                f"{entry} does not belong to the result that would be replaced: move it away, or "
                "choose another folder"
            )


def _cannot_make(path: Path, error: OSError) -> str:
    reason = f"{error.strerror}: {error.filename}"
    return f"cannot make the output folder {path} ({reason}): choose another `out=`"


def _is_file(path: Path) -> bool:
    """Return whether the path is a file or a link, not a folder."""
    return path.is_file() or path.is_symlink()


def _write_list(folder: Path, files: Iterable[Path], *, overwrite: bool = False) -> None:
    lines = (json.dumps(file.as_posix()) + "\n" for file in files)  # names may have line feeds
    atomic_write(folder / MARKER, (_TEXT + "".join(lines)).encode(), overwrite=overwrite)


def _read_list(folder: Path) -> list[Path]:
    """Return the paths on a folder's list, relative to the folder. Raises OutputError."""
    marker = folder / MARKER
    if not marker.is_file():
        raise OutputError(
            f"{folder} holds files that ssdnet did not write, and it replaces only its own: choose "
            "another folder, or remove this one"
        )
    try:
        names = [PurePosixPath(json.loads(line)) for line in read_text(marker).splitlines()[1:]]
    except (InputError, ValueError, TypeError, RecursionError):
        names = [PurePosixPath("/")]
    if any(name.is_absolute() or {"..", ""} & {*name.parts} or "\0" in str(name) for name in names):
        raise OutputError(f"{marker}, the list of own files, is damaged: choose another folder")
    return [Path(name) for name in names]
