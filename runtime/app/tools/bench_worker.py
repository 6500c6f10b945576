"""A model in its own process, which is opened once and run as often as requested."""

import contextlib
import re
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.base.checks import shown
from runtime.base.errors import InputError, SSDNetError
from runtime.contract.model_file import read_onnx
from runtime.engine.bundled_models import find_model
from runtime.engine.session import explain, import_onnxruntime, open_session

Feeds = Mapping[str, NDArray[Any]]

_DTYPES = {
    "tensor(float)": "float32",
    "tensor(double)": "float64",
    **{f"tensor({name})": name for name in ("float16", "uint8", "int32", "int64", "bool")},
}


@dataclass(frozen=True)
class Opened:
    """Facts about an open model; a fact is None if it is unknown."""

    shapes: dict[str, tuple[int, ...]]  # shapes of the inputs
    notes: tuple[str, ...]  # differences from the requested shapes
    load_ms: float  # time of reading and optimising the file
    first_inference_ms: float
    peak_memory_mb: float | None  # of the process after two runs


# Names that free axes may have.
_NAMES = {"C": "c|.*channels?", "H": "h|rows|.*height", "W": "w|columns|.*width"}
_process = threading.local()  # holds `run`, a call of the open model


def open_for_timing(
    model: str, size: tuple[int, int], batch: int, threads: int, provider: str
) -> Opened:
    """Open a model in this process, for `time_model`. Raises RuntimeError."""
    with _in_words():
        import_onnxruntime()  # so that load_ms does not count it
        started = time.perf_counter()
        content, folder = read_onnx(path := find_model(model)), str(path.parent)
        session = open_session(content, provider=provider, threads=threads, weights_folder=folder)
        load_ms = (time.perf_counter() - started) * 1e3
        feeds, notes = make_feeds(session.get_inputs(), size=size, batch=batch)
        _process.run = lambda: session.run(None, feeds)
        first_ms = time_runs(_process.run, 2, None)[0]
        shapes = {name: values.shape for name, values in feeds.items()}
        return Opened(shapes, notes, load_ms, first_ms, _peak_memory_mb())


def time_model(frames: int, period_s: float | None) -> list[float]:
    """Return the `time_runs` of the open model. Raises RuntimeError."""
    with _in_words():
        return time_runs(_process.run, frames, period_s)


@contextlib.contextmanager
def _in_words() -> Iterator[None]:
    """Replace any error of ONNX Runtime by one that every process can read."""
    try:
        yield
    except Exception as error:
        text = explain(error)
        ours = isinstance(error, SSDNetError) or text != str(error)
        raise RuntimeError(text if ours else f"{type(error).__name__}: {error}") from None


def time_runs(run: Callable[[], object], frames: int, period_s: float | None) -> list[float]:
    """Return the latency of each run [ms].

    With a period, the latency of a frame counts from the time at which it is due, even if the run
    before took longer.
    """
    times_ms = []
    started = time.perf_counter()
    for frame in range(frames):
        due = time.perf_counter()
        if period_s is not None:
            due = started + frame * period_s
            time.sleep(max(0.0, due - time.perf_counter()))
        run()
        times_ms.append((time.perf_counter() - due) * 1e3)
    return times_ms


def make_feeds(
    inputs: Sequence[Any], *, size: tuple[int, int], batch: int
) -> tuple[Feeds, tuple[str, ...]]:
    """Fill a session's inputs; return them and `Opened.notes`. Raises InputError.

    Free axes are the batch, height, width and 3 channels, see `_free_axes`; other axes are fixed.
    The name of an axis has the same meaning in all inputs.
    """
    feeds, takes_size, takes_batch = {}, False, batch == 1
    sides = {"N": batch, "C": 3, "H": size[0], "W": size[1]}
    roles = {item.shape[at]: role for item in inputs for role, at in _free_axes(item.shape).items()}
    for item in inputs:
        named = {roles[side]: at for at, side in enumerate(item.shape) if side and side in roles}
        axes, shape = named | _free_axes(item.shape), list(item.shape)
        for role, at in axes.items():
            shape[at] = sides[role]
        if unknown := [side for side in shape if not isinstance(side, int)]:
            raise InputError(
                f"the input {shown(item.name)}: whether {shown(unknown[0])} of {list(item.shape)} "
                "is height, width or else is not certain; fix that axis, or name it H, W or C"
            )
        takes_batch |= "N" in axes
        takes_size |= bool(axes.keys() & {"H", "W"}) and {*size} <= {*shape}
        feeds[item.name] = make_input(item.name, item.type, shape)
    notes = {"its own size": takes_size, "its own batch": takes_batch}
    return feeds, tuple(note for note, taken in notes.items() if not taken)


def _free_axes(shape: Sequence[Any]) -> dict[str, int]:
    """Return the axes N, C, H and W of an input that are free, as far as they are certain.

    H, W and C are recognised by their names. If there are no such names, the first axis is N, and H
    and W are two neighbouring axes of four whose other axis, the channels, is fixed.
    """
    free = [at for at, side in enumerate(shape) if not isinstance(side, int)]
    axes = {
        role: at
        for role, pattern in _NAMES.items()
        for at in free
        if re.fullmatch(pattern, str(shape[at]), re.IGNORECASE)
    }
    rest = [at for at in free if at not in axes.values()]
    if rest[:1] == [0]:
        axes["N"] = rest.pop(0)
    if len(shape) == 4 and rest in ([1, 2], [2, 3]):
        axes |= dict(zip("HW", rest, strict=True))
    return axes


def make_input(name: str, element: str, shape: Sequence[int]) -> NDArray[Any]:
    """Fill an input of an ONNX Runtime type such as "tensor(float)".

    Bytes and floats are noise, and 5 % of the pixels of `sparse_depth` are returns. Other integers,
    which may be indices, are 0; booleans, which may be masks, are True.

    Raises:
        InputError: if the input is anything but a tensor of numbers.
    """
    if element not in _DTYPES:
        raise InputError(f"the input {shown(name)} is {element}: expected a tensor of numbers")
    dtype = np.dtype(_DTYPES[element])
    rng = np.random.default_rng(0)
    if dtype == np.uint8:
        return rng.integers(0, 256, shape, dtype=np.uint8)
    if dtype.kind != "f":
        return np.full(shape, dtype.kind == "b", dtype)
    noise = rng.random(shape, dtype=np.float32)
    if name == "sparse_depth":
        noise = np.where(rng.random(shape, dtype=np.float32) < 0.05, 80 * noise, 0)
    return noise.astype(dtype)


def _peak_memory_mb() -> float | None:
    try:
        found = re.search(r"VmHWM:\s*(\d+) kB", Path("/proc/self/status").read_text())
    except OSError:  # the system is not Linux
        found = None
    return int(found[1]) * 1024 / 1e6 if found else None
