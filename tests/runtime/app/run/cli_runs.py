"""The arguments of a run of ssdnet-run, and what it wrote."""

import csv
from pathlib import Path

N = 12
# The command as a program.
COMMAND = "from runtime.app.tools.commands import run; run()"


def arguments(stream: tuple[Path, Path], model: Path, folder: Path) -> list[str]:
    rgb, depth = stream
    given = ["--rgb", rgb, "--depth", depth, "--model", model, "--out", folder / "out"]
    return [str(a) for a in [*given, "--threads", 1]]


def rows_of(out: Path) -> list[dict[str, str]]:
    with (out / "frames.csv").open() as file:
        return list(csv.DictReader(file))


def files_in(folder: Path) -> set[str]:
    return {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}
