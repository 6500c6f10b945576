"""`import runtime` is light: the engine is embedded in other people's programs."""

import subprocess
import sys

import runtime


def loaded_after(statement: str) -> set[str]:
    program = f"import sys; {statement}; print(' '.join(sys.modules))"
    result = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    return {name.partition(".")[0] for name in result.stdout.split()}


def test_import_loads_neither_torch_nor_onnx_nor_onnxruntime():
    loaded = loaded_after("import runtime, runtime.stream.cli")
    assert {"runtime", "numpy", "cv2"} <= loaded
    heavy = {"torch", "onnx", "onnxruntime", "models", "training", "export", "scipy"}
    assert not loaded & heavy


def test_projecting_a_scan_loads_no_model_runner():
    loaded = loaded_after("from runtime import OcclusionFilter, project_points")
    assert {"numpy", "cv2"} <= loaded
    assert "onnxruntime" not in loaded


def test_only_the_command_needs_typer():
    assert "typer" not in loaded_after("import runtime")


def test_the_public_names_are_there():
    for name in runtime.__all__:
        assert getattr(runtime, name) is not None
