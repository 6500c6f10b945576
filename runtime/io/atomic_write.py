"""Files and folders that are whole or not there.

They are written as a hidden temporary beside their target, under a lock, and renamed when they are
whole. A killed process loses its lock: a temporary that can be locked is a leftover, and the
next write of the same target removes it.
"""

import contextlib
import errno
import fcntl
import os
import shutil
import stat
import zlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

from runtime.errors import OutputError

_NAME_LENGTH = 40  # characters of the target's name in the name of the temporary


def atomic_write(
    path: Path, content: bytes | memoryview, *, overwrite: bool = True, durable: bool = False
) -> None:
    """Write a file whole or not at all; arguments and errors as in `atomic_file`."""
    with atomic_file(path, overwrite=overwrite, durable=durable) as file:
        file.write(content)


@contextlib.contextmanager
def atomic_file(path: Path, *, overwrite: bool = True, durable: bool = False) -> Iterator[BinaryIO]:
    """Open a file that gets its name when the block ends; after an error it is removed.

    An existing file stays until then. The new one has the permissions that the umask leaves, and a
    link at `path` is replaced, not followed. Others can read it as ``file.name`` meanwhile.

    Args:
        path: the file's name, in a folder that exists.
        overwrite: False: of several writers of one path only one succeeds. (On file systems without
            hard links an empty file has the name for a moment before the whole one.)
        durable: whether the content is on the disk, not in a cache, before the file gets its name.

    Yields:
        The file, open for reading and writing.

    Raises:
        OutputError: if the file cannot be written (also for an OSError of the block), if it exists
            and may not be replaced, or if another process is writing it at this moment.
    """
    with _temporary(path, folder=False) as (temporary, handle):
        with open(temporary, "r+b") as file:
            yield file
        if durable:
            os.fsync(handle)
        _publish(temporary, path, overwrite=overwrite)


@contextlib.contextmanager
def atomic_folder(path: Path, *, own: Callable[[], Iterable[Path]] | None = None) -> Iterator[Path]:
    """Make a folder that gets its name when the block ends; after an error it is removed.

    Args:
        path: the folder's name; its parents are made.
        own: returns the files and folders below `path` that belong to an earlier result, which is
            then removed just before; a folder that holds anything else is never replaced. None: a
            folder that exists is not replaced.

    Yields:
        The temporary folder to fill.

    Raises:
        OutputError: as `atomic_file`, and for a file at `path` that is not of an earlier result;
            what is there is then untouched.
    """
    with _temporary(path, folder=True) as (temporary, _):
        if os.path.lexists(path):
            _earlier_entries(path, own)
        yield temporary
        if os.path.lexists(path):
            for entry in reversed(_earlier_entries(path, own)):
                entry.rmdir() if entry.is_dir() else entry.unlink()
            path.rmdir()
        temporary.rename(path)


@contextlib.contextmanager
def atomic_path(path: Path, *, overwrite: bool = True) -> Iterator[Path]:
    """Name a file for a library that opens files by itself, by their name and its ending.

    What the block leaves there takes its place at `path` when the block ends; where it leaves
    nothing and may overwrite, a file at `path` is removed. After an error the new file is removed
    and the old stays.

    Args:
        path: the file's name; its folder is made.
        overwrite: see `atomic_file`.

    Yields:
        A path of the same name in a hidden folder beside it.

    Raises:
        OutputError: as `atomic_file`.
    """
    with _temporary(path, folder=True) as (temporary, _):
        made = temporary / path.name
        yield made
        if made.exists():
            _publish(made, path, overwrite=overwrite)
        elif overwrite:
            _require_replaceable(path)
            path.unlink(missing_ok=True)


def require_writable(path: Path) -> None:
    """Raise the OutputError of `atomic_file` for a file that cannot be written; nothing is left."""
    with _temporary(path, folder=False):
        if path.is_dir():
            raise OutputError(f"{path} is a folder: name a file to write")


def require_folder_free(path: Path, *, own: Callable[[], Iterable[Path]] | None = None) -> None:
    """Raise the OutputError of `atomic_folder` for a folder that cannot be made or replaced."""
    with _temporary(path, folder=True):
        if os.path.lexists(path):
            _earlier_entries(path, own)


def remove_leftover(path: Path) -> None:
    """Remove the temporary of `path` that a killed process left; keep it if it is locked."""
    with contextlib.suppress(OSError):
        _remove_leftover(_temporary_name(path))


def _temporary_name(path: Path) -> Path:
    """Path of the temporary; equal for all writers of `path`, so that each finds leftovers."""
    name = path.name
    return path.with_name(f".{name[:_NAME_LENGTH]}.{zlib.crc32(os.fsencode(name)):08x}.part")


@contextlib.contextmanager
def _temporary(path: Path, *, folder: bool) -> Iterator[tuple[Path, int]]:
    """The temporary of `path` and its locked handle; removed if it is still there afterwards."""
    if path.name in ("", ".."):  # of ".", ".." and "/"
        raise OutputError(f"{path} has no name that could be given to a result: name a new one")
    temporary = _temporary_name(path)
    try:
        _require_replaceable(path)
        if folder:
            path.parent.mkdir(parents=True, exist_ok=True)
        handle = _create(temporary, folder=folder)
        try:
            yield temporary, handle
        finally:
            with contextlib.suppress(OSError):  # the first error is the one to report
                if _is_at(handle, temporary):
                    _remove(temporary)
            os.close(handle)
    except OSError as error:
        raise OutputError(
            f"cannot write {path} ({error.strerror or error}): free some space or choose another "
            "location; files that were already complete are kept"
        ) from error


def _create(temporary: Path, *, folder: bool) -> int:
    """Make the temporary and lock it. Raises OSError, BlockingIOError if another holds it."""
    while True:
        try:
            handle = _make(temporary, folder=folder)
        except FileExistsError:
            try:
                _remove_leftover(temporary)
            except OSError as error:
                reason = f"the temporary file {temporary} cannot be replaced: {error.strerror}"
                raise OSError(error.errno, reason) from error
            continue
        if _lock(handle) and _is_at(handle, temporary):
            return handle
        os.close(handle)  # another writer removed it as a leftover before it was locked


def _make(temporary: Path, *, folder: bool) -> int:
    if folder:
        temporary.mkdir()
        return _open(temporary)
    return os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)


def _open(temporary: Path) -> int:
    return os.open(temporary, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)  # waits for no pipe


def _lock(handle: int) -> bool:
    """Whether this process holds the lock now; also True where the file system has no locks."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


def _is_at(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), os.lstat(path))
    except FileNotFoundError:
        return False


def _remove_leftover(temporary: Path) -> None:
    """Remove it. Raises OSError, BlockingIOError if it is still being written."""
    try:
        handle = _open(temporary)
    except FileNotFoundError:
        return
    try:
        if not _lock(handle):
            raise BlockingIOError(errno.EWOULDBLOCK, "another process is writing it at this moment")
        if _is_at(handle, temporary):
            _remove(temporary)
    finally:
        os.close(handle)


def _remove(path: Path) -> None:
    if stat.S_ISDIR(path.lstat().st_mode):
        shutil.rmtree(path)
    else:
        path.unlink()


def _require_replaceable(path: Path) -> None:
    """Raise OutputError for devices, pipes and sockets, which root could replace with a file."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    if not (stat.S_ISREG(mode) or stat.S_ISLNK(mode) or stat.S_ISDIR(mode)):
        raise OutputError(f"{path} exists and is no regular file: choose another name")


def _publish(temporary: Path, path: Path, *, overwrite: bool) -> None:
    """Rename the temporary to `path`. Raises OutputError if it exists, without `overwrite`."""
    if overwrite:
        _require_replaceable(path)
        os.replace(temporary, path)
        return
    try:
        try:
            os.link(temporary, path)
        except FileExistsError:
            raise
        except OSError:  # no hard links: an empty file takes the name, or fails
            os.close(os.open(path, os.O_CREAT | os.O_EXCL))
            os.replace(temporary, path)
    except FileExistsError as error:
        raise _taken(path) from error


def _earlier_entries(path: Path, own: Callable[[], Iterable[Path]] | None) -> list[Path]:
    """All that an earlier result holds, to be removed from the end. Raises OutputError for others.

    Its own files come first, in the order of ``own``: what describes it goes last, so that the rest
    of a removal that was killed is known for what it is. The last rest is an empty folder.
    """
    if own is None:
        raise _taken(path)
    if path.is_symlink() or not path.is_dir():
        raise OutputError(f"{path} is a link or a file: choose another name")
    found = sorted(path.rglob("*"))
    expected = list(own()) if found else []
    known = set(expected)
    for entry in found:
        if entry.is_symlink() or entry not in known:
            raise OutputError(
                f"{entry} does not belong to the result that would be replaced: move it away, or "
                "choose another folder"
            )
    files = [entry for entry in expected if entry.parent == path and entry.is_file()]
    return files + [entry for entry in found if entry.parent != path or entry.is_dir()]


def _taken(path: Path) -> OutputError:
    return OutputError(f"{path} exists: choose another name, or replace it with --overwrite")
