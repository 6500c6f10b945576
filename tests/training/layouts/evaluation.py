"""`ssdnet-eval` as it is typed."""

import json
import tempfile
from pathlib import Path

from typer.testing import CliRunner

from training.evaluation.cli import app


def run(*arguments):
    return CliRunner().invoke(app, [*map(str, arguments), "--threads", "1"])


def score(*arguments):
    """Run the command, which must succeed; return the rows and the output."""
    with tempfile.TemporaryDirectory() as folder:
        result = run(*arguments, "--json", Path(folder) / "rows.json")
        assert result.exit_code == 0, result.output
        return json.loads((Path(folder) / "rows.json").read_text()), result.output
