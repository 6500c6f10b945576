"""Files and folders that are whole or not there.

What is written lies in a hidden temporary beside its target, under a lock, and is renamed when it
is whole. The lock of a process that was killed is gone: a temporary that can be locked is a
leftover, and the next write of the same target removes it.
"""

import contextlib
import errno
import os
import shutil
import stat
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

from runtime.errors import OutputError

try:
    import fcntl
except ImportError:  # Windows, where a file that somebody has open cannot be removed
    fcntl = None  # type: ignore[assignment]

_NAME_LENGTH = 40  # of the target's name in the temporary's, which may not grow too long
_NO_FOLLOW = getattr(os, "O_NOFOLLOW", 0)
_BINARY = getattr(os, "O_BINARY", 0)
_NO_HANDLE = -1


def atomic_write(
    path: Path, content: bytes | memoryview, *, overwrite: bool = True, durable: bool = False
) -> None:
    """Write a file whole or not at all; options and errors as of `atomic_file`."""
    with atomic_file(path, overwrite=overwrite, durable=durable) as file:
        file.write(content)


@contextlib.contextmanager
def atomic_file(path: Path, *, overwrite: bool = True, durable: bool = False) -> Iterator[BinaryIO]:
    """Open a file that gets its name when the block ends; after an error there it is gone.

    What stood at `path` stays until then. The file is a new one: its permissions are what the umask
    leaves of them, and a link at `path` is replaced, not followed. Until it is whole others can
    read it as ``file.name``.

    overwrite: False = of several writers of one path only one succeeds. (Where the file system has
        no hard links, an empty file has the name for a moment before the whole one.)
    durable: the content is on the disk, not in a cache, before the file gets its name.

    Raises OutputError if the file cannot be written (also for an OSError of the block), if it
    exists and may not be replaced, or if somebody else is writing it at this moment.
    """
    temporary = _temporary(path)
    with _as_output_error(path):
        handle = _create(temporary, _new_file)
        with open(temporary, "w+b", opener=lambda *_: handle) as file:
            try:
                yield file
                file.flush()
                if durable:
                    os.fsync(handle)
                if fcntl is None:
                    file.close()  # Windows renames no open file
                if overwrite:
                    os.replace(temporary, path)
                else:
                    _publish_new(temporary, path)
            except BaseException:
                if fcntl is None:
                    file.close()
                _discard(temporary)
                raise


@contextlib.contextmanager
def atomic_folder(path: Path, *, overwrite: bool = False) -> Iterator[Path]:
    """Make a folder that gets its name when the block ends; after an error there it is gone.

    Yields the temporary folder to fill. overwrite: a folder at `path` is removed just before.

    Raises OutputError as `atomic_file` does.
    """
    temporary = _temporary(path)
    with _as_output_error(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = _create(temporary, _new_folder)
        try:
            yield temporary
            if overwrite and path.is_dir():
                shutil.rmtree(path)
            if os.path.lexists(path):
                raise _taken(path)
            temporary.rename(path)
        except BaseException:
            _discard(temporary)
            raise
        finally:
            if handle != _NO_HANDLE:
                os.close(handle)


@contextlib.contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Name a file for a library that opens files by itself, by their name and its ending.

    Yields a path of the same name in a hidden folder beside it. What lies there when the block ends
    takes its place at `path`, and what stood there goes, also where the block left nothing; after
    an error the new one is gone and the old one stays.

    Raises OutputError as `atomic_file` does.
    """
    temporary = _temporary(path)
    with _as_output_error(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = _create(temporary, _new_folder)
        try:
            made = temporary / path.name
            yield made
            if made.exists():
                os.replace(made, path)
            else:
                path.unlink(missing_ok=True)
        finally:
            _discard(temporary)
            if handle != _NO_HANDLE:
                os.close(handle)


def remove_leftover(path: Path) -> None:
    """Remove what a killed process left of writing `path`; a file still being written stays."""
    with contextlib.suppress(OSError):
        _remove_leftover(_temporary(path))


def _temporary(path: Path) -> Path:
    """Its name is the same for every writer of `path`, so that the next one finds a leftover."""
    name = path.name
    return path.with_name(f".{name[:_NAME_LENGTH]}.{zlib.crc32(os.fsencode(name)):08x}.part")


def _create(temporary: Path, new: Callable[[Path], int]) -> int:
    """Make the temporary and lock it. Raises OSError, BlockingIOError if another holds it."""
    while True:
        try:
            handle = new(temporary)
        except FileExistsError:
            try:
                _remove_leftover(temporary)
            except OSError as error:
                raise OSError(
                    error.errno, f"{temporary} is in the way: {error.strerror}"
                ) from error
            continue
        if handle == _NO_HANDLE or (_lock(handle) and _is_at(handle, temporary)):
            return handle
        os.close(handle)  # before it was locked another writer took it for a leftover


def _new_file(temporary: Path) -> int:
    return os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL | _NO_FOLLOW | _BINARY, 0o666)


def _new_folder(temporary: Path) -> int:
    temporary.mkdir()
    return _NO_HANDLE if fcntl is None else _open_existing(temporary)  # Windows opens no folder


def _open_existing(temporary: Path) -> int:
    try:
        return os.open(temporary, os.O_RDWR | _NO_FOLLOW)  # NFS locks what is open for writing
    except IsADirectoryError:
        return os.open(temporary, os.O_RDONLY | _NO_FOLLOW)


def _lock(handle: int) -> bool:
    """Whether this process holds the lock now; True, too, where the file system has none."""
    if fcntl is None:
        return True
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
    if fcntl is None:
        _remove(temporary)
        return
    try:
        handle = _open_existing(temporary)
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


def _discard(temporary: Path) -> None:
    with contextlib.suppress(OSError):  # the first error is the one to tell
        _remove(temporary)


def _publish_new(temporary: Path, path: Path) -> None:
    """Give the file its name if nobody has it. Raises OutputError."""
    try:
        if fcntl is None:
            temporary.rename(path)  # on Windows it replaces nothing
        elif _link(temporary, path):
            temporary.unlink()
        else:
            os.close(_new_file(path))  # takes the name, or fails
            os.replace(temporary, path)
    except FileExistsError as error:
        raise _taken(path) from error


def _link(temporary: Path, path: Path) -> bool:
    """Give the file a second name; False where the file system has no hard links."""
    try:
        os.link(temporary, path)
    except FileExistsError:
        raise
    except OSError:
        return False
    return True


def _taken(path: Path) -> OutputError:
    return OutputError(f"{path} exists: choose another name, or ask to overwrite it")


@contextlib.contextmanager
def _as_output_error(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"cannot write {path} ({error.strerror or error}): make room or choose another place; "
            "what was finished before is kept"
        ) from error
