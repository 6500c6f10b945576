"""A model in a process of its own: opened once, and run as often as requested."""

import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.bundled_models import find_model
from runtime.checks import shown
from runtime.errors import InputError, SSDNetError
from runtime.model_file import read_onnx
from runtime.session import explain, import_onnxruntime, open_session

Feeds = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Opened:
    """Facts of a model that is open; None = not known."""

    shapes: dict[str, tuple[int, ...]]  # of its inputs
    notes: tuple[str, ...]  # differences from the requested shapes
    load_ms: float  # reading and optimising the file
    first_inference_ms: float
    peak_memory_mb: float | None  # of the process after two runs


def serve(pipe: Connection, **request: Any) -> None:
    """Open a model as `_open` does and send an `Opened`; then answer calls of `time_runs`.

    A text in the place of an answer is the reason why the model cannot run; nothing follows.
    """
    try:
        run, opened = _open(**request)
        pipe.send(opened)
        while True:
            pipe.send(time_runs(run, *pipe.recv()))
    except EOFError:  # the other process has ended
        return
    except Exception as error:  # ONNX Runtime raises errors of any type
        text = explain(error)
        ours = isinstance(error, SSDNetError) or text != str(error)
        pipe.send(text if ours else f"{type(error).__name__}: {error}")


def _open(
    *, model: str, size: tuple[int, int], batch: int, threads: int, provider: str
) -> tuple[Callable[[], object], Opened]:
    import_onnxruntime()  # not counted in load_ms
    started = time.perf_counter()
    content = read_onnx(find_model(model))
    session = open_session(content, provider=provider, device_id=0, threads=threads)
    load_ms = (time.perf_counter() - started) * 1e3
    feeds, notes = make_feeds(session.get_inputs(), size=size, batch=batch)

    def run() -> object:
        return session.run(None, feeds)

    first_ms = time_runs(run, 2, None)[0][0]
    shapes = {name: values.shape for name, values in feeds.items()}
    return run, Opened(shapes, notes, load_ms, first_ms, _peak_memory_mb())


def time_runs(
    run: Callable[[], object], frames: int, period_s: float | None
) -> list[tuple[float, float]]:
    """Return the latency and the processor time of each run [ms].

    With a period a frame's latency counts from when it is due, even if the last one took longer.
    """
    times_ms = []
    started = time.perf_counter()
    for frame in range(frames):
        due, worked = time.perf_counter(), time.process_time()
        if period_s is not None:
            due = started + frame * period_s
            time.sleep(max(0.0, due - time.perf_counter()))
        run()
        ended = time.perf_counter()
        times_ms.append(((ended - due) * 1e3, (time.process_time() - worked) * 1e3))
    return times_ms


def make_feeds(
    inputs: Sequence[Any], *, size: tuple[int, int], batch: int
) -> tuple[Feeds, tuple[str, ...]]:
    """Fill a session's inputs; return them and `Opened.notes`. Raises InputError."""
    wanted = {"batch": batch, "height": size[0], "width": size[1]}
    feeds, notes, taken = {}, [], {"batch"} if batch == 1 else set()
    for item in inputs:
        axes = _free_axes(item.shape)
        notes += [f"{item.shape[at] or 'an axis'} = 1" for at, axis in axes.items() if not axis]
        taken |= set(axes.values())
        shape = list(item.shape)
        for at, axis in axes.items():
            shape[at] = wanted.get(axis, 1)
        feeds[item.name] = make_input(item.name, item.type, shape)
    notes += [] if {"height", "width"} & taken else ["its own size"]
    notes += [] if "batch" in taken else ["its own batch"]
    return feeds, tuple(dict.fromkeys(notes))


def _free_axes(shape: Sequence[int | str | None]) -> dict[int, str]:
    """Free axis -> "batch", "height", "width", by its name or else its place, or "" for another.

    The first axis is the batch; of the others the last two, if there are two, height and width.
    """
    free = [at for at, side in enumerate(shape) if not isinstance(side, int)]
    inner = [at for at in free if at]
    axes = {at: "" if at else "batch" for at in free}
    if len(inner) > 1:
        axes |= dict(zip(inner[-2:], ("height", "width"), strict=True))
    named = ((at, axis) for at in free for axis in ("batch", "height", "width"))
    return axes | {at: axis for at, axis in named if axis in str(shape[at]).lower()}


def make_input(name: str, element: str, shape: Sequence[int]) -> NDArray[Any]:
    """Fill an input of an ONNX Runtime type such as "tensor(float)".

    Bytes and floats are noise, and 5 % of the pixels of `sparse_depth` are returns. Other integers,
    which may be indices, are 0; booleans, which may be masks, are True.

    Raises:
        InputError: for anything but a tensor of numbers.
    """
    dtype = _dtype(element.removeprefix("tensor(").removesuffix(")"))
    if dtype is None:
        raise InputError(f"the input {shown(name)} is {element}: expected a tensor of numbers")
    rng = np.random.default_rng(0)
    if dtype == np.uint8:
        return rng.integers(0, 256, shape, dtype=np.uint8)
    if dtype.kind != "f":
        return np.full(shape, dtype.kind == "b", dtype)
    noise = rng.random(shape, dtype=np.float32)
    if name == "sparse_depth":
        noise = np.where(rng.random(shape, dtype=np.float32) < 0.05, 80 * noise, 0)
    return noise.astype(dtype)


def _dtype(element: str) -> np.dtype[Any] | None:
    """NumPy's type for a type name of ONNX Runtime; None = not a numeric type."""
    try:
        dtype = np.dtype({"float": "float32", "double": "float64"}.get(element, element))
    except TypeError:
        return None
    return dtype if dtype.kind in "biuf" else None


def _peak_memory_mb() -> float | None:
    try:
        found = re.search(r"VmHWM:\s*(\d+) kB", Path("/proc/self/status").read_text())
    except OSError:  # not Linux
        found = None
    return int(found[1]) * 1024 / 1e6 if found else None
