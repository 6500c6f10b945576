"""The folder of a run: an earlier run in it can be replaced, files of others are never touched."""

import contextlib
import json
import os
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

from runtime.errors import InputError, OutputError
from runtime.heads import HEADS
from runtime.io.atomic_write import atomic_write, remove_leftover
from runtime.read_input import read_text

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
_MARKER_TEXT = (
    "Made by ssdnet-run. With --overwrite it may replace its own files here: those of the frames "
    "below.\n"
)


def make_run_folder(
    path: Path,
    *,
    kinds: Sequence[str] = KINDS,
    names: Collection[str] = (),
    overwrite: bool = False,
) -> None:
    """Make the folder of a run, with a subfolder for each kind of file.

    A hidden file in it lists the frames whose files belong to the run.

    Args:
        path: a folder that exists must be empty, or, with `overwrite`, hold an earlier run, whose
            files are then removed.
        kinds: kinds of files that will be written, of SUFFIXES.
        names: of the frames.
        overwrite: whether an earlier run may be replaced.

    Raises:
        OutputError: if the folder cannot be used, or if writing there would replace a foreign file
            or follow a link out of the folder; the earlier run is then untouched.
    """
    marker = path / _MARKER
    with _reported(f"cannot make the output folder {path}"):
        path.mkdir(parents=True, exist_ok=True)
        used = any(path.iterdir())
    if used and not overwrite:
        raise OutputError(
            f"the output folder {path} is not empty: choose another --out, or replace an earlier "
            "run with --overwrite"
        )
    if used and not marker.is_file():
        raise OutputError(
            f"the output folder {path} holds files that ssdnet-run did not make: it replaces only "
            "its own runs, choose another --out"
        )
    if used:
        earlier = _read_names(marker)
        for kind in kinds:
            _require_own(path / kind, SUFFIXES[kind], names, earlier)
        _remove_run(path, earlier)
    for kind in kinds:
        with _reported(f"cannot make the output folder {path / kind}"):
            (path / kind).mkdir(exist_ok=True)
    listed = "".join(json.dumps(name) + "\n" for name in names)  # names may contain line feeds
    atomic_write(marker, (_MARKER_TEXT + listed).encode())


@contextlib.contextmanager
def _reported(fault: str) -> Iterator[None]:
    """Raise an OSError of the block as an OutputError."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"{fault} ({error.strerror}): choose another --out") from error


def _read_names(marker: Path) -> set[str]:
    """Names of the frames whose files belong to the earlier run. Raises OutputError."""
    try:
        names = {json.loads(line) for line in read_text(marker).splitlines()[1:]}
        if all(name and {0, ord("/")}.isdisjoint(os.fsencode(name)) for name in names):
            return names
    except (InputError, ValueError, TypeError, RecursionError):
        pass
    raise OutputError(f"{marker}, the list of the run's frames, is damaged: choose another --out")


def _require_own(folder: Path, suffix: str, names: Collection[str], ours: Collection[str]) -> None:
    """Raise OutputError if a file of `names` in `folder` exists and is not of the earlier run."""
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise OutputError(
            f"{folder} is a link or a file where the run makes a folder: remove it, or choose "
            "another --out"
        )
    for name in names:
        file = folder / (name + suffix)
        if os.path.lexists(file) and (name not in ours or not _is_removable(file)):
            raise OutputError(
                f"{file} does not belong to the earlier run, but would be replaced: move it away, "
                "or choose another --out"
            )


def _remove_run(path: Path, names: Collection[str]) -> None:
    """Remove an earlier run; the report first, since a run with a report is whole."""
    files = [path / REPORT_FILE, path / FRAMES_FILE]
    for kind, suffix in SUFFIXES.items():
        if not (path / kind).is_symlink():  # never remove files outside of the run folder
            files += [path / kind / (name + suffix) for name in names]
    for file in files:
        with _reported(f"cannot remove the earlier run's {file}"):
            if _is_removable(file):
                file.unlink()
        remove_leftover(file)


def _is_removable(path: Path) -> bool:
    """Whether there is a file or a link, which a run may have written; never a folder."""
    return path.is_file() or path.is_symlink()
