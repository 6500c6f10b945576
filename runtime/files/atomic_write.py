"""Files that are whole or not there.

They are written into a hidden, locked folder beside their target, and renamed when they are
whole. A killed process loses its lock: a hidden folder that can be locked is a leftover, and the
next write of the same target removes it.
"""

import contextlib
import fcntl
import os
import shutil
import stat
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from runtime.base.errors import OutputError

_NAME_LENGTH = 40  # characters of the target's name in the name of its hidden folder


def atomic_write(path: Path, content: bytes | memoryview, *, overwrite: bool = True) -> None:
    """Write a file whole or not at all; arguments and errors as in `atomic_file`."""
    with atomic_file(path, overwrite=overwrite) as file:
        file.write(content)


@contextlib.contextmanager
def atomic_file(path: Path, *, overwrite: bool = True, durable: bool = False) -> Iterator[BinaryIO]:
    """Open a file that gets its name when the block ends; after an error it is removed.

    An existing file stays until then. The new one has the permissions that the umask leaves, and a
    link at `path` is replaced, not followed. Others can read it as ``file.name`` meanwhile.

    Args:
        path: the file's name, in a folder that exists.
        overwrite: False: of several writers of one path only one succeeds.
        durable: whether the content is on the disk, not in a cache, before the file gets its name.

    Yields:
        The file, open for reading and writing.

    Raises:
        OutputError: if the file cannot be written (also for an OSError of the block), if it exists
            and may not be replaced, or if another process is writing it at this moment.
    """
    with temporary_path(path) as made:
        with open(made, "x+b") as file:
            yield file
            if durable:
                file.flush()
                os.fsync(file.fileno())
        _publish(made, path, overwrite=overwrite)


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
    with temporary_path(path, make_parents=True) as made:
        yield made
        if made.exists():
            _publish(made, path, overwrite=overwrite)
        elif overwrite:
            _require_replaceable(path)
            path.unlink(missing_ok=True)


def require_writable(path: Path) -> None:
    """Raise the OutputError of `atomic_file` for a file that cannot be written; nothing is left."""
    with temporary_path(path):
        if path.is_dir():
            raise OutputError(f"{path} is a folder: name a file to write")


def remove_leftover(path: Path) -> None:
    """Remove the hidden folder of `path` that a killed process left; keep it if it is locked."""
    if os.path.isdir(_hidden_folder(path)):
        with contextlib.suppress(OutputError), temporary_path(path):
            pass


def _hidden_folder(path: Path) -> Path:
    """Equal for all writers of `path`, so that each finds leftovers."""
    name = path.name
    return path.with_name(f".{name[:_NAME_LENGTH]}.{zlib.crc32(os.fsencode(name)):08x}.part")


@contextlib.contextmanager
def temporary_path(path: Path, *, make_parents: bool = False) -> Iterator[Path]:
    """Yield a path of the same name in the hidden folder of `path`, which is then removed.

    Raises OutputError as `atomic_file`.
    """
    if path.name in ("", ".."):  # of ".", ".." and "/"
        raise OutputError(f"{path} has no name that could be given to a result: name a new one")
    try:
        _require_replaceable(path)
        if make_parents:
            path.parent.mkdir(parents=True, exist_ok=True)
        folder = _hidden_folder(path)
        handle = _lock(folder)
        try:
            yield folder / path.name
        finally:
            with contextlib.suppress(OSError):  # the first error is the one to report
                shutil.rmtree(folder)
            os.close(handle)
    except OSError as error:
        raise OutputError(
            f"cannot write {path} ({error.strerror or error}): free some space or choose another "
            "location; files that were already complete are kept"
        ) from error


def _lock(folder: Path) -> int:
    """Make a folder and lock it. Raises OSError, BlockingIOError if another process holds it."""
    while True:
        with contextlib.suppress(FileExistsError):
            folder.mkdir()
        try:
            handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        except FileNotFoundError:  # another writer has just ended
            continue
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(handle)
            reason = "another process is writing it at this moment"
            raise BlockingIOError(error.errno, reason) from error
        except OSError:  # a file system without locks
            pass
        with contextlib.suppress(FileNotFoundError):  # another writer removed it before the lock
            if os.path.samestat(os.fstat(handle), os.lstat(folder)):
                if not any(folder.iterdir()):
                    return handle
                shutil.rmtree(folder)  # a leftover
        os.close(handle)


def _require_replaceable(path: Path) -> None:
    """Raise OutputError for devices, pipes and sockets, which root could replace with a file."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    if not (stat.S_ISREG(mode) or stat.S_ISLNK(mode) or stat.S_ISDIR(mode)):
        raise OutputError(f"{path} exists and is no regular file: choose another name")


def _publish(made: Path, path: Path, *, overwrite: bool) -> None:
    """Rename `made` to `path`, whose hidden folder is locked. Raises OutputError if it exists."""
    _require_replaceable(path)
    if not overwrite and os.path.lexists(path):
        raise OutputError(f"{path} exists: choose another name, or replace it with --overwrite")
    os.replace(made, path)
