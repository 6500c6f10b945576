"""ssdnet-doctor: what works is no fault, what is missing is named with the command to fix it."""

import json
import os
import subprocess
import sys
from importlib.metadata import version
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from runtime import list_bundled_models
from runtime.io.engine_facts import machine_facts
from runtime.tools import cuda_libraries, doctor
from runtime.tools.doctor_cli import app

CUDA = "CUDAExecutionProvider"


@pytest.fixture
def passed(monkeypatch):
    """The self-test passes without running."""
    test = doctor.Check("self-test", "ok", "as if")
    monkeypatch.setattr(doctor, "self_test", lambda model, provider, seconds: test)


@pytest.fixture
def fake_runtime(monkeypatch, passed):
    """Install a stand-in for onnxruntime with those providers and these libraries."""

    def install(*providers, libraries=(), cuda_version="13.0", wheels=("onnxruntime-gpu",)):
        module = SimpleNamespace(
            __version__="1.31.1",
            cuda_version=cuda_version,
            get_available_providers=lambda: list(providers),
        )
        monkeypatch.setitem(sys.modules, "onnxruntime", module)
        monkeypatch.setattr(
            doctor, "find_library", lambda name: f"/lib/{name}" if name in libraries else None
        )
        real = doctor.installed
        numbers = dict.fromkeys(wheels, "1.31.1")
        monkeypatch.setattr(
            doctor,
            "installed",
            lambda name: numbers.get(name) if name.startswith("onnxruntime") else real(name),
        )

    return install


def examine(provider):
    return {check.name: check for check in doctor.examine(provider)}


def faults(provider):
    return {name: check.remedy for name, check in examine(provider).items() if _is_fault(check)}


def _is_fault(check):
    return check.status == "fault"


def test_what_is_installed_here_works(monkeypatch):
    test = doctor.self_test
    monkeypatch.setattr(  # for as short as one frame
        doctor, "self_test", lambda model, provider, seconds: test(model, provider, seconds=0)
    )
    result = CliRunner().invoke(app, [])
    assert result.exit_code == 0, result.output
    lines = result.output.splitlines()
    assert lines[-1] == "the engine works on cpu"
    for model in list_bundled_models():
        assert any(line.startswith(f"ok      {model} on cpu") for line in lines)
    assert lines[-2].startswith("note    fastest model here")


def test_the_fastest_model_is_named(monkeypatch):
    median_ms = {"ssdnet-lite": 9.0, "ssdnet-nano": 4.0}
    monkeypatch.setattr("runtime.bundled_models.list_bundled_models", lambda: list(median_ms))
    monkeypatch.setattr(
        doctor,
        "self_test",
        lambda model, provider, seconds: doctor.Check(model, "ok", "", "", median_ms[model]),
    )
    assert list(doctor.examine("cpu"))[-1].found == "ssdnet-nano, 4.0 ms"


def test_json_lists_every_check(passed):
    result = CliRunner().invoke(app, ["--json"])
    document = json.loads(result.output)
    assert (result.exit_code, document["ok"], document["provider"]) == (0, True, "cpu")
    told = {check["name"]: check for check in document["checks"]}
    assert told["numpy"]["found"] == np.__version__
    assert told["ssdnet"]["found"] == version("ssdnet")
    assert told["processor"]["found"] == machine_facts().processor
    assert "CPUExecutionProvider" in told["providers"]["found"]


def test_no_gpu_is_a_fault_only_where_cuda_is_asked_for(fake_runtime):
    fake_runtime("CPUExecutionProvider", wheels=("onnxruntime",), cuda_version=None)
    assert faults("cpu") == {}
    pip = f"{sys.executable} -m pip"
    assert faults("cuda") == {
        "providers": f"{pip} uninstall -y onnxruntime && {pip} install -c constraints.txt '.[gpu]'",
        "libcuda.so.1": "install NVIDIA's driver: it comes with the system, not with pip",
    }
    assert CliRunner().invoke(app, ["--provider", "cuda"]).exit_code == 1
    assert CliRunner().invoke(app, ["--provider", "cpu"]).exit_code == 0


def test_the_library_that_is_missing_is_named_with_its_line(fake_runtime):
    there = set(cuda_libraries.library_names(13)) - {"libcudnn.so.9"}
    fake_runtime(CUDA, "CPUExecutionProvider", libraries=there)
    line = f"{sys.executable} -m pip install 'onnxruntime-gpu[cuda,cudnn]==1.31.1'"
    assert faults("cuda") == {"libcudnn.so.9": line}
    assert examine("cuda")["libcudart.so.13"].found == "/lib/libcudart.so.13"


def test_the_libraries_are_those_of_the_runtimes_cuda(fake_runtime):
    fake_runtime(CUDA, "CPUExecutionProvider", cuda_version="12.8")
    missing = faults("cuda")
    assert {"libcublas.so.12", "libcufft.so.11"} <= missing.keys()
    assert not any(name.endswith(".13") for name in missing)


def test_both_wheels_at_once_are_reported(fake_runtime):
    fake_runtime("CPUExecutionProvider", wheels=("onnxruntime", "onnxruntime-gpu"))
    check = examine("cpu")["onnxruntime wheel"]
    assert check.status == "warning"
    assert check.remedy.startswith(f"{sys.executable} -m pip uninstall -y onnxruntime onnx")
    assert check.remedy.endswith("-m pip install -c constraints.txt '.[cpu]'")


def test_without_onnxruntime_the_rest_is_still_reported(monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    checks = examine("cpu")
    assert checks["numpy"].status == "ok"
    assert (
        checks["onnxruntime"].remedy
        == f"{sys.executable} -m pip install -c constraints.txt '.[cpu]'"
    )
    assert faults("cpu").keys() == {"onnxruntime"}


def test_a_package_that_cannot_be_imported_is_named(monkeypatch, passed):
    monkeypatch.setitem(sys.modules, "cv2", None)
    assert "opencv-python-headless" in faults("cpu")["cv2"]


def test_a_library_in_nvidias_wheels_is_found(tmp_path, monkeypatch):
    library = tmp_path / "nvidia" / "cu13" / "lib" / "libcublas.so.13"
    library.parent.mkdir(parents=True)
    library.touch()
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    assert cuda_libraries.find_library("libcublas.so.13") == str(library)
    assert cuda_libraries.find_library("libnobody_has_this.so.13") is None


@pytest.mark.parametrize(
    ("spoiled", "told"), [(1.3, "30% of the distance"), (np.nan, "nan% of the distance")]
)
def test_an_engine_that_answers_nonsense_is_a_fault(monkeypatch, spoiled, told):
    class Broken:
        def __init__(self, model, **options):
            assert options["provider"] == "cpu"

        def __enter__(self):
            return self

        def __exit__(self, *error):
            pass

        def predict(self, rgb, sparse_depth):
            latency = SimpleNamespace(total_ms=1.0)
            depth = sparse_depth * np.float32(spoiled)
            return SimpleNamespace(valid=True, degraded=(), depth=depth, latency=latency)

    monkeypatch.setattr("runtime.predictor.Predictor", Broken)
    check = doctor.self_test("ssdnet-nano", "cpu", seconds=0)
    assert check.status == "fault"
    assert told in check.found
    assert "--force-reinstall" in check.remedy


def test_a_self_test_that_cannot_run_is_a_fault(monkeypatch):
    monkeypatch.setattr("runtime.bundled_models.list_bundled_models", list)
    check = list(doctor.examine("cpu", seconds=0))[-1]
    assert (check.status, "no bundled model" in check.found) == ("fault", True)


@pytest.mark.parametrize("module", ["cv2", "onnxruntime"])
def test_the_command_starts_where_a_package_is_broken(module):
    program = (
        f"import sys; sys.modules[{module!r}] = None; sys.argv = ['ssdnet-doctor'];"
        "from runtime.tools.commands import doctor; doctor()"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, env={**os.environ}
    )
    assert done.returncode == 1, done.stderr
    assert "Traceback" not in done.stderr
    assert ".[cpu]" in done.stdout or "opencv-python-headless" in done.stdout


class Broken:
    """A package whose import fails otherwise than with ImportError."""

    def __init__(self, name):
        self.name = name

    def find_spec(self, name, path=None, target=None):
        if name == self.name:
            raise RuntimeError("compiled for another processor")


@pytest.mark.parametrize("package", ["numpy", "cv2", "onnxruntime"])
def test_a_package_that_fails_in_its_own_way_is_a_fault_beside_the_others(
    monkeypatch, passed, package
):
    for name in list(sys.modules):
        if name.partition(".")[0] == package:
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(sys, "meta_path", [Broken(package), *sys.meta_path])
    result = CliRunner().invoke(app, ["--json"])
    assert result.exit_code == 1, result.exception
    checks = {check["name"]: check for check in json.loads(result.stdout)["checks"]}
    assert checks[package]["status"] == "fault"
    assert "RuntimeError: compiled for another processor" in checks[package]["found"]
    assert checks[package]["remedy"]
    assert checks["python"]["status"] == "ok"


def test_an_empty_onnxruntime_is_a_fault(monkeypatch, passed):
    monkeypatch.setitem(sys.modules, "onnxruntime", SimpleNamespace())
    found = examine("cpu")["onnxruntime"]
    assert found.status == "fault"
    assert "get_available_providers" in found.found


def test_a_self_test_that_fails_in_its_own_way_is_a_fault(monkeypatch):
    def fail(*given, **options):
        raise RuntimeError("out of memory")

    monkeypatch.setattr("runtime.predictor.Predictor", fail)
    found = doctor.self_test("ssdnet-nano", "cpu", seconds=0.0)
    assert (found.status, found.found) == ("fault", "not run: RuntimeError: out of memory")
