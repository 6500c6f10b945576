"""Files that are whole or not there."""

import contextlib
import os
from pathlib import Path

from runtime.errors import OutputError

_NAME_LENGTH = 40  # of the file's name in the temporary one, which may not grow too long


def atomic_write(path: Path, content: bytes | memoryview) -> None:
    """Write a file under a temporary name, then rename it: it is whole or not there.

    Raises OutputError.
    """
    temporary = _temporary(path)
    try:
        temporary.write_bytes(content)
        os.replace(temporary, path)
    except BaseException as error:
        with contextlib.suppress(OSError):  # the first error is the one to tell
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise OutputError(
                f"cannot write {path} ({error.strerror}): make room or choose another --out; "
                "what was finished before is kept"
            ) from error
        raise


def remove_unfinished(path: Path) -> None:
    """Remove what a killed process left of `path` under its temporary name."""
    _temporary(path).unlink(missing_ok=True)


def _temporary(path: Path) -> Path:
    return path.with_name(f".{path.name[:_NAME_LENGTH]}.part")
