"""From a checkpoint to one verified ONNX file: build, finish, publish."""

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from export.build import Draft, build_draft, read_checkpoint
from export.finish import finish_draft
from export.options import ExportOptions
from export.parity import HeadParity, reference
from export.precision import MAX_DROP_MIOU, MAX_RISE_MAE, Precision
from export.probe_frames import ProbeFrame
from export.progress import Progress, Report
from export.trace import DEFAULT_OPSET
from export.triton import write_triton_model
from runtime import Contract
from runtime.files.atomic_write import atomic_file
from runtime.verification.reference import (
    PredictorSettings,
    ReferenceFrame,
    ReferenceWriter,
    write_reference,
)


@dataclass(frozen=True)
class ExportReport:
    """The exported file, and its difference from PyTorch.

    Attributes:
        path: path of the file.
        size: (height, width) at which it was exported.
        dynamic: whether it takes any size.
        heads: names of its outputs.
        parity: the worst difference of each head over all frames on which it was verified.
        num_frames: number of these frames.
        num_bytes: size of the file.
        contract: the file's metadata.
    """

    path: Path
    size: tuple[int, int]
    dynamic: bool
    heads: tuple[str, ...]
    parity: Mapping[str, HeadParity]
    num_frames: int
    num_bytes: int
    contract: Contract


def export_checkpoint(
    checkpoint_path: Path | str,
    onnx_path: Path | str,
    *,
    size: tuple[int, int] | None = None,
    dynamic: bool = False,
    opset: int = DEFAULT_OPSET,
    with_logits: bool = False,
    record_dir: Path | str | None = None,
    triton_dir: Path | str | None = None,
    precision: Precision = Precision.FP32,
    calibrate: Sequence[str] = (),
    validate: Sequence[str] = (),
    max_drop_miou: float = MAX_DROP_MIOU,
    max_rise_mae: float = MAX_RISE_MAE,
    name: str | None = None,
    overwrite: bool = False,
    report: Report = lambda *_: None,
) -> ExportReport:
    """Write a checkpoint as one ONNX file, which is verified before it gets its name.

    After an error nothing new is left on disk, and an older file is kept.

    Args:
        checkpoint_path: a checkpoint written by ssdnet-train, or the folder of its run, whose
            model.pt is exported.
        onnx_path: the file to write.
        size: (height, width) of a fixed model; None: any size, with DEFAULT_SIZE as native size.
        dynamic: whether the model takes any size, with `size` as native size.
        opset: ONNX operator set.
        with_logits: add the class scores to the outputs.
        record_dir: folder for a reference of PyTorch's answers to the frames of the verification,
            for ssdnet-verify; None: no reference.
        triton_dir: Triton model repository to which the file is added under its name; None: no
            repository.
        precision: precision of the file's trunk.
        calibrate: data sets on which the ranges of int8 are measured, as `ssdnet-eval` takes them,
            KIND:FOLDER[,KEY=VALUE...]; for int8 alone, which needs at least one.
        validate: data sets on which the file's accuracy is measured; int8 needs at least one.
        max_drop_miou: largest fall of the mIoU of a set by int8, in points.
        max_rise_mae: largest rise of the MAE of the depth of a set by int8, in percent.
        name: the model's name in reports; None: the name of the run's folder for a model.pt,
            best.pt or last.pt, else that of the network.
        overwrite: replace an older file, reference and Triton model.
        report: called with the number of finished stages, that of all stages, and what is done
            next, in words.

    Raises:
        CheckpointError: if the checkpoint cannot be read.
        InputError: if the size or the name is invalid, or if the sets have too few frames or cannot
            measure the accuracy.
        OutputError: if a target exists (without `overwrite`) or cannot be written.
        ExportError: if weights are not finite, if the network does not return what it declares
            (see `models.answers.check_output`), if the graph cannot be made or differs from
            PyTorch by more than rounding, or if the gate is missed.
        DatasetError: if data cannot be read.
    """
    options = ExportOptions(
        checkpoint=Path(checkpoint_path),
        target=Path(onnx_path),
        size=size,
        dynamic=dynamic,
        opset=opset,
        with_logits=with_logits,
        record_dir=None if record_dir is None else Path(record_dir),
        triton_dir=None if triton_dir is None else Path(triton_dir),
        precision=precision,
        calibrate=calibrate,
        validate=validate,
        max_drop_miou=max_drop_miou,
        max_rise_mae=max_rise_mae,
        name=name,
        overwrite=overwrite,
    )
    return run_export(options, report)


def run_export(options: ExportOptions, report: Report) -> ExportReport:
    """Build, finish and publish a file, see `export_checkpoint`."""
    target, overwrite = options.target, options.overwrite
    is_int8 = options.precision is Precision.INT8
    further = (
        is_int8,
        options.precision is not Precision.FP32,
        options.validate and not is_int8,
        options.record_dir,
        options.triton_dir,
    )
    progress = Progress(2 + sum(map(bool, further)), report)
    progress.begin("tracing the graph")
    checkpoint = read_checkpoint(options.source)
    warnings: Sequence[str] = ()
    if is_int8:
        from export.calibration_frames import require_frames  # needs the packages of training

        warnings = require_frames(options, checkpoint)
    settings = PredictorSettings(
        "ssdnet-export", "frame" if options.any_size else None, provider="torch"
    )
    with contextlib.ExitStack() as written:
        temporary = written.enter_context(atomic_file(target, overwrite=overwrite, durable=True))
        file = Path(temporary.name)
        recorder = None
        if options.record_dir is not None:
            recorder = written.enter_context(
                write_reference(options.record_dir, settings, overwrite=overwrite)
            )
        draft = build_draft(checkpoint, options)
        draft, parity, frames = finish_draft(draft, file, options, warnings, progress)
        num_bytes = draft.write(file)
        if recorder is not None:
            progress.begin("recording PyTorch's answers")
            _record(draft, frames, recorder)
            recorder.finish(file)
        if options.triton_folder is not None:
            progress.begin("writing the Triton model")
            content = file.read_bytes()
            write_triton_model(options.triton_folder, draft.model, content, overwrite=overwrite)
    return ExportReport(
        target,
        options.native_size,
        options.any_size,
        draft.heads,
        parity,
        len(frames),
        num_bytes,
        draft.contract,
    )


def _record(draft: Draft, frames: Sequence[ProbeFrame], recorder: ReferenceWriter) -> None:
    """Record PyTorch's answers to each frame for the heads of the file."""
    for frame in frames:
        answers = reference(draft.network, frame)
        recorder.add(
            ReferenceFrame(f"{frame.name}, {frame.rgb.shape[0]} x {frame.rgb.shape[1]}"),
            frame.rgb,
            frame.sparse_depth,
            {head: answers[head] for head in draft.heads},
        )
