"""From a checkpoint to one verified ONNX file: build, verify, publish."""

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from export.build import Draft, build_draft, read_checkpoint
from export.options import ExportOptions
from export.parity import HeadParity, reference
from export.precision import Int8Options, Precision
from export.probe_frames import ProbeFrame
from export.progress import Report, Stages
from export.trace import DEFAULT_OPSET
from export.triton import write_triton_model
from export.verify import verify
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
    precision: Precision | Int8Options = Precision.FP32,
    validate: Sequence[str] = (),
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
        precision: precision of the file's trunk; for 8-bit integers also the data and the gate.
        validate: data sets on which the file's accuracy is measured, as `ssdnet-eval` takes them,
            KIND:FOLDER[,KEY=VALUE...]; int8 needs at least one.
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
        validate=validate,
        name=name,
        overwrite=overwrite,
    )
    return run_export(options, report)


def run_export(options: ExportOptions, report: Report) -> ExportReport:
    """Build, verify and publish a file, see `export_checkpoint`."""
    precision, target, overwrite = options.precision, options.target, options.overwrite
    int8 = isinstance(precision, Int8Options)
    further = (
        *(int8, precision is not Precision.FP32, options.validate and not int8),
        *(options.record_dir, options.triton_dir),
    )
    stages = Stages(2 + sum(map(bool, further)), report)
    stages.begin("tracing the graph")
    checkpoint = read_checkpoint(options.source)
    warnings: Sequence[str] = ()
    if isinstance(precision, Int8Options):
        from export.calibration_frames import require_frames  # needs the packages of training

        folder = options.source.resolve().parent
        warnings = require_frames(precision, options.validate, checkpoint, folder)
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
        draft, parity, frames = verify(draft, file, precision, options.validate, warnings, stages)
        num_bytes = draft.write(file)
        if recorder is not None:
            stages.begin("recording PyTorch's answers")
            _record(draft, frames, recorder)
            recorder.finish(file)
        if options.triton_folder is not None:
            stages.begin("writing the Triton model")
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
