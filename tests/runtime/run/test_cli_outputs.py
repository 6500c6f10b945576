"""The files that ssdnet-run writes, and those that it leaves alone."""

import json

import pytest
from typer.testing import CliRunner

from cli_runs import N, arguments, files_in, rows_of
from runtime.run.cli import app
from runtime.run.run_folder import KINDS


@pytest.mark.parametrize(
    ("save", "folders"),
    [("none", set()), ("depth,semantic", {"depth", "semantic"}), ("overlay", {"overlay"})],
)
def test_what_is_saved(tmp_path, run, save, folders):
    result = run("--save", save)
    assert result.exit_code == 0
    assert {p.name for p in (tmp_path / "out").iterdir() if p.is_dir()} == folders
    assert len(rows_of(tmp_path / "out")) == N
    assert ("pictures:" in result.stdout) == ("overlay" in folders)


def test_all_that_is_saved_is_what_the_model_answers(tmp_path, stream, model_file):
    given = arguments(stream, model_file(heads=("semantic", "depth")), tmp_path)
    result = CliRunner().invoke(app, [*given, "--limit", "1", "--json"])
    assert json.loads(result.stdout)["saved"] == ["semantic", "depth", "overlay"]
    folders = {p.name for p in (tmp_path / "out").iterdir() if p.is_dir()}
    assert folders == {"semantic", "depth", "overlay"}


def test_what_the_model_does_not_answer_cannot_be_saved(tmp_path, stream, model_file):
    given = arguments(stream, model_file(heads=("semantic", "depth")), tmp_path)
    result = CliRunner().invoke(app, [*given, "--save", "depth,uncertainty"])
    assert result.exit_code == 1
    assert "requests uncertainty, but the model by-hand answers semantic, depth" in result.stderr
    assert not (tmp_path / "out").exists()


def test_a_recording_that_cannot_be_made_is_reported_before_anything_is_made(tmp_path, run):
    (tmp_path / "taken").mkdir()
    result = run("--record", tmp_path / "taken")
    assert result.exit_code == 1
    assert f"{tmp_path / 'taken'} exists: choose another name" in result.output
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("place", "reason"),
    [
        (".", "no name"),
        ("inner/..", "no name"),
        ("file/a", "Not a directory"),
        ("/proc/a", "write"),
    ],
)
@pytest.mark.parametrize("overwrite", [[], ["--overwrite"]], ids=["new", "overwrite"])
def test_a_recording_in_an_impossible_place_is_refused_before_the_run(
    tmp_path, run, monkeypatch, place, reason, overwrite
):
    inner = tmp_path / "here"
    (inner / "inner").mkdir(parents=True)
    (inner / "file").write_text("mine")
    monkeypatch.chdir(inner)
    result = run("--record", place, *overwrite)
    assert result.exit_code == 1, result.exception
    assert result.stderr.startswith("error: ")
    assert reason in result.stderr
    assert not (tmp_path / "out").exists()
    assert sorted(path.name for path in inner.iterdir()) == ["file", "inner"]


def test_an_existing_run_needs_overwrite(tmp_path, run):
    assert run("--limit", 5).exit_code == 0
    before = (tmp_path / "out/report.json").read_bytes()
    result = run("--limit", 2)
    assert result.exit_code == 1
    assert "--overwrite" in result.stderr
    assert (tmp_path / "out/report.json").read_bytes() == before
    assert run("--limit", 2, "--overwrite").exit_code == 0
    assert {p.stem for p in (tmp_path / "out/depth").iterdir()} == {"f0", "f1"}


def test_overwrite_never_replaces_a_foreign_file(tmp_path, run):
    assert run("--limit", 2).exit_code == 0
    (tmp_path / "out/depth/f3.png").write_text("mine")
    before = files_in(tmp_path / "out")
    result = run("--overwrite")
    assert result.exit_code == 1
    assert "out/depth/f3.png does not belong to the earlier run" in result.stderr
    assert files_in(tmp_path / "out") == before
    assert run("--limit", 3, "--overwrite").exit_code == 0
    assert (tmp_path / "out/depth/f3.png").read_text() == "mine"


@pytest.mark.parametrize("kind", ["depth", "semantic"])
def test_answers_are_never_written_where_frames_are_read(tmp_path, run, stream, kind):
    assert run().exit_code == 0
    before = files_in(tmp_path / "out")
    result = run("--depth", tmp_path / "out" / kind, "--overwrite")
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


def test_an_output_folder_that_cannot_be_written(tmp_path, run):
    (tmp_path / "file").touch()
    result = run("--out", tmp_path / "file" / "out")
    assert result.exit_code == 1
    assert "cannot make the output folder" in result.stderr


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
    rgb, depth = stream
    given = ["--rgb", rgb, "--depth", depth, "--limit", 1, "--save", "none", "--model", all_heads]
    for name in ("ssdnet-run", "ssdnet-run-2", "ssdnet-run-3"):
        result = CliRunner().invoke(app, [str(a) for a in given])
        assert result.exit_code == 0, result.output
        assert f"results: {tmp_path / name}\n" in result.stdout
        assert (tmp_path / name / "report.json").exists()
    replaced = CliRunner().invoke(app, [str(a) for a in [*given, "--overwrite"]])
    assert f"results: {tmp_path / 'ssdnet-run'}\n" in replaced.stdout
    refused = CliRunner().invoke(app, [str(a) for a in [*given, "--out", "ssdnet-run"]])
    assert (refused.exit_code, "is not empty" in refused.stderr) == (1, True)


def test_saved_kinds_add_up(tmp_path, run):
    asked = ["--save", "overlay", "--save", "semantic,depth"]
    assert run("--limit", 1, *asked).exit_code == 0
    folders = {path.name for path in (tmp_path / "out").iterdir() if path.is_dir()}
    assert folders == {"overlay", "semantic", "depth"}


@pytest.mark.parametrize(
    "options",
    [
        ["--record", "a", "--out", "a"],
        ["--record", "a", "--out", "a/b"],
        ["--record", "a/b", "--out", "a"],
        ["--record", "link/a", "--out", "a"],
        ["--record", "a", "--video", "a/b.mp4"],
    ],
)
def test_a_recording_apart_from_other_results_is_required_before_the_run(
    tmp_path, stream, run, monkeypatch, options
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "link").symlink_to(tmp_path)
    before = files_in(tmp_path)
    result = run(*options)
    assert result.exit_code == 2
    assert "--record" in result.output
    assert files_in(tmp_path) == before


def test_a_link_that_leads_to_itself_is_an_error(tmp_path, run):
    (tmp_path / "loop").symlink_to("loop")
    for options in (
        ["--out", tmp_path / "loop"],
        ["--out", tmp_path / "loop" / "out"],
        ["--video", tmp_path / "loop" / "a.mp4"],
        ["--record", tmp_path / "loop" / "recording"],
    ):
        result = run(*options)
        assert result.exit_code == 1, options
        assert result.stderr.startswith("error: "), options


@pytest.mark.parametrize("option", ["--out", "--video", "--record"])
def test_a_name_that_is_too_long_is_an_error(tmp_path, run, option):
    name = "n" * 256 + (".mp4" if option == "--video" else "")
    result = run(option, tmp_path / name)
    assert result.exit_code == 1, result.exception
    assert "too long" in result.stderr
