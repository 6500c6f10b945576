"""ssdnet-doctor: what works is no fault, what is missing is named with the command to fix it."""

import importlib
import importlib.util
import json
import sys
from importlib.metadata import version
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from runtime import Predictor, list_bundled_models
from runtime.app.tools.doctor import app, examine, self_test
from runtime.base.errors import ProviderError
from runtime.checks.catalog import FINDINGS
from runtime.command.machine import machine_facts
from runtime.command.wording import with_flags


@pytest.fixture
def checks_of(monkeypatch):
    """Give a function that returns all checks by their names, without the self-tests."""
    monkeypatch.setattr("runtime.app.tools.doctor.self_test", lambda *_: SimpleNamespace(name=""))
    return lambda: {check.name: check for check in examine("cpu")}


@pytest.fixture(autouse=True)
def one_frame(monkeypatch):
    """Let each self-test predict one frame."""
    monkeypatch.setattr("runtime.app.tools.doctor._FRAMES", 1)


@pytest.mark.parametrize("models", [
    ["ssdnet-nano-int8"], pytest.param(list_bundled_models(), marks=pytest.mark.slow),
], ids=["one model", "all models"])  # fmt: skip
def test_what_is_installed_here_works(monkeypatch, models):
    monkeypatch.setattr("runtime.engine.bundled_models.list_bundled_models", lambda: models)
    result = CliRunner().invoke(app, [])
    assert result.exit_code == 0, result.output
    *lines, verdict = result.output.splitlines()
    assert verdict == "the engine works on cpu"
    found = {line[8:32].strip(): line[33:] for line in lines}
    tested = {f"{each} on cpu" for each in models}
    assert {name for name in found if name.endswith(" on cpu")} == tested
    assert found["numpy"] == np.__version__
    assert found["ssdnet"] == version("ssdnet")
    assert found["processor"] == machine_facts().processor
    assert "CPUExecutionProvider" in found["onnxruntime"]


def test_no_gpu_is_a_fault_only_where_cuda_is_asked_for(monkeypatch):
    def refuse(self, model, provider, **options):
        raise ProviderError(f"no {provider}: pip install the extra gpu")

    monkeypatch.setattr(Predictor, "__init__", refuse)
    result = CliRunner().invoke(app, ["--provider", "cuda"])
    assert result.exit_code == 1
    assert "no cuda: pip install the extra gpu" in result.output


def test_both_wheels_at_once_are_reported(monkeypatch, checks_of):
    monkeypatch.setattr("runtime.app.tools.doctor.version", lambda name: "1.31.1")
    check = checks_of()["onnxruntime wheels"]
    assert check.status == "warning"
    assert check.remedy.startswith(f"{sys.executable} -m pip uninstall -y onnxruntime onnx")
    assert check.remedy.endswith("-m pip install -c constraints.txt '.[cpu]'")


def test_an_extra_that_is_missing_is_a_note_with_its_command(monkeypatch, checks_of):
    real = importlib.util.find_spec
    monkeypatch.setattr("importlib.util.find_spec", lambda n: None if n == "torch" else real(n))
    checks = checks_of()
    assert "bags and MCAP" not in checks
    assert (checks["training"].status, checks["training"].found[:13]) == ("note", "not installed")
    assert checks["training"].remedy.endswith("-m pip install -c constraints.txt '.[train]'")


@pytest.mark.parametrize(("package", "remedy"), [
    ("numpy", "numpy"), ("cv2", "opencv-python-headless"), ("onnxruntime", "'.[cpu]'"),
])  # fmt: skip
def test_a_broken_package_is_a_fault_beside_the_others(monkeypatch, checks_of, package, remedy):
    """The import may fail with another error than ImportError."""

    def import_module(name, real=importlib.import_module):
        if name == package:
            raise RuntimeError("compiled for another processor")
        return real(name)

    monkeypatch.setattr("runtime.app.tools.doctor.importlib.import_module", import_module)
    checks = checks_of()
    assert (checks[package].status, checks["python"].status) == ("fault", "ok")
    assert "RuntimeError: compiled for another processor" in checks[package].found
    assert checks[package].remedy.endswith(remedy)


def test_an_engine_that_answers_nonsense_is_a_fault(change_run):
    def spoiled(run, feed):
        heads = run()
        heads[1] = heads[1] * np.float32(1.3)
        return heads

    change_run(spoiled)
    check = self_test("ssdnet-nano", "cpu")
    assert check.status == "fault"
    assert "at the median" in check.found
    assert "--force-reinstall" in check.remedy


def test_a_self_test_that_cannot_run_is_a_fault(change_run):
    def fail(run, feed):
        raise RuntimeError("out of memory")

    change_run(fail)
    assert self_test("ssdnet-nano", "cpu").status == "fault"
    assert "no bundled model" in self_test("unknown", "cpu").found


def test_what_a_recording_can_be_found_to_be_is_listed_as_json():
    result = CliRunner().invoke(app, ["--readings"])
    assert result.exit_code == 0
    listed = json.loads(result.stdout)
    assert listed == {name: with_flags(says) for name, says in FINDINGS.items()}
    assert "--calibration" in listed["cut_images"]
