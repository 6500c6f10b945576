"""What a run leaves when it ends: its table, report and picture, and its exit code."""

from pathlib import Path
from typing import Any

from runtime.drawing.latency_plot import draw_latency
from runtime.io.atomic_write import atomic_write
from runtime.io.encode import encode_png
from runtime.run.options import NamedFiles
from runtime.run.pipeline import OK, StreamResult
from runtime.run.run_folder import FRAMES_FILE, LATENCY_FILE, REPORT_FILE
from runtime.run.run_report import frames_csv, missed, to_json

SKIPPED, MISSED = 3, 4  # exit codes


def write_summary(
    out: Path, result: StreamResult, report: dict[str, Any], deadline_ms: float | None
) -> None:
    """Write them into the run's folder, the report last. Raises OutputError."""
    latencies_ms = {
        record.index: record.response_ms
        for record in result.records
        if record.response_ms is not None
    }
    if latencies_ms:
        picture = draw_latency(latencies_ms, deadline_ms=deadline_ms)
        atomic_write(out / LATENCY_FILE, encode_png(picture))
    table = frames_csv(result.records, deadline_ms=deadline_ms)
    # As the file system has them: a name need not be valid text.
    atomic_write(out / FRAMES_FILE, table.encode(errors="surrogateescape"))
    atomic_write(out / REPORT_FILE, to_json(report).encode())  # last: a run with a report is whole


def exit_code(result: StreamResult, deadline_ms: float | None) -> int:
    """0, SKIPPED, or MISSED, which outranks it."""
    late = missed(result.records, deadline_ms)
    if late is not None and late.count:
        return MISSED  # the gate was asked for: it outranks skipped frames
    if result.interrupted or any(record.status != OK for record in result.records):
        return SKIPPED
    return 0


def made_files(files: NamedFiles) -> list[str]:
    """Lines that say where the files that were asked for by name are."""
    return [
        f"{option.removeprefix('--')}: {path.resolve()}"
        for option, (path, _) in files.items()
        if path is not None and path.exists()
    ]
