"""An output is a file, a row of OUTPUTS and an option."""

import contextlib
import dataclasses
from pathlib import Path

import pytest

from runtime import OutputError
from runtime.app.run.options import RunOptions
from runtime.app.run.outputs import registry
from runtime.app.run.run import run


def test_another_output_is_a_row_and_an_option(tmp_path, stream, all_heads, monkeypatch):
    """Adding an output takes a context manager in a file of its own, ..."""

    @contextlib.contextmanager
    def open_nearest(run):
        lines = []

        class Nearest:
            def write(self, frame, result):
                lines.append(f"{frame.name} {result.prediction.depth.min():.2f}")

        yield Nearest()
        lines.append(f"{len(run.report.records)} frames")
        run.options.nearest.write_text("\n".join(lines))

    row = registry.OutputRow(open_nearest)  # ... its row, ...
    monkeypatch.setitem(registry.OUTPUTS, "nearest", row)

    @dataclasses.dataclass(frozen=True)
    class Options(RunOptions):  # ... and its option
        nearest: Path | None = None

    rgb, depth = stream
    written = {"out": tmp_path / "out", "nearest": tmp_path / "nearest.txt"}
    options = Options(rgb=rgb, depth=depth, model=str(all_heads), limit=3, **written)
    report = run(options)
    lines = (tmp_path / "nearest.txt").read_text().splitlines()
    assert [line.split()[0] for line in lines[:3]] == [record.name for record in report.records]
    assert lines[3] == "3 frames"

    row = registry.OutputRow(open_nearest, package="no_such_package", extra="nearest")
    monkeypatch.setitem(registry.OUTPUTS, "nearest", row)
    with pytest.raises(OutputError, match=r"--nearest needs the package no_such_package.*nearest"):
        run(dataclasses.replace(options, overwrite=True))
