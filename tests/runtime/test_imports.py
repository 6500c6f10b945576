"""What is imported loads no more than it needs: the engine is embedded in other programs."""

import importlib.util
import inspect
import subprocess
import sys
from typing import get_args, get_type_hints

import pytest

import runtime

ENGINE = {"cv2", "onnxruntime"}
needs_torch = pytest.mark.skipif(
    importlib.util.find_spec("torch") is None, reason="the engine alone is installed"
)


def words_printed_by(program: str) -> list[str]:
    """Run a program in a fresh interpreter, which has imported nothing before."""
    command = [sys.executable, "-c", program]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()


def loaded_after(statement: str) -> set[str]:
    """The top-level packages."""
    modules = words_printed_by(f"import sys; {statement}; print(*sys.modules)")
    return {name.partition(".")[0] for name in modules}


@pytest.mark.parametrize("statement", [
    "import runtime",
    pytest.param("from models import load_checkpoint, save_checkpoint", marks=needs_torch),
    "from runtime.contract.contract import Contract",
    "from runtime import Contract, SSDNetError, __version__",
])  # fmt: skip
def test_the_leaves_load_neither_opencv_nor_onnxruntime(statement):
    loaded = loaded_after(statement)
    assert "runtime" in loaded
    assert not loaded & {*ENGINE, "typer"}


def test_the_leaves_of_files_and_errors_need_nothing_but_python():
    statement = "import runtime.base.errors, runtime.files.atomic_write, runtime.command.process"
    assert loaded_after(statement) - {"runtime"} <= sys.stdlib_module_names | loaded_after("pass")


HEAVY = {"torch", "onnx", "models", "training", "export", "scipy"}


@pytest.mark.parametrize(("statement", "needed", "unwanted"), [
    ("from runtime import Predictor; Predictor", {"numpy", "cv2"}, {"typer"}),
    (
        "import runtime.app.run.cli",
        {"numpy", "cv2", "typer"},
        {"onnxruntime", "rosbags", "ruamel", "apsw", "jinja2"},
    ),
    ("import runtime.app.tools.doctor", {"typer"}, {*ENGINE, "numpy"}),
    ("import runtime.app.tools.bench", {"numpy", "typer"}, {*ENGINE, "psutil"}),
])  # fmt: skip
def test_a_command_loads_nothing_that_it_does_not_need(statement, needed, unwanted):
    loaded = loaded_after(statement)
    assert {"runtime", *needed} <= loaded
    assert not loaded & (HEAVY | unwanted)


def test_the_public_names_are_there():
    for name in runtime.__all__:
        assert getattr(runtime, name) is not None
    assert set(runtime.__all__) <= set(words_printed_by("import runtime; print(*dir(runtime))"))
    everything: dict[str, object] = {}
    exec("from runtime import *", everything)
    assert set(runtime.__all__) <= set(everything)


def types_in(annotation):
    """The classes of this package in a type hint."""
    for part in get_args(annotation):
        yield from types_in(part)
    if inspect.isclass(annotation) and annotation.__module__.startswith("runtime."):
        yield annotation


def test_every_type_in_a_public_signature_is_public():
    public = [getattr(runtime, name) for name in runtime.__all__]
    names = {"Calibration": runtime.Calibration, "PointCloud": runtime.PointCloud}
    for item in public:
        members = [item, *vars(item).values()] if inspect.isclass(item) else [item]
        for member in members:
            function = getattr(member, "fget", None) or getattr(member, "__func__", member)
            if not inspect.isclass(function) and not inspect.isfunction(function):
                continue
            if function.__name__.startswith("_") and function.__name__ != "__init__":
                continue
            names |= vars(inspect.getmodule(function))
            for name, hint in get_type_hints(function, names).items():
                missing = [each for each in types_in(hint) if each not in public]
                assert name.startswith("_") or not missing, (function.__qualname__, name)


def test_the_engine_and_the_streams_work_without_what_only_the_commands_need():
    program = """
import sys
for name in ("typer", "jinja2", "lzf", "rosbags"):
    sys.modules[name] = None  # an import raises ImportError
import numpy as np
from runtime import Predictor, PushStream

rgb = np.zeros((64, 96, 3), np.uint8)
depth = np.full((64, 96), 10, np.float32)
with Predictor("ssdnet-nano", threads=1) as predictor:
    prediction = predictor.predict(rgb, depth)
    print(prediction.draw(rgb).ndim, end=" ")
    with PushStream(predictor, on_result=lambda result: print(type(result).__name__)) as stream:
        stream.push_image(rgb, 1.0)
        stream.push_depth(depth, 1.0)
"""
    assert words_printed_by(program) == ["3", "FrameResult"]
