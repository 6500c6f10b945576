"""`ssdnet-doctor`: what works, what is missing, and the command that fixes it.

Packages are imported one by one, so a broken one does not hide the others.
"""

import importlib
import importlib.util
import json
import shlex
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Annotated, Literal

import typer

from runtime.base.errors import SSDNetError
from runtime.command.machine import machine_facts
from runtime.command.options import Provider, Version
from runtime.command.process import ERROR, print_result, reported_errors

# A "note" is a fact, or something missing that is not needed; only a "fault" fails.
Status = Literal["ok", "note", "warning", "fault"]

_ENGINE = {"numpy": "numpy", "cv2": "opencv-python-headless"}  # distribution of each module
# What needs each extra, and a module that it installs.
_EXTRAS = {
    "bag": ("bags and MCAP", "rosbags"),
    "train": ("training", "torch"),
    "export": ("export", "onnx"),
}
_ORT_WHEELS = ("onnxruntime", "onnxruntime-gpu")
_FRAMES = 10  # in a self-test
_MOST_DEPTH_ERROR = 0.1  # median relative error at returns; more than the model's error

app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)


@app.command(epilog="Exit codes: 0 the engine works; 1 a fault was found; 2 usage.")
def doctor(
    provider: Annotated[Provider, typer.Option(help="Provider of the self-test.")] = Provider.cpu,
    readings: Annotated[
        bool,
        typer.Option(
            "--readings",
            help="Print what a recording can be found to be, by the names that --accept takes, as "
            "JSON, and end.",
        ),
    ] = False,
    _version: Version = False,
) -> None:
    """Report versions and providers, and run each bundled model."""
    with reported_errors("cpu"):
        if readings:
            from runtime.checks.catalog import FINDINGS  # loads NumPy

            print_result(json.dumps(FINDINGS, indent=2))
            raise typer.Exit
        faults = 0
        for check in examine(provider.value):
            faults += check.status == "fault"
            remedy = f"\n{'':8}-> {check.remedy}" if check.remedy else ""
            print_result(f"{check.status:8}{check.name:24} {check.found}{remedy}")
        faulty = f"{faults} faulty: each says what to do, in a clone of ssdnet"
        print_result(faulty if faults else f"the engine works on {provider.value}")
        raise typer.Exit(ERROR if faults else 0)


@dataclass(frozen=True)
class Check:
    """The result of one check; `remedy` is a command line, or an instruction."""

    name: str
    status: Status
    found: str
    remedy: str = ""


def examine(provider: str) -> Iterator[Check]:
    """Run all checks, with self-tests on "cpu" or "cuda", and yield each result at once."""
    machine = machine_facts()
    yield Check("python", "ok", f"{machine.python} on {machine.system}")
    yield Check("processor", "note", machine.processor)
    yield Check("ssdnet", "ok", _installed("ssdnet") or "not installed")
    for module, distribution in _ENGINE.items():
        yield _package(module, _pip("install", "--force-reinstall", "--no-deps", distribution))
    extra = "gpu" if provider == "cuda" else "cpu"
    install = _pip("install", "-c", "constraints.txt", f".[{extra}]")
    if all(map(_installed, _ORT_WHEELS)):
        fault = f"{' and '.join(_ORT_WHEELS)} own the same files and exclude each other"
        remedy = f"{_pip('uninstall', '-y', *_ORT_WHEELS)} && {install}"
        yield Check("onnxruntime wheels", "warning", fault, remedy)
    for extra, (what, module) in _EXTRAS.items():
        if importlib.util.find_spec(module) is None:
            remedy = _pip("install", "-c", "constraints.txt", f".[{extra}]")
            yield Check(what, "note", f"not installed ({module})", remedy)
    yield (onnxruntime := _package("onnxruntime", install))
    if onnxruntime.status == "ok":
        from runtime.engine.bundled_models import DEFAULT_MODEL, list_bundled_models  # loads NumPy

        for model in list_bundled_models() or [DEFAULT_MODEL]:
            yield self_test(model, provider)


def _installed(distribution: str) -> str | None:
    """The version of an installed distribution."""
    try:
        return version(distribution)
    except PackageNotFoundError:
        return None


def _pip(*arguments: str) -> str:
    """A pip command line for the running Python."""
    return shlex.join([sys.executable, "-m", "pip", *arguments])


def _package(module: str, remedy: str) -> Check:
    """Whether a package can be imported; for ONNX Runtime also its providers."""
    try:
        imported = importlib.import_module(module)
        versions = str(imported.__version__)
        if module == "onnxruntime":
            versions += f": {', '.join(imported.get_available_providers())}"
    except Exception as error:  # a package may fail with any exception
        return Check(module, "fault", f"{type(error).__name__}: {error}", remedy)
    return Check(module, "ok", versions)


def self_test(model: str, provider: str) -> Check:
    """Predict bundled frames with a bundled model, and check the answers."""
    name = f"{model} on {provider}"
    try:
        import numpy as np

        from runtime.engine.predictor import Predictor
        from runtime.recordings.bundled_stream import BUNDLED_FOCAL_LENGTH_PX, bundled_frames

        times_ms, errors = [], []
        focal_px = BUNDLED_FOCAL_LENGTH_PX
        with Predictor(model, provider=provider, focal_length_px=focal_px) as predictor:
            for frame in bundled_frames()[:_FRAMES]:
                prediction = predictor.predict(frame.rgb, frame.sparse_depth)
                seen = frame.sparse_depth > 0
                ratio = prediction.heads["depth"][seen] / frame.sparse_depth[seen]
                errors.append(np.median(np.abs(ratio - 1)))
                times_ms.append(prediction.latency.total_ms)
    except SSDNetError as error:  # its text says what to do
        return Check(name, "fault", str(error))
    except Exception as error:
        return Check(name, "fault", f"not run: {type(error).__name__}: {error}")
    worst, median_ms = float(np.max(errors)), np.median(times_ms)
    if not worst <= _MOST_DEPTH_ERROR:
        fault = f"depth differs from the returns by {worst:.0%} at the median, it cannot be right"
        return Check(name, "fault", fault, _pip("install", "--force-reinstall", "--no-deps", "."))
    found = f"{len(times_ms)} frames, {median_ms:.1f} ms each at the median; depth within "
    return Check(name, "ok", found + f"{worst:.1%} of the returns at the median")
