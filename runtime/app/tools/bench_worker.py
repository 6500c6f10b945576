"""A model in its own process, which is opened once and run as often as requested."""

import contextlib
import re
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from runtime.base.errors import SSDNetError
from runtime.contract.model_file import read_onnx
from runtime.engine.bundled_models import find_model
from runtime.engine.example_inputs import make_feeds
from runtime.engine.session import describe_error, import_onnxruntime, open_session


@dataclass(frozen=True)
class OpenedModel:
    """Facts about an open model; a fact is None if it is unknown."""

    shapes: dict[str, tuple[int, ...]]  # shapes of the inputs
    notes: tuple[str, ...]  # differences from the requested shapes
    load_ms: float  # time of reading and optimising the file
    first_inference_ms: float
    peak_memory_mb: float | None  # of the process after two runs


_process = threading.local()  # holds `run`, a call of the open model


def open_for_timing(
    model: str, size: tuple[int, int], batch: int, threads: int, provider: str
) -> OpenedModel:
    """Open a model in this process, for `time_model`. Raises RuntimeError."""
    with _in_words():
        import_onnxruntime()  # so that load_ms does not count it
        started = time.perf_counter()
        content, folder = read_onnx(path := find_model(model)), str(path.parent)
        session = open_session(content, provider=provider, threads=threads, weights_folder=folder)
        load_ms = (time.perf_counter() - started) * 1e3
        feeds, notes = make_feeds(session.get_inputs(), size=size, batch=batch)
        _process.run = lambda: session.run(None, feeds)
        first_ms = time_runs(_process.run, 2)[0]
        shapes = {name: values.shape for name, values in feeds.items()}
        return OpenedModel(shapes, notes, load_ms, first_ms, _peak_memory_mb())


def time_model(frames: int) -> list[float]:
    """Return the `time_runs` of the open model. Raises RuntimeError."""
    with _in_words():
        return time_runs(_process.run, frames)


@contextlib.contextmanager
def _in_words() -> Iterator[None]:
    """Replace any error of ONNX Runtime by one that every process can read."""
    try:
        yield
    except Exception as error:
        text = describe_error(error)
        ours = isinstance(error, SSDNetError) or text != str(error)
        raise RuntimeError(text if ours else f"{type(error).__name__}: {error}") from None


def time_runs(run: Callable[[], object], runs: int) -> list[float]:
    """Return the time of each run [ms]."""
    times_ms = []
    for _ in range(runs):
        started = time.perf_counter()
        run()
        times_ms.append((time.perf_counter() - started) * 1e3)
    return times_ms


def _peak_memory_mb() -> float | None:
    try:
        peak_line = re.search(r"VmHWM:\s*(\d+) kB", Path("/proc/self/status").read_text())
    except OSError:  # the system is not Linux
        peak_line = None
    return int(peak_line[1]) * 1024 / 1e6 if peak_line else None
