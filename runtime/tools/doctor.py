"""What is installed, what works, what is missing, and the command that fixes it.

Packages are imported one by one, so a broken one does not hide the others.
"""

import importlib
import platform
import shlex
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Literal

from runtime.errors import SSDNetError
from runtime.io.engine_facts import machine_facts
from runtime.tools.cuda_libraries import DRIVER, cuda_major, find_library, library_names

#: "note" is a fact, or something missing that is not needed; only "fault" fails.
Status = Literal["ok", "note", "warning", "fault"]

_ENGINE = {"numpy": "numpy", "cv2": "opencv-python-headless"}  # module -> distribution
# Distribution -> extras that bring it.
_EXTRAS = {"torch": "train,export", "onnx": "export", "scipy": "train"}
_ORT_WHEELS = ("onnxruntime", "onnxruntime-gpu")
_CUDA_PROVIDER = "CUDAExecutionProvider"
_MOST_DEPTH_ERROR = 0.1  # of a return, at the median: more than the model's error


@dataclass(frozen=True)
class Check:
    """The result of one check; `remedy` is a command line, or an instruction.

    `median_ms` is the time of a prediction in a self-test that passed.
    """

    name: str
    status: Status
    found: str
    remedy: str = ""
    median_ms: float | None = None


def examine(provider: str, *, seconds: float = 1.0) -> Iterator[Check]:
    """Run all checks, and yield each result as it is known.

    Args:
        provider: "cpu" or "cuda": where the self-test runs, and whether the GPU's libraries are
            required.
        seconds: time of the self-test of each bundled model.
    """
    yield Check("python", "ok", f"{platform.python_version()} on {platform.platform()}")
    yield Check("processor", "note", machine_facts().processor)
    yield _package("ssdnet", "ssdnet")
    for module, distribution in _ENGINE.items():
        yield _package(module, distribution)
    for distribution, extras in _EXTRAS.items():
        found = installed(distribution)
        yield Check(distribution, "note", found or f'not installed, only needed for ".[{extras}]"')
    yield _wheel(provider)
    try:
        ort = importlib.import_module("onnxruntime")
        ort.get_available_providers()
    except Exception as error:
        extra = "gpu" if provider == "cuda" else "cpu"
        yield Check("onnxruntime", "fault", _text(error), _install(extra))
        return
    yield _providers(ort, provider)
    yield from _libraries(ort, provider)
    yield from _self_tests(provider, seconds)


def _self_tests(provider: str, seconds: float) -> Iterator[Check]:
    """Yield the self-test of each bundled model, and the fastest."""
    from runtime.bundled_models import DEFAULT_MODEL, list_bundled_models  # loads NumPy

    medians_ms: dict[str, float] = {}
    for model in list_bundled_models() or [DEFAULT_MODEL]:
        check = self_test(model, provider, seconds=seconds)
        yield check
        if check.median_ms is not None:
            medians_ms[model] = check.median_ms
    if medians_ms:
        fastest = min(medians_ms, key=lambda name: medians_ms[name])
        yield Check("fastest model here", "note", f"{fastest}, {medians_ms[fastest]:.1f} ms")


def installed(distribution: str) -> str | None:
    """Return the version of an installed distribution, None if there is none."""
    try:
        return version(distribution)
    except PackageNotFoundError:
        return None


def pip(*arguments: str) -> str:
    """Return the command line of pip for the running Python."""
    return shlex.join([sys.executable, "-m", "pip", *arguments])


def _install(extra: str) -> str:
    return pip("install", "-c", "constraints.txt", f".[{extra}]")


def _package(module: str, distribution: str) -> Check:
    """Whether a package can be imported."""
    found = installed(distribution)
    try:
        imported = None if module == "ssdnet" else importlib.import_module(module)
    except Exception as error:  # a package can fail in any way
        remedy = pip("install", "--force-reinstall", "--no-deps", distribution)
        return Check(module, "fault", _text(error), remedy)
    # Several distributions contain the module cv2: the module's own version is used.
    return Check(module, "ok", getattr(imported, "__version__", None) or found or "not installed")


def _text(error: Exception) -> str:
    return str(error) if isinstance(error, ImportError) else f"{type(error).__name__}: {error}"


def _wheel(provider: str) -> Check:
    found = {name: installed(name) for name in _ORT_WHEELS}
    text = ", ".join(f"{name} {number}" for name, number in found.items() if number) or "none"
    if all(found.values()):
        extra = "gpu" if provider == "cuda" else "cpu"
        remedy = f"{pip('uninstall', '-y', *_ORT_WHEELS)} && {_install(extra)}"
        fault = f"{text}: they own the same files and exclude each other"
        return Check("onnxruntime wheel", "warning", fault, remedy)
    return Check("onnxruntime wheel", "ok" if any(found.values()) else "warning", text)


def _providers(ort: Any, provider: str) -> Check:
    available = ort.get_available_providers()
    found = f"onnxruntime {ort.__version__}: {', '.join(available)}"
    if provider == "cuda" and _CUDA_PROVIDER not in available:
        return Check(
            "providers",
            "fault",
            f"{found}; {_CUDA_PROVIDER} is missing",
            f"{pip('uninstall', '-y', 'onnxruntime')} && {_install('gpu')}",
        )
    return Check("providers", "ok", found)


def _libraries(ort: Any, provider: str) -> Iterator[Check]:
    if sys.platform != "linux":
        yield Check("CUDA libraries", "note", "looked for on Linux only")
        return
    has_cuda = _CUDA_PROVIDER in ort.get_available_providers()
    for name in library_names(cuda_major(getattr(ort, "cuda_version", None))):
        path = find_library(name)
        if path is not None:
            yield Check(name, "ok", path)
        elif provider != "cuda":
            yield Check(name, "note", 'missing, only needed for "--provider cuda"')
        elif not has_cuda and name != DRIVER:
            yield Check(name, "note", "missing, installed with the missing wheel")
        elif name == DRIVER:
            remedy = "install NVIDIA's driver: it comes with the system, not with pip"
            yield Check(name, "fault", "missing", remedy)
        else:
            wheel = f"onnxruntime-gpu[cuda,cudnn]=={ort.__version__}"
            yield Check(name, "fault", "missing", pip("install", wheel))


def self_test(model: str, provider: str, *, seconds: float) -> Check:
    """Predict bundled frames with a bundled model, and check the answers."""
    name = f"{model} on {provider}"
    reinstall = pip("install", "--force-reinstall", "--no-deps", ".")
    try:
        times_ms, error = _predict_bundled(model, provider, seconds)
    except SSDNetError as problem:  # its text says what to do
        return Check(name, "fault", str(problem))
    except _WrongAnswerError as problem:
        return Check(name, "fault", str(problem), reinstall)
    except Exception as problem:
        return Check(name, "fault", f"not run: {_text(problem)}")
    middle_ms = sorted(times_ms)[len(times_ms) // 2]
    return Check(
        name,
        "ok",
        f"{len(times_ms)} frames, {middle_ms:.1f} ms each at the median; depth within "
        f"{error:.1%} of the returns at the median",
        median_ms=middle_ms,
    )


class _WrongAnswerError(Exception):
    """The answers of the engine are impossible."""


def _predict_bundled(model: str, provider: str, seconds: float) -> tuple[list[float], float]:
    """Return the time of each prediction [ms], and the worst frame's depth error as a share."""
    import numpy as np

    from runtime.predictor import Predictor
    from runtime.sources.bundled_stream import BUNDLED_FOCAL_LENGTH_PX, bundled_frames

    times_ms, errors = [], []
    with Predictor(model, provider=provider, focal_length_px=BUNDLED_FOCAL_LENGTH_PX) as predictor:
        end = time.perf_counter() + seconds
        for number, frame in enumerate(bundled_frames()):
            prediction = predictor.predict(frame.rgb, frame.sparse_depth)
            if not prediction.valid or prediction.depth is None:
                reasons = ", ".join(prediction.degraded) or "no depth"
                raise _WrongAnswerError(f"the answer for frame {number} cannot be used: {reasons}")
            seen = frame.sparse_depth > 0
            measured = frame.sparse_depth[seen]
            errors.append(float(np.median(np.abs(prediction.depth[seen] / measured - 1))))
            times_ms.append(prediction.latency.total_ms)
            if time.perf_counter() > end:
                break
    worst = max(errors)
    if not worst <= _MOST_DEPTH_ERROR:
        raise _WrongAnswerError(
            f"the median depth error is {worst:.0%} of the distance, expected at most "
            f"{_MOST_DEPTH_ERROR:.0%}: the model or the installation is broken"
        )
    return times_ms, worst
