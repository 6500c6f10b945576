"""Writing the files of each frame of a run: all files of a frame, or none."""

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

from runtime.app.run.options import CLOUD, OVERLAY, SUFFIXES, RunOptions, saved_heads
from runtime.app.run.outputs.run_context import RunContext
from runtime.app.run.run_report import RUN_FILES, write_report
from runtime.drawing.encode import ENCODERS, encode_jpeg, encode_ply
from runtime.files.atomic_write import atomic_write
from runtime.files.own_folder import make_own_folder
from runtime.streams.frame import Frame
from runtime.streams.frame_result import FrameResult


class FrameWriter:
    """Writes the answers to each frame, with one subfolder per kind; see `open_frame_files`."""

    def __init__(self, run: RunContext) -> None:
        self._run = run

    def write(self, frame: Frame, result: FrameResult) -> None:
        """Write all files of one frame; after an error none of them remains. Raises OutputError."""
        written: list[Path] = []
        try:
            for kind in self._run.kinds:
                content = self._encode(kind, frame, result)
                if content is not None:
                    path = self._run.options.folder / kind / _file_name(frame.name, kind)
                    atomic_write(path, content)
                    written.append(path)
        except BaseException:
            for path in written:
                with contextlib.suppress(OSError):  # the first error is reported instead
                    path.unlink(missing_ok=True)
            raise

    def _encode(self, kind: str, frame: Frame, result: FrameResult) -> bytes | memoryview | None:
        run, prediction = self._run, result.prediction
        if kind == CLOUD:
            cloud = run.cloud(frame, prediction)
            assert cloud is not None, "the camera is checked before the run"
            return encode_ply(cloud, run.predictor.contract.classes)
        if kind == OVERLAY:
            return encode_jpeg(run.draw(frame, result))
        head = saved_heads()[kind]
        values = prediction.heads.get(head.name)
        if values is None:
            return None
        run.count_beyond(kind, head.unit, values)
        return ENCODERS[head.unit](values)


def _file_name(frame: str, kind: str) -> str:
    """Return the name of a frame's file; heads of other packages are PNGs, too."""
    return frame + SUFFIXES.get(kind, ".png")


@contextlib.contextmanager
def open_frame_files(run: RunContext) -> Iterator[FrameWriter | None]:
    """Make the folder of --out, with the files of --save and, when the block ends, the report.

    Yields None if no file of a frame is to be written.
    """
    make_run_folder(run.options, run.kinds, run.names)
    yield FrameWriter(run) if run.kinds else None
    write_report(run.report)


def make_run_folder(options: RunOptions, kinds: Sequence[str], names: Sequence[str]) -> None:
    """Make the folder of --out for a run, with a subfolder for each kind of file of its frames.

    With --overwrite an earlier run in it is replaced. Raises OutputError, see `make_own_folder`.
    """
    files = [*RUN_FILES]
    files += [Path(kind, _file_name(name, kind)) for kind in kinds for name in names]
    make_own_folder(options.folder, files, overwrite=options.overwrite)
