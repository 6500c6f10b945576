"""The second step of an export: a graph in its precision, verified and with its metadata."""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from export.build import Draft
from export.errors import ExportError
from export.half import to_half
from export.options import ExportOptions
from export.parity import HeadParity, measure_parity
from export.precision import Precision
from export.probe_frames import ProbeFrame, probe_frames, recorded_frames
from export.progress import Progress
from runtime.contract.contract import MIN_SIDE

if TYPE_CHECKING:  # measuring needs the packages of training
    from export.accuracy import Accuracy


class Finished(NamedTuple):
    """A finished graph, which was verified.

    Attributes:
        draft: the graph in the requested precision, with all of its metadata.
        parity: head -> the worst difference over the frames.
        frames: frames of this comparison.
    """

    draft: Draft
    parity: Mapping[str, HeadParity]
    frames: Sequence[ProbeFrame]


def finish_draft(
    draft: Draft, file: Path, options: ExportOptions, warnings: Sequence[str], progress: Progress
) -> Finished:
    """Bring a graph to its precision, measure its accuracy, and complete its metadata.

    It is verified against PyTorch, first as traced, then in the requested precision.

    Args:
        draft: the traced graph.
        file: the file to which the graph is written, so that the engine can run it.
        options: precision and data of the export.
        warnings: of `calibration_frames.require_frames`, for the metadata of int8.
        progress: where the stages are reported.

    Raises:
        ExportError: if the answers differ from PyTorch's, or int8 misses its gate.
    """
    precision, validate = options.precision, options.validate
    size, max_depth_m = draft.contract.native_size, draft.contract.max_depth_m
    measure = partial(measure_parity, draft.network, file, dynamic=draft.dynamic)
    frames = frames_of(size, dynamic=draft.dynamic, max_depth_m=max_depth_m)
    progress.begin("verifying it against PyTorch")
    draft.write(file)
    parity = measure(frames)
    _require_parity(parity)
    if precision is Precision.INT8:
        progress.begin("quantising")
        draft = _quantize(draft, options, warnings, progress.tell)
    elif precision is Precision.FP16:
        contract = replace(draft.contract, precision=precision.value)
        draft = replace(draft, model=to_half(draft.model), contract=contract)
        # On synthetic frames half precision rounds too much, so recorded frames are used.
        frames = recorded_frames(size)
    if precision is not Precision.FP32:
        progress.begin("verifying the final file")
        draft.write(file)
        parity = measure(frames)
    if precision is Precision.FP16:
        _require_parity(parity, ": leave out --precision fp16")
    if validate and precision is not Precision.INT8:
        from export.accuracy import measure_accuracy  # needs the packages of training

        progress.begin("measuring the accuracy")
        with tempfile.TemporaryDirectory() as folder:  # the name of a measured file ends in .onnx
            path = Path(folder) / "model.onnx"
            path.write_bytes(file.read_bytes())
            draft = _with_accuracy(draft, validate, measure_accuracy(path, validate))
    figures = {head: dict(measured.figures) for head, measured in parity.items()}
    draft = replace(draft, contract=replace(draft.contract, parity=figures))
    return Finished(draft, parity, frames)


def frames_of(size: tuple[int, int], *, dynamic: bool, max_depth_m: float) -> list[ProbeFrame]:
    """Return frames of the native size; for a free size also of two other sizes, one odd."""
    sizes = [size]
    if dynamic:
        sizes.append((max(size[0] // 2 | 1, MIN_SIDE), max(size[1] // 2 | 1, MIN_SIDE)))
        sizes.append((MIN_SIDE + 1, MIN_SIDE + 31))
    return [frame for each in sizes for frame in probe_frames(each, max_depth_m=max_depth_m)]


def _quantize(
    draft: Draft,
    options: ExportOptions,
    warnings: Sequence[str],
    report: Callable[[str], object],
) -> Draft:
    """Return the graph in 8-bit integers, which passed the gate on its accuracy."""
    from export.int8 import quantize_within  # needs the packages of training

    draft = replace(draft, contract=replace(draft.contract, precision=options.precision.value))
    found = quantize_within(
        draft.model,
        options,
        classes=[info.name for info in draft.contract.classes],
        write=lambda model, path: replace(draft, model=model).write(path),
        warnings=warnings,
        report=report,
    )
    contract = replace(draft.contract, quantization=found.facts)
    return _with_accuracy(
        replace(draft, model=found.model, contract=contract), options.validate, found.accuracy
    )


def _with_accuracy(draft: Draft, validate: Sequence[str], rows: Sequence["Accuracy"]) -> Draft:
    from export.accuracy import repeat_command  # needs the packages of training

    measured = {"repeat": repeat_command(validate, rows), "rows": [asdict(row) for row in rows]}
    return replace(draft, contract=replace(draft.contract, accuracy=measured))


def _require_parity(parity: Mapping[str, HeadParity], advice: str = "") -> None:
    failed = [
        f"{head} {dict(measured.figures)}"
        for head, measured in parity.items()
        if not measured.passed
    ]
    if failed:
        raise ExportError(
            f"the answers of the exported graph differ from PyTorch's in {'; '.join(failed)}, so "
            f"nothing was written{advice}"
        )
