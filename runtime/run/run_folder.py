"""The folder of a run: an earlier run in it can be replaced, files of others are never touched."""

import contextlib
import json
import os
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

from runtime.errors import InputError, OutputError
from runtime.heads import HEADS
from runtime.io.atomic_write import atomic_write, remove_leftover
from runtime.read_input import read_input

OVERLAY, CLOUD = "overlay", "cloud"
#: Kind of a file that holds one head -> its name and encoding.
SAVED_HEADS = {
    head.saved_as: (head.name, head.encoding)
    for head in HEADS.values()
    if head.encoding is not None
}
#: Kind of a frame's file, also the name of its subfolder -> suffix.
SUFFIXES = {**dict.fromkeys(SAVED_HEADS, ".png"), OVERLAY: ".jpg", CLOUD: ".ply"}
#: What is written unless something else is requested; the others are large.
KINDS = tuple(kind for kind in SUFFIXES if kind != CLOUD)
FRAMES_FILE, REPORT_FILE = "frames.csv", "report.json"
_MARKER = ".ssdnet-run"
_MAX_NAME_BYTES = 255 - max(map(len, SUFFIXES.values()))
_MARKER_TEXT = (
    "Made by ssdnet-run. With --overwrite it may replace its own files here: those of the frames "
    "below.\n"
)


class RunFolder:
    """The folder of a run, with a subfolder for each kind of file.

    A hidden file in it lists the frames whose files belong to the run.

    Args:
        path: is made; a folder that exists must be empty, or, with `overwrite`, hold an earlier
            run, whose files are then removed.
        kinds: kinds of files that will be written, of SUFFIXES.
        names: of the frames.
        overwrite: whether an earlier run may be replaced.

    Raises:
        OutputError: if the folder cannot be used, or if writing there would replace a foreign file
            or follow a link out of the folder; the earlier run is then untouched.
    """

    def __init__(
        self,
        path: Path,
        *,
        kinds: Sequence[str] = KINDS,
        names: Collection[str] = (),
        overwrite: bool = False,
    ) -> None:
        self.path = path
        self._marker = path / _MARKER
        _make(path)
        used = any(path.iterdir())
        if used and not overwrite:
            raise OutputError(
                f"the output folder {path} is not empty: choose another --out, or replace an "
                "earlier run with --overwrite"
            )
        if used and not self._marker.is_file():
            raise OutputError(
                f"the output folder {path} holds files that ssdnet-run did not make: it "
                "replaces only its own runs, choose another --out"
            )
        if used:
            earlier = _read_names(self._marker)
            for kind in kinds:
                _require_free(path / kind, SUFFIXES[kind], names, earlier)
            self._remove_run(earlier)
        self.subfolders = {kind: path / kind for kind in kinds}
        for folder in self.subfolders.values():
            _make(folder)
        atomic_write(self._marker, _MARKER_TEXT.encode())
        with _reported(f"cannot write {self._marker}"):
            # Kept open: writing competes with inference for the processor.
            self._names = os.open(self._marker, os.O_WRONLY | os.O_APPEND)

    def add_name(self, name: str) -> None:
        """Add a frame to the list on disk, before its files are written. Raises OutputError."""
        with _reported(
            f"cannot write {self._marker}",
            "free some space or choose another --out; files that were already complete are kept",
        ):
            # As JSON, since a name may contain line feeds.
            os.write(self._names, (json.dumps(name) + "\n").encode())

    def close(self) -> None:
        """Close the list of names; nothing is written after it."""
        os.close(self._names)

    def _remove_run(self, names: Collection[str]) -> None:
        """Remove an earlier run; the report first, since a run with a report is whole."""
        for file in (REPORT_FILE, FRAMES_FILE):
            _remove(self.path / file)
        for kind, suffix in SUFFIXES.items():
            folder = self.path / kind
            if folder.is_symlink():  # never remove files outside of the run folder
                continue
            for name in names:
                _remove(folder / (name + suffix))


@contextlib.contextmanager
def _reported(fault: str, remedy: str = "choose another --out") -> Iterator[None]:
    """Raise an OSError of the block as an OutputError."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"{fault} ({error.strerror}): {remedy}") from error


def _make(folder: Path) -> None:
    """Make a folder that can be listed. Raises OutputError."""
    with _reported(f"cannot make the output folder {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
        next(folder.iterdir(), None)


def _require_free(folder: Path, suffix: str, names: Collection[str], ours: Collection[str]) -> None:
    """Raise OutputError if a file of `names` in `folder` exists and is not of the earlier run."""
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise OutputError(
            f"{folder} is a link or a file where the run makes a folder: remove it, or "
            "choose another --out"
        )
    for name in names:
        file = folder / (name + suffix)
        if os.path.lexists(file) and (name not in ours or not _removable(file)):
            raise OutputError(
                f"{file} does not belong to the earlier run, but would be replaced: move it away, "
                "or choose another --out"
            )


def _read_names(marker: Path) -> set[str]:
    """Names of the frames whose files belong to the earlier run. Raises OutputError."""
    names = set()
    try:
        content = read_input(marker)
    except InputError as error:
        raise OutputError(f"{error}: choose another --out") from error
    for line in content.decode("ascii", errors="replace").splitlines()[1:]:
        try:
            name = json.loads(line)
            encoded = os.fsencode(name)
        except (ValueError, TypeError, RecursionError):  # cut off, or not of a run
            continue
        if 0 < len(encoded) <= _MAX_NAME_BYTES and not set(encoded) & {0, ord("/")}:
            names.add(name)
    return names


def _remove(path: Path) -> None:
    """Remove a file and what a killed run left of it, but no folder. Raises OutputError."""
    with _reported(f"cannot remove the earlier run's {path}"):
        if _removable(path):
            path.unlink()
    remove_leftover(path)


def _removable(path: Path) -> bool:
    return path.is_file() or path.is_symlink()
