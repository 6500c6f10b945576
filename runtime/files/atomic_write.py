"""Files that are either complete or absent.

A file is written into a hidden, locked folder beside its target, and renamed when it is complete. A
killed process loses its lock, so a hidden folder that can be locked is a leftover. The next write
to the same target removes it.
"""

import contextlib
import errno
import fcntl
import os
import shutil
import stat
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from runtime.base.errors import OutputError

_NAME_LENGTH = 40  # so many characters of the target's name are in its hidden folder's name


def atomic_write(path: Path, content: bytes | memoryview, *, overwrite: bool = True) -> None:
    """Write a complete file or none; arguments and errors are those of `atomic_file`."""
    with atomic_file(path, overwrite=overwrite) as file:
        file.write(content)


@contextlib.contextmanager
def atomic_file(path: Path, *, overwrite: bool = True, durable: bool = False) -> Iterator[BinaryIO]:
    """Open a file that gets its name when the block ends; after an error it is removed.

    An existing file stays until the block ends. The new file has the permissions that the umask
    allows. A link at `path` is replaced, not followed. Inside the block, other programs can read
    the file as `file.name`.

    Args:
        path: the file's name, in a folder that exists.
        overwrite: whether an existing file is replaced. If False, only one of several writers to
            the same path succeeds.
        durable: whether the content is flushed to the disk before the file gets its name.

    Yields:
        The file, open for reading and writing.

    Raises:
        OutputError: if the file cannot be written, if the block raises an OSError, if the file
            exists and may not be replaced, or if another process is writing it at this moment.
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
    """Yield a temporary path for a library that opens files by name.

    The file that the block writes there is moved to `path` when the block ends. If the block writes
    no file and `overwrite` is True, the file at `path` is removed. After an error the new file is
    removed and the old one stays.

    Args:
        path: the file's name; its folder is created.
        overwrite: see `atomic_file`.

    Yields:
        A path of the same name in a hidden folder beside it.

    Raises:
        OutputError: as for `atomic_file`.
    """
    with temporary_path(path, make_parents=True) as made:
        yield made
        if made.exists():
            _publish(made, path, overwrite=overwrite)
        elif overwrite:
            require_replaceable(path)
            path.unlink(missing_ok=True)


def require_writable(path: Path, *, overwrite: bool = True, make_parents: bool = False) -> None:
    """Raise the OutputError of `atomic_file` if the file cannot be written; no file is left."""
    with temporary_path(path, make_parents=make_parents):
        if path.is_dir() and not path.is_symlink():
            raise OutputError(f"{path} is a folder: name a file to write")
        require_replaceable(path, overwrite=overwrite)


def remove_leftover(path: Path) -> None:
    """Remove the hidden folder that a killed process left beside `path`, unless it is locked."""
    if os.path.isdir(_hidden_folder(path)):
        with contextlib.suppress(OutputError), temporary_path(path):
            pass


def _hidden_folder(path: Path) -> Path:
    """Return the hidden folder, which is the same for all writers of `path`."""
    name = path.name
    return path.with_name(f".{name[:_NAME_LENGTH]}.{zlib.crc32(os.fsencode(name)):08x}.part")


@contextlib.contextmanager
def temporary_path(path: Path, *, make_parents: bool = False) -> Iterator[Path]:
    """Yield a path of the same name in the hidden folder of `path`; the folder is then removed.

    Raises OutputError as `atomic_file` does.
    """
    if path.name in ("", ".."):  # the path is ".", ".." or "/"
        raise OutputError(f"{path} has no name that could be given to a result: name a new one")
    try:
        require_replaceable(path)
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


def try_lock(handle: int) -> bool:
    """Lock an open folder; return False if another process holds the lock.

    A file system without locks, such as some network drives, keeps nobody out.
    """
    with contextlib.suppress(OSError):
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
    return True


def _lock(folder: Path) -> int:
    """Create a folder and lock it. Raises BlockingIOError if another process holds the lock."""
    while True:
        with contextlib.suppress(FileExistsError):
            folder.mkdir()
        try:
            handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        except FileNotFoundError:  # another writer has just ended
            continue
        if not try_lock(handle):
            os.close(handle)
            raise BlockingIOError(errno.EAGAIN, "another process is writing it at this moment")
        with contextlib.suppress(FileNotFoundError):  # another writer removed it before the lock
            if os.path.samestat(os.fstat(handle), os.lstat(folder)):
                if not any(folder.iterdir()):
                    return handle
                shutil.rmtree(folder)  # a leftover
        os.close(handle)


def require_replaceable(path: Path, *, overwrite: bool = True) -> None:
    """Raise OutputError if a file exists there that may not be replaced.

    Devices, pipes and sockets, which root could otherwise replace, never may.
    """
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    if not (stat.S_ISREG(mode) or stat.S_ISLNK(mode) or stat.S_ISDIR(mode)):
        raise OutputError(f"{path} exists and is no regular file: choose another name")
    if not overwrite:
        raise OutputError(
            f"{path} exists: choose another name, or replace it with `overwrite=True`"
        )


def _publish(made: Path, path: Path, *, overwrite: bool) -> None:
    """Rename `made` to `path`, whose hidden folder is locked; OutputError if `path` exists."""
    require_replaceable(path, overwrite=overwrite)
    os.replace(made, path)
