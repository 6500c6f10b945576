"""The option --json FILE of commands: their result as a document, which "-" prints."""

import json
from pathlib import Path
from typing import Any

from runtime.command.process import print_result
from runtime.files.atomic_write import atomic_write, require_writable

STDOUT = Path("-")


def require_json(path: Path | None, *, overwrite: bool) -> None:
    """Raise OutputError if the file exists or cannot be written, before anything is computed."""
    if path is not None and path != STDOUT:
        require_writable(path, overwrite=overwrite)


def write_json(path: Path | None, document: Any, *, overwrite: bool) -> None:
    """Write or print a document. Raises OutputError if that fails."""
    text = json.dumps(document, indent=1, allow_nan=False)
    if path == STDOUT:
        print_result(text)
    elif path is not None:
        atomic_write(path, f"{text}\n".encode(), overwrite=overwrite)
