"""The options of a run are those of its command, and are checked before anything is opened."""

import dataclasses
import inspect
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from runtime.command import Provider
from runtime.run import cli
from runtime.run.options import RunOptions, UsageError


def test_every_option_of_the_command_reaches_the_run(monkeypatch):
    given = {}

    class Stop(Exception):
        pass

    def keep(**options):
        given.update(options)
        raise Stop

    parameters = inspect.signature(cli.main).parameters
    options = {name: f"the {name}" for name in parameters}
    options["provider"] = Provider.cuda
    monkeypatch.setattr(cli, "RunOptions", keep)
    with pytest.raises(Stop):
        cli.main(**options)
    assert given.keys() == {field.name for field in dataclasses.fields(RunOptions)}
    assert given == {name: options[name] for name in given}
    assert parameters.keys() - given.keys() == {
        "as_json", "_device", "_list_models", "_version"
    }  # fmt: skip


def test_the_defaults_are_those_of_the_command():
    parameters = inspect.signature(cli.main).parameters
    for field in dataclasses.fields(RunOptions):
        assert parameters[field.name].default == field.default, field.name


def test_help_groups_the_options():
    lines = CliRunner().invoke(cli.app, ["--help"]).stdout.splitlines()
    titles = [line for line in lines if re.fullmatch(r"[A-Z][a-z ]+:", line)]
    assert titles == [
        *("Arguments:", "Input:", "Outputs:", "Model:", "Timing:", "Other:"),
    ]
    for option, title in (("--rgb", "Input:"), ("--video", "Outputs:"), ("--rate", "Timing:")):
        (at,) = (number for number, line in enumerate(lines) if line.startswith(f"  {option} "))
        assert [line for line in lines[:at] if line in titles][-1] == title


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"demo": True, "rgb": Path("a")},
        {"demo": True, "save": ["everything"]},
        {"demo": True, "rate": float("nan")},
        {"demo": True, "shard": "5/4"},
        {"demo": True, "size": "large"},
        {"source": "tape:here"},
    ],
)
def test_wrong_options_are_usage_errors(options):
    with pytest.raises(UsageError):
        RunOptions(**options)


@pytest.mark.parametrize(
    ("option", "value", "text"),
    [
        ("limit", 0, "--limit must be a whole number of 1 to"),
        ("threads", -3, "--threads must be a whole number of 1 to"),
        ("warmup", -1, "--warmup must be a whole number of 0 to"),
        ("overlay_width", 1, "--overlay-width must be a whole number of 16 to 8192, got 1"),
        ("overlay_width", 20.5, "--overlay-width must be a whole number"),
        ("rate", 0, "--rate must be 0.001 to 1e+06, got 0"),
        ("deadline_ms", float("inf"), "--deadline-ms must be"),
        ("max_skew_ms", -1, "--max-skew-ms must be"),
        ("focal_length", 0.5, "--focal-length must be 1 to 1e+06, got 0.5"),
    ],
)
def test_numbers_out_of_range_are_usage_errors_from_python_also(option, value, text):
    with pytest.raises(UsageError, match=f"^{re.escape(text)}"):
        RunOptions(demo=True, **{option: value})


def test_options_are_parsed_once(tmp_path):
    options = RunOptions(rgb=tmp_path, save=["cloud, depth", "boundary"], shard="2/3", size="40x56")
    assert options.kinds == ("depth", "boundary", "cloud")
    assert options.network_size == (40, 56)
    assert list(options.shard_of(range(8))) == [1, 4, 7]
    assert options.source_path == ("folders", tmp_path, {})
    assert options.named_files == {}


def test_a_folder_that_was_not_named_is_a_new_one_also_of_runs_at_the_same_time(
    tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    first, second = RunOptions(demo=True), RunOptions(demo=True)
    assert first.folder == second.folder == Path("ssdnet-run")
    for options in (first, second):
        options.claim_folder()
    assert (first.folder, second.folder) == (Path("ssdnet-run"), Path("ssdnet-run-2"))
    assert all(options.folder.is_dir() for options in (first, second))
    RunOptions(demo=True, out=Path("named")).claim_folder()
    assert not Path("named").exists()
