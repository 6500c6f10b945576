"""ssdnet-run stopped at any moment: what is on disk is listed, and nobody sees a traceback."""

import signal
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

import runtime.app.run.cli
import runtime.app.run.pipeline
import runtime.app.run.run
from cli_runs import rows_of
from runtime.app.run.cli import app
from runtime.app.run.options import KINDS

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX signals")

N = 4


@pytest.fixture
def command(tmp_path, make_stream, all_heads):
    """The options of a run on a stream of N frames into tmp_path/out."""
    rgb, depth = map(str, make_stream(N))
    paths = ["--rgb", rgb, "--depth", depth, "--model", str(all_heads)]
    return [*paths, "--out", str(tmp_path / "out"), "--threads", "1", "--warmup", "1"]


def require_consistent(out: Path) -> list[str]:
    """Check that every kind of picture is there of what is listed and of nothing else."""
    listed = [row["name"] for row in rows_of(out)] if (out / "frames.csv").exists() else []
    for kind in KINDS:
        folder = out / kind
        assert sorted(path.stem for path in folder.glob("*")) == sorted(listed), kind
        assert not list(folder.glob(".*")), "something unfinished"
    return listed


class SignalAtLine:
    """A trace function that sends this process a signal at the n-th line run of these files."""

    files = (
        runtime.app.run.cli.__file__,
        runtime.app.run.run.__file__,
        runtime.app.run.pipeline.__file__,
    )

    def __init__(self, at: int) -> None:
        self.left = at

    def __call__(self, frame, event, argument):
        if frame.f_code.co_filename not in self.files:
            return None
        if event == "line":
            self.left -= 1
            if self.left == 0:
                signal.raise_signal(signal.SIGINT)
        return self


@pytest.mark.slow
def test_at_every_line_of_the_main_thread(tmp_path, command):
    """The lines are those that start, feed and end the run; every fifth is tried to save time."""
    listed, line = [], 0
    while True:
        line += 5
        out = tmp_path / f"out{line}"
        trace = SignalAtLine(line)
        sys.settrace(trace)
        try:
            done = CliRunner().invoke(app, [*command, "--out", str(out)])
        finally:
            sys.settrace(None)
        assert "Traceback" not in done.output
        listed.append(len(require_consistent(out)))
        possible = {0: {N}, 3: set(range(N + 1)), 130: {0, N}}  # whole, interrupted, outside
        assert listed[-1] in possible[done.exit_code], (line, done.output)
        assert ("interrupted" in done.output) == (done.exit_code == 3)
        if trace.left > 0:  # the run has no such line
            break
    assert set(listed) >= {0, 1, 2, 3, N}
