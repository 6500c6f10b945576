"""The folder of a run: an earlier run in it can be replaced, files of others are never touched."""

from collections.abc import Collection, Sequence
from pathlib import Path

from runtime.heads import HEADS
from runtime.io.own_folder import make_own_folder

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


def make_run_folder(
    path: Path,
    *,
    kinds: Sequence[str] = KINDS,
    names: Collection[str] = (),
    overwrite: bool = False,
) -> None:
    """Make the folder of a run, with a subfolder for each kind of file.

    Args:
        path: see `make_own_folder`.
        kinds: kinds of files that will be written, of SUFFIXES.
        names: of the frames.
        overwrite: whether an earlier run may be replaced.

    Raises:
        OutputError: see `make_own_folder`.
    """
    # The report is removed first, since a run with a report is whole.
    files = [Path(REPORT_FILE), Path(FRAMES_FILE)]
    files += [Path(kind, name + SUFFIXES[kind]) for kind in kinds for name in names]
    make_own_folder(path, files, overwrite=overwrite)
