"""From a checkpoint to one verified ONNX file, in stages."""

import contextlib
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from export.build import Draft, build_draft, read_checkpoint
from export.half import to_half
from export.options import DEFAULT_OPSET, ExportOptions
from export.parity import HeadParity, measure_parity, reference, require_parity
from export.precision import MAX_DROP_MIOU, MAX_RISE_MAE, Precision
from export.probe_frames import ProbeFrame, frames_of, recorded_frames
from export.triton import write_triton_model
from models import Checkpoint
from runtime import Contract
from runtime.files.atomic_write import atomic_file
from runtime.verification.reference import (
    PredictorSettings,
    ReferenceFrame,
    ReferenceWriter,
    write_reference,
)

if TYPE_CHECKING:  # measuring needs the packages of training
    from export.accuracy import Accuracy

# What `report` of an export is called with: finished stages, all stages, the next one in words.
Report = Callable[[int, int, str], object]
# Reports a step of a stage, in words.
Tell = Callable[[str], object]
# A stage of an export.
Stage = Callable[[Tell], None]


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
    given = locals()  # fields and arguments have the same names
    del given["report"]
    return run_export(ExportOptions(**given), report)


def run_export(options: ExportOptions, report: Report) -> ExportReport:
    """Make a file in stages, see `export_checkpoint`."""
    with contextlib.ExitStack() as written:
        export = _Export(options, written)
        stages = export.list_stages()
        for number, (text, stage) in enumerate(stages):
            tell = partial(report, number, len(stages))
            tell(text)
            stage(tell)
        return export.describe()


class _Export:
    """An export between two of its stages.

    Args:
        options: what is asked of it.
        written: the files that get their names once all stages are done.
    """

    _checkpoint: Checkpoint
    _draft: Draft  # which the file holds, too
    _file: Path
    _recorder: ReferenceWriter
    _parity: Mapping[str, HeadParity]
    _frames: Sequence[ProbeFrame]  # of this comparison
    _warnings: Sequence[str] = ()

    def __init__(self, options: ExportOptions, written: contextlib.ExitStack) -> None:
        self._options, self._written = options, written

    def list_stages(self) -> list[tuple[str, Stage]]:
        """Return the stages that the options ask for, in words and as calls, in their order."""
        options = self._options
        is_int8, is_fp16 = (options.precision is each for each in (Precision.INT8, Precision.FP16))
        stages: tuple[tuple[str, Stage, object], ...] = (
            ("reading the checkpoint", self._read, True),
            ("tracing the graph", self._trace, True),
            ("verifying it against PyTorch", self._verify_traced, True),
            ("quantising", self._quantize, is_int8),
            ("verifying the final file", self._halve, is_fp16),
            ("verifying the final file", self._verify_quantized, is_int8),
            ("measuring the accuracy", self._measure, options.validate and not is_int8),
            ("recording PyTorch's answers", self._record, options.record_dir),
            ("writing the Triton model", self._write_triton, options.triton_dir),
        )
        return [(text, stage) for text, stage, wanted in stages if wanted]

    def describe(self) -> ExportReport:
        """Return the report of a finished export."""
        draft, options = self._draft, self._options
        return ExportReport(
            options.onnx_path,
            options.native_size,
            options.any_size,
            draft.heads,
            self._parity,
            len(self._frames),
            self._file.stat().st_size,
            draft.contract,
        )

    def _keep(self, draft: Draft, **facts: Any) -> None:
        """Make a graph with these facts of its metadata the present one."""
        self._draft = replace(draft, contract=replace(draft.contract, **facts))
        self._draft.write(self._file)

    def _read(self, _: Tell) -> None:
        options = self._options
        self._checkpoint = checkpoint = read_checkpoint(options.source)
        if options.precision is Precision.INT8:
            from export.calibration_frames import require_frames  # needs the packages of training

            self._warnings = require_frames(options, checkpoint)
        opened = atomic_file(options.onnx_path, overwrite=options.overwrite, durable=True)
        self._file = Path(self._written.enter_context(opened).name)
        if options.record_dir is not None:
            settings = PredictorSettings(
                "ssdnet-export", "frame" if options.any_size else None, provider="torch"
            )
            recorder = write_reference(options.record_dir, settings, overwrite=options.overwrite)
            self._recorder = self._written.enter_context(recorder)

    def _trace(self, tell: Tell) -> None:
        network, options = self._checkpoint.model, self._options
        count = sum(weights.numel() for weights in network.parameters())
        size = " x ".join(map(str, options.native_size)) + ", any size" * options.any_size
        tell(f"tracing {network.config.name}, {count / 1e6:.1f} M parameters, at {size}")
        self._keep(build_draft(self._checkpoint, options))

    def _verify(self, frames: Sequence[ProbeFrame], advice: str | None = "") -> None:
        """Compare the file with PyTorch; ExportError with `advice` if it differs, None: never."""
        draft, self._frames = self._draft, frames
        self._parity = measure_parity(draft.network, self._file, frames, dynamic=draft.dynamic)
        if advice is not None:
            require_parity(self._parity, advice)
        figures = {head: dict(measured.figures) for head, measured in self._parity.items()}
        self._keep(draft, parity=figures)

    def _verify_traced(self, _: Tell) -> None:
        draft = self._draft
        size, max_depth_m = draft.contract.native_size, draft.contract.max_depth_m
        self._verify(frames_of(size, dynamic=draft.dynamic, max_depth_m=max_depth_m))

    def _halve(self, _: Tell) -> None:
        draft = self._draft
        self._keep(replace(draft, model=to_half(draft.model)), precision=Precision.FP16.value)
        # On synthetic frames half precision rounds too much, so recorded frames are used.
        frames = recorded_frames(draft.contract.native_size)
        self._verify(frames, ": leave out --precision fp16")

    def _quantize(self, tell: Tell) -> None:
        from export.int8 import quantize_within  # needs the packages of training

        self._keep(self._draft, precision=Precision.INT8.value)
        draft = self._draft
        found = quantize_within(
            draft.model,
            self._options,
            classes=[info.name for info in draft.contract.classes],
            write=lambda model, path: replace(draft, model=model).write(path),
            warnings=self._warnings,
            report=tell,
        )
        self._keep(replace(draft, model=found.model), quantization=found.facts)
        self._add_accuracy(found.accuracy)

    def _verify_quantized(self, _: Tell) -> None:
        # Its accuracy passed a gate. On synthetic frames 8 bits choose other classes for areas that
        # show nothing, so recorded frames are used.
        self._verify(recorded_frames(self._draft.contract.native_size), advice=None)

    def _measure(self, _: Tell) -> None:
        from export.accuracy import measure_accuracy  # needs the packages of training

        with tempfile.TemporaryDirectory() as folder:  # the name of a measured file ends in .onnx
            path = Path(folder) / "model.onnx"
            path.write_bytes(self._file.read_bytes())
            self._add_accuracy(measure_accuracy(path, self._options.validate))

    def _add_accuracy(self, rows: Sequence["Accuracy"]) -> None:
        from export.accuracy import repeat_command  # needs the packages of training

        repeat = repeat_command(self._options.validate, rows)
        accuracy = {"repeat": repeat, "rows": [asdict(row) for row in rows]}
        self._keep(self._draft, accuracy=accuracy)

    def _record(self, _: Tell) -> None:
        """Record PyTorch's answers to each frame for the heads of the file."""
        draft = self._draft
        for frame in self._frames:
            answers = reference(draft.network, frame)
            self._recorder.add(
                ReferenceFrame(f"{frame.name}, {frame.rgb.shape[0]} x {frame.rgb.shape[1]}"),
                frame.rgb,
                frame.sparse_depth,
                {head: answers[head] for head in draft.heads},
            )
        self._recorder.finish(self._file)

    def _write_triton(self, _: Tell) -> None:
        folder, overwrite = self._options.triton_folder, self._options.overwrite
        assert folder is not None  # else this is no stage
        content = self._file.read_bytes()
        write_triton_model(folder, self._draft.model, content, overwrite=overwrite)
