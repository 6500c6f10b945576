"""For an option that `ssdnet-train` took in earlier releases, one line names the new command."""

import pytest
from typer.testing import CliRunner

from training.commands.train import app


@pytest.mark.parametrize(("arguments", "line"), [
    (
        ["--adapt", "a drive.mcap", "--out", "rig", "--points", "scans"],
        "--adapt is a command of its own: ssdnet-adapt 'a drive.mcap' --out rig --points scans",
    ),
    (
        ["--init", "ssdnet-lite", "--labels", "l", "--images=i", "--out", "r"],
        "--images is a command of its own: "
        "ssdnet-finetune --init ssdnet-lite --labels l i --out r",
    ),
])  # fmt: skip
def test_an_old_spelling_says_the_new_one(arguments, line):
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert result.output.splitlines() == [f"error: {line}"]
