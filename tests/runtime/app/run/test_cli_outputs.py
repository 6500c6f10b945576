"""The files that ssdnet-run writes, and those that it leaves alone."""

import dataclasses
import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cli_runs import N, arguments, files_in, rows_of
from runtime import OutputError
from runtime.app.run.cli import app
from runtime.app.run.options import KINDS, RunOptions
from runtime.app.run.run import run as run_command


@pytest.mark.parametrize(
    ("save", "folders"), [("none", set()), ("depth, overlay", {"depth", "overlay"})]
)
def test_what_is_saved(tmp_path, run, save, folders):
    result = run("--save", save, "--limit", 2)
    assert {p.name for p in (tmp_path / "out").iterdir() if p.is_dir()} == folders
    assert len(rows_of(tmp_path / "out")) == 2
    assert ("pictures:" in result.stdout) == ("overlay" in folders)


def test_answers_are_never_written_where_frames_are_read(tmp_path, run):
    assert run().exit_code == 0
    before = files_in(tmp_path / "out")
    result = run("--depth", tmp_path / "out" / "depth", "--overwrite")
    assert result.exit_code == 1
    assert "choose another --out" in result.stderr
    assert files_in(tmp_path / "out") == before


def test_a_name_that_is_no_text(tmp_path, run, stream):
    """File systems take any bytes."""
    for folder in stream:
        (folder / "f3.png").rename(folder / "f\udcff3.png")
    (stream[1] / "f5.png").rename(stream[1] / "g\udcff5.png")
    result = run()
    assert result.exit_code == 3
    assert r"g\udcff5: skipped" in result.stdout
    table = (tmp_path / "out/frames.csv").read_bytes()
    assert b",f\xff3,ok" in table
    assert (tmp_path / "out/depth" / "f\udcff3.png").is_file()
    assert len(json.loads((tmp_path / "out/report.json").read_text())["frames"]["not_ok"]) == 2


@pytest.mark.parametrize("share", [0.3, 0.8, 1.0])
def test_a_full_disk_is_exit_code_1_with_whole_files_only(tmp_path, run, mount_disk, share):
    """share: of the room that the pictures take; with all of it the tables find none."""
    assert run().exit_code == 0
    pictures = [path for path in (tmp_path / "out").glob("*/*") if path.is_file()]
    pages = sum(-(-path.stat().st_size // 4096) for path in pictures)
    out = mount_disk(4 * (int(share * pages) + 1)) / "out"  # and the list of the run's own files
    result = run("--out", out)
    assert result.exit_code == 1
    assert "No space left on device" in result.stderr
    left = files_in(out)
    assert not [name for name in left if ".part" in name]
    assert "report.json" not in left
    kinds = [{path.stem for path in (out / kind).iterdir()} for kind in KINDS]
    assert kinds == [kinds[0]] * len(KINDS), "every frame has all of its files or none"
    assert len(kinds[0]) == N if share == 1 else 0 < len(kinds[0]) < N
    assert run("--out", out, "--overwrite", "--limit", 1, "--save", "semantic").exit_code == 0


def test_a_second_run_has_a_folder_of_its_own(tmp_path, stream, all_heads, monkeypatch):
    monkeypatch.chdir(tmp_path)
    options = RunOptions(
        rgb=stream[0], depth=stream[1], limit=1, save=["none"], model=str(all_heads)
    )
    names = ("ssdnet-run", "ssdnet-run-2", "ssdnet-run-3")
    assert [run_command(options).out.name for _ in names] == [*names]
    replaced = run_command(dataclasses.replace(options, overwrite=True))
    assert replaced.out.name == "ssdnet-run"
    with pytest.raises(OutputError, match="is not empty"):
        run_command(dataclasses.replace(options, out=Path("ssdnet-run")))
    at_once = [dataclasses.replace(options) for _ in "12"]
    assert [each.folder.name for each in at_once] == ["ssdnet-run-4"] * 2
    assert [run_command(each).out.name for each in at_once] == ["ssdnet-run-4", "ssdnet-run-5"]


def test_only_what_the_model_answers_is_saved(tmp_path, stream, model_file):
    given = arguments(stream, model_file(heads=("semantic", "depth")), tmp_path)
    result = CliRunner().invoke(app, [*given, "--save", "depth,uncertainty"])
    assert result.exit_code == 1
    assert "requests uncertainty, but the model by-hand answers semantic, depth" in result.stderr
    assert not (tmp_path / "out").exists()
    assert CliRunner().invoke(app, [*given, "--limit", "1"]).exit_code == 0
    folders = {p.name for p in (tmp_path / "out").iterdir() if p.is_dir()}
    assert folders == {"semantic", "depth", "overlay"}
    report = json.loads((tmp_path / "out/report.json").read_text())
    assert report["saved"] == ["semantic", "depth", "overlay"]


@pytest.mark.parametrize("place", ["taken", "file/a", "loop/a", "n" * 256])
@pytest.mark.parametrize("option", ["--record", "--out"])
def test_places_that_cannot_be_written_are_errors(tmp_path, run, monkeypatch, option, place):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("mine")
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken/mine").touch()
    (tmp_path / "loop").symlink_to("loop")
    before = files_in(tmp_path)
    result = run(option, place)
    assert result.exit_code == 1, result.exception
    assert result.stderr.startswith("error: ")
    assert files_in(tmp_path) == before
