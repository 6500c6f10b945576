"""From a checkpoint to one verified ONNX file."""

import contextlib
import copy
import hashlib
import itertools
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import onnx
import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from export.deploy import DeployGraph
from export.errors import ExportError
from export.half import to_half
from export.parity import HeadParity, measure_parity, reference
from export.precision import Int8Options, Precision
from export.probe_frames import ProbeFrame, probe_frames, recorded_frames
from export.trace import DEFAULT_OPSET, trace
from export.triton import require_model_folder, write_triton_model
from models import Checkpoint, Network, load_checkpoint
from models.answers import check_output
from runtime import Contract, InputError, OutputError, __version__
from runtime.contract.contract import MIN_SIDE, SCHEMA_VERSION, check_name, check_size
from runtime.contract.model_file import with_contract
from runtime.files.atomic_write import atomic_file
from runtime.verification.reference import (
    PredictorSettings,
    ReferenceFrame,
    ReferenceWriter,
    write_reference,
)

if TYPE_CHECKING:  # measuring needs the packages of training
    from export.accuracy import Accuracy

# (height, width) at which a model of any size is verified: half the size of Cityscapes, as in the
# paper.
DEFAULT_SIZE = (512, 1024)
# What `report` of an export is called with: finished stages, all stages, the next one in words.
Report = Callable[[int, int, str], object]
# Checkpoints in the folder of a run, whose names say nothing, and a file that shows such a folder.
_RUN_FILES, _RECIPE = ("model.pt", "best.pt", "last.pt"), "recipe.json"


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


@dataclass(frozen=True)
class _Draft:
    """A graph with its metadata, beside the network whose answers it must give."""

    network: Network
    heads: tuple[str, ...]
    model: onnx.ModelProto
    contract: Contract
    dynamic: bool


class _Stages:
    """Reports the stages of an export as they begin."""

    def __init__(self, total: int, report: Report) -> None:
        self._total, self._report, self._begun = total, report, 0

    def begin(self, text: str) -> None:
        """Report that the next stage begins."""
        self._begun += 1
        self.tell(text)

    def tell(self, text: str) -> None:
        """Report a step of the present stage."""
        self._report(self._begun - 1, self._total, text)


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
    if isinstance(precision, Int8Options) and not validate:
        raise InputError("int8 needs data: give validate, data sets with ground truth")
    dynamic, size = dynamic or size is None, _native_size(size)
    source = Path(checkpoint_path)
    if source.is_dir():
        source /= _RUN_FILES[0]
    name = _model_name(name, source)
    target = Path(onnx_path)
    triton_folder = None if triton_dir is None else Path(triton_dir) / target.stem
    _check_targets(target, triton_folder, source, overwrite=overwrite)
    int8 = isinstance(precision, Int8Options)
    further = (int8, precision is not Precision.FP32, validate and not int8, record_dir, triton_dir)
    stages = _Stages(2 + sum(map(bool, further)), report)
    stages.begin("tracing the graph")
    checkpoint = _read(source)
    warnings: Sequence[str] = ()
    if isinstance(precision, Int8Options):
        from export.int8 import require_frames  # needs the packages of training

        warnings = require_frames(precision, validate, checkpoint, source.resolve().parent)
    settings = PredictorSettings("ssdnet-export", "frame" if dynamic else None, provider="torch")
    with contextlib.ExitStack() as written:
        temporary = written.enter_context(atomic_file(target, overwrite=overwrite, durable=True))
        file = Path(temporary.name)
        recorder = None
        if record_dir is not None:
            recorder = written.enter_context(
                write_reference(Path(record_dir), settings, overwrite=overwrite)
            )
        graph = DeployGraph(checkpoint.model, with_logits=with_logits)
        model = trace(graph, size=size, dynamic=dynamic, opset=opset)
        contract = _contract(
            checkpoint,
            name or checkpoint.model.config.name,
            _digest(source),
            size=size,
            opset=opset,
        )
        draft = _Draft(checkpoint.model, graph.heads, model, contract, dynamic)
        draft, parity, frames = _verify(draft, file, precision, validate, warnings, stages)
        num_bytes = _write(draft.model, file, draft.contract)
        if recorder is not None:
            stages.begin("recording PyTorch's answers")
            _record(draft, frames, recorder)
            recorder.finish(file)
        if triton_folder is not None:
            stages.begin("writing the Triton model")
            write_triton_model(triton_folder, draft.model, file.read_bytes(), overwrite=overwrite)
    return ExportReport(
        target, size, dynamic, draft.heads, parity, len(frames), num_bytes, draft.contract
    )


def _native_size(size: tuple[int, int] | None) -> tuple[int, int]:
    """Return (height, width) at which the graph is traced."""
    size = size or DEFAULT_SIZE
    try:
        check_size(size)
    except ValueError as error:
        raise InputError(str(error)) from error
    return size


def _model_name(name: str | None, checkpoint: Path) -> str | None:
    """Return a valid name; without one that of a run's folder for a file that the run wrote."""
    if name is None:
        folder = checkpoint.resolve().parent
        of_run = checkpoint.name in _RUN_FILES and (folder / _RECIPE).is_file()
        return folder.name if of_run else None
    try:
        check_name(name, "name")
    except ValueError as error:
        raise InputError(str(error)) from error
    return name


def _check_targets(
    target: Path, triton_folder: Path | None, checkpoint: Path, *, overwrite: bool
) -> None:
    """Raise OutputError if the file or the folder cannot be written."""
    if target.is_dir():
        raise OutputError(f"{target} is a folder: give the name of a file")
    if target.exists() and checkpoint.exists() and target.samefile(checkpoint):
        raise OutputError(f"{target} is the checkpoint itself: choose another name")
    if target.exists() and not overwrite:
        raise OutputError(f"{target} exists: choose another name, or replace it with --overwrite")
    if not target.parent.is_dir():
        raise OutputError(f"{target.parent} is not a folder: create it first")
    if triton_folder is not None:
        require_model_folder(triton_folder, overwrite=overwrite)


def _read(path: Path | str) -> Checkpoint:
    """Return a checkpoint whose weights are finite and whose network returns what it declares."""
    checkpoint = load_checkpoint(path)
    _require_finite(checkpoint.model)
    try:
        check_output(checkpoint.model)
    except ValueError as error:
        raise ExportError(f"{path}: {error}") from error
    return checkpoint


def _require_finite(model: nn.Module) -> None:
    """Raise ExportError with the names of the weights and buffers that hold NaN or Inf."""
    bad = [
        name
        for name, values in itertools.chain(model.named_parameters(), model.named_buffers())
        if not bool(torch.isfinite(values).all())
    ]
    if bad:
        raise ExportError(
            f"the checkpoint holds NaN or Inf in {', '.join(bad[:5])}"
            + (f" and {len(bad) - 5} more" if len(bad) > 5 else "")
            + ": the training diverged, so nothing was written; use an earlier checkpoint"
        )


def _contract(
    checkpoint: Checkpoint, name: str, digest: str, *, size: tuple[int, int], opset: int
) -> Contract:
    config = checkpoint.model.config
    return Contract(
        schema_version=SCHEMA_VERSION,
        model_name=name,
        classes=config.classes,
        max_depth_m=config.max_depth_m,
        native_size=size,
        stride=checkpoint.model.stride,
        precision="fp32",
        training=dict(checkpoint.training),
        versions={
            "ssdnet": __version__,
            "torch": str(torch.__version__),
            "onnx": str(onnx.__version__),
            "opset": str(opset),
        },
        parity={},
        checkpoint_sha256=digest,
        trained_height=checkpoint.facts.trained_height,
        canonical_focal_px=config.canonical_focal_px,
        giga_macs=count_giga_macs(checkpoint.model, size),
    )


def _digest(path: Path | str) -> str:
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _frames(size: tuple[int, int], *, dynamic: bool, max_depth_m: float) -> list[ProbeFrame]:
    """Return frames of the native size; for a free size also of two other sizes, one odd."""
    sizes = [size]
    if dynamic:
        sizes.append((max(size[0] // 2 | 1, MIN_SIDE), max(size[1] // 2 | 1, MIN_SIDE)))
        sizes.append((MIN_SIDE + 1, MIN_SIDE + 31))
    return [frame for each in sizes for frame in probe_frames(each, max_depth_m=max_depth_m)]


def count_giga_macs(model: Network, size: tuple[int, int]) -> float:
    """Count the multiplications with addition of a frame of `size` (height, width), in billions."""
    inputs = (torch.empty(1, channels, *size, device="meta") for channels in (3, 1))
    with FlopCounterMode(display=False) as counter, torch.no_grad():
        copy.deepcopy(model).to("meta")(*inputs)
    return float(counter.get_total_flops()) / 2e9  # a multiplication and an addition count as two


def _verify(
    draft: _Draft,
    file: Path,
    precision: Precision | Int8Options,
    validate: Sequence[str],
    warnings: Sequence[str],
    stages: _Stages,
) -> tuple[_Draft, dict[str, HeadParity], list[ProbeFrame]]:
    """Verify the graph against PyTorch, first as traced, then in the requested precision.

    Args:
        draft: the traced graph.
        file: the file to which the graph is written, so that the engine can run it.
        precision: the requested precision.
        validate: data sets that the accuracy is measured on, if any.
        warnings: of `require_frames`, for the metadata of int8.
        stages: where the stages are reported.

    Returns:
        The graph in this precision with all of its metadata, head -> the worst difference, and the
        frames of this comparison.

    Raises:
        ExportError: if the answers differ from PyTorch's, or int8 misses its gate.
    """
    native_size = draft.contract.native_size
    measure = partial(measure_parity, draft.network, file, dynamic=draft.dynamic)
    frames = _frames(native_size, dynamic=draft.dynamic, max_depth_m=draft.contract.max_depth_m)
    stages.begin("verifying it against PyTorch")
    _write(draft.model, file, draft.contract)
    parity = measure(frames)
    _require_parity(parity)
    if isinstance(precision, Int8Options):
        stages.begin("quantising")
        draft = _quantize(draft, precision, validate, warnings, stages.tell)
    elif precision is Precision.FP16:
        contract = replace(draft.contract, precision=precision.value)
        draft = replace(draft, model=to_half(draft.model), contract=contract)
        # On synthetic frames half precision rounds too much, so recorded frames are used.
        frames = recorded_frames(native_size)
    if precision is not Precision.FP32:
        stages.begin("verifying the final file")
        _write(draft.model, file, draft.contract)
        parity = measure(frames)
    if precision is Precision.FP16:
        _require_parity(parity, "; leave out --precision fp16")
    if validate and not isinstance(precision, Int8Options):
        from export.accuracy import measure_accuracy  # needs the packages of training

        stages.begin("measuring the accuracy")
        with tempfile.TemporaryDirectory() as folder:  # the name of a measured file ends in .onnx
            path = Path(folder) / "model.onnx"
            path.write_bytes(file.read_bytes())
            draft = _with_accuracy(draft, validate, measure_accuracy(path, validate))
    figures = {head: dict(measured.figures) for head, measured in parity.items()}
    return replace(draft, contract=replace(draft.contract, parity=figures)), parity, frames


def _quantize(
    draft: _Draft,
    options: Int8Options,
    validate: Sequence[str],
    warnings: Sequence[str],
    report: Callable[[str], object],
) -> _Draft:
    """Return the graph in 8-bit integers, which passed the gate on its accuracy."""
    from export.int8 import quantize_within  # needs the packages of training

    contract = replace(draft.contract, precision="int8")
    names = [info.name for info in contract.classes]
    write = partial(_write, contract=contract)
    found = quantize_within(
        *(draft.model, options),
        validate=validate,
        classes=names,
        write=write,
        warnings=warnings,
        report=report,
    )
    contract = replace(contract, quantization=found.facts)
    return _with_accuracy(
        replace(draft, model=found.model, contract=contract), validate, found.accuracy
    )


def _with_accuracy(draft: _Draft, validate: Sequence[str], rows: Sequence["Accuracy"]) -> _Draft:
    from export.accuracy import repeat_command  # needs the packages of training

    measured = {"repeat": repeat_command(validate, rows), "rows": [asdict(row) for row in rows]}
    return replace(draft, contract=replace(draft.contract, accuracy=measured))


def _record(draft: _Draft, frames: Sequence[ProbeFrame], recorder: ReferenceWriter) -> None:
    """Record PyTorch's answers to each frame for the heads of the file."""
    for frame in frames:
        answers = reference(draft.network, frame)
        recorder.add(
            ReferenceFrame(f"{frame.name}, {frame.rgb.shape[0]} x {frame.rgb.shape[1]}"),
            frame.rgb,
            frame.sparse_depth,
            {head: answers[head] for head in draft.heads},
        )


def _write(model: onnx.ModelProto, path: Path, contract: Contract) -> int:
    """Write the model with its contract, which holds the digest of the rest; return the size."""
    del model.metadata_props[:]
    try:
        content = with_contract(model.SerializeToString(), contract)
    except (TypeError, ValueError, RecursionError) as error:
        raise ExportError(
            f"the checkpoint's facts about its training are not plain JSON: {error}"
        ) from error
    return path.write_bytes(content)


def _require_parity(parity: Mapping[str, HeadParity], advice: str = "") -> None:
    failed = [
        f"{head} {dict(measured.figures)}"
        for head, measured in parity.items()
        if not measured.passed
    ]
    if failed:
        raise ExportError(
            "the answers of the exported graph differ from PyTorch's, so nothing was written: "
            + "; ".join(failed)
            + advice
        )
