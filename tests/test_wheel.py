"""The wheel has every file of the packages: setuptools' own list against the checkout's."""

from pathlib import Path

import pytest
from setuptools import Distribution

ROOT = Path(__file__).parents[1]
PACKAGES = ("models", "training", "export", "runtime")


@pytest.fixture
def in_wheel(monkeypatch):
    """Paths of the files that a build would copy, relative to the checkout."""
    monkeypatch.chdir(ROOT)
    distribution = Distribution({"script_name": "setup.py"})
    distribution.parse_config_files(["pyproject.toml"])
    command = distribution.get_command_obj("build_py")
    command.ensure_finalized()
    modules = [path for _, _, path in command.find_all_modules()]
    data = [f"{folder}/{name}" for _, folder, _, names in command.data_files for name in names]
    return {Path(path).as_posix() for path in modules + data}


def test_the_wheel_has_every_file_of_the_packages(in_wheel):
    in_checkout = {
        path.relative_to(ROOT).as_posix()
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert in_wheel == in_checkout
