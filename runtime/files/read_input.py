"""Input files: regular files of bounded size.

Reading a pipe, a device or a kernel file can block forever, and a link may point to any of them.
Therefore every reader of the project opens its files with this module.
"""

import contextlib
import os
import stat
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from runtime.base.arguments import cut
from runtime.base.errors import InputError

MAX_FILE_BYTES = 256_000_000  # an image or a scan
MAX_TEXT_BYTES = 32_000_000  # a calibration, time stamps, a table or a recipe
_POINTER, _MAX_POINTER_BYTES = b"version https://git-lfs", 1024


@contextlib.contextmanager
def open_input(path: Path, *, max_bytes: int | None) -> Iterator[BinaryIO]:
    """Open a regular file of bounded size.

    Args:
        path: the file; links are followed.
        max_bytes: its largest size; None: any size.

    Yields:
        The file, open for reading.

    Raises:
        InputError: if the file cannot be opened, is not a regular file, is larger than
            `max_bytes`, or is a Git LFS pointer instead of the file.
    """
    with _reported(path):
        file = open(path, "rb", opener=_open_at_once)  # noqa: SIM115 - closed below
    with file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode):
            raise InputError(f"cannot read {_shown(path)}: it is not a regular file")
        if max_bytes is not None and status.st_size > max_bytes:
            raise InputError(
                f"{_shown(path)} has {status.st_size:,} bytes, expected at most {max_bytes:,}: is "
                "it another file?"
            )
        is_small = len(_POINTER) < status.st_size <= _MAX_POINTER_BYTES
        if is_small and os.pread(file.fileno(), len(_POINTER), 0) == _POINTER:
            raise InputError(
                f"{_shown(path)} is a pointer of Git LFS, not the file: get it by git lfs pull"
            )
        yield file


def read_input(path: Path, *, max_bytes: int = MAX_FILE_BYTES) -> bytes:
    """Read a regular file of bounded size.

    Args:
        path: the file; links are followed.
        max_bytes: its largest size.

    Returns:
        Its content.

    Raises:
        InputError: if the file cannot be read, is not a regular file, or is larger than
            `max_bytes`.
    """
    with open_input(path, max_bytes=max_bytes) as file, _reported(path):
        return file.read(os.fstat(file.fileno()).st_size)  # files in /proc have size 0


def read_text(path: Path) -> str:
    """Read a UTF-8 file of at most `MAX_TEXT_BYTES`; errors as in `read_input`."""
    try:  # editors on Windows write a byte order mark first
        return read_input(path, max_bytes=MAX_TEXT_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"cannot read {_shown(path)}: it is not UTF-8 text ({error})") from error


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file of at most `MAX_TEXT_BYTES`; errors as in `read_input`."""
    text = read_text(path)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # ValueError also for an integer of 5,000 digits
        raise InputError(
            f"{_shown(path)} is not valid TOML: {cut(str(error), 200)}: correct it"
        ) from error


def require_regular(path: Path, *, max_bytes: int | None = None) -> None:
    """Check a file that a library opens by name; errors as `open_input`, and for an empty file."""
    with open_input(path, max_bytes=max_bytes) as file:
        if os.fstat(file.fileno()).st_size == 0:  # files in /proc and /sys: reading can block
            raise InputError(f"cannot read {_shown(path)}: it is empty")


def _open_at_once(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NONBLOCK)  # does not wait for a pipe's writer


@contextlib.contextmanager
def _reported(path: Path) -> Iterator[None]:
    """Convert errors that occur when a file is opened or read to InputError."""
    try:
        yield
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"cannot read {_shown(path)} ({reason})") from error


def _shown(path: Path) -> str:
    return cut(str(path), 200)
