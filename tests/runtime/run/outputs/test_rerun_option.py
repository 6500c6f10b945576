"""--rerun where the extra is not installed, and where the target is none."""

import importlib.util

import pytest


def test_without_the_package_the_command_fails_before_anything_is_written(
    tmp_path, run, monkeypatch
):
    find_spec = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util,
        "find_spec",
        lambda name: None if name == "rerun" else find_spec(name),
    )
    result = run("--rerun", tmp_path / "a.rrd")
    assert result.exit_code == 1
    assert 'pip install -c constraints.txt ".[rerun]"' in result.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("target", ["a.mp4", "viewer", "http://localhost", ""])
def test_a_target_that_is_none_is_a_usage_error(tmp_path, run, target):
    assert run("--rerun", target).exit_code == 2
    assert not (tmp_path / "out").exists()
