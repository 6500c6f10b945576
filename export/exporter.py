"""From a checkpoint to one verified ONNX file."""

import contextlib
import copy
import hashlib
import itertools
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

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
from runtime.contract.contract import MIN_SIDE, SCHEMA_VERSION, check_size
from runtime.contract.model_file import with_contract
from runtime.files.atomic_write import atomic_file
from runtime.recordings.recording import RecordedFrame, Recorder, Settings, record

# (height, width) at which a model of any size is verified: half the size of Cityscapes, as in the
# paper.
DEFAULT_SIZE = (512, 1024)


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
    overwrite: bool = False,
) -> ExportReport:
    """Write a checkpoint as one ONNX file, which is verified before it gets its name.

    After an error nothing new is left on disk, and an older file is kept.

    Args:
        checkpoint_path: a checkpoint written by ssdnet-train.
        onnx_path: the file to write.
        size: (height, width) of a fixed model; None: any size, with DEFAULT_SIZE as native size.
        dynamic: whether the model takes any size, with `size` as native size.
        opset: ONNX operator set.
        with_logits: add the class scores to the outputs.
        record_dir: folder for a recording of PyTorch's answers to the frames of the verification,
            for ssdnet-verify; None: no recording.
        triton_dir: Triton model repository to which the file is added under its name; None: no
            repository.
        precision: precision of the file's trunk; for 8-bit integers also the data and the gate.
        validate: data sets on which the file's accuracy is measured, as `ssdnet-eval` takes them,
            KIND:FOLDER[,KEY=VALUE...]; int8 needs at least one.
        overwrite: replace an older file, recording and Triton model.

    Raises:
        CheckpointError: if the checkpoint cannot be read.
        InputError: if the size is invalid, or if the sets have too few frames or cannot measure
            the accuracy.
        OutputError: if a target exists (without `overwrite`) or cannot be written.
        ExportError: if weights are not finite, if the network does not return what it declares
            (see `models.answers.check_output`), if the graph cannot be made or differs from
            PyTorch by more than rounding, or if the gate is missed.
        DatasetError: if data cannot be read.
    """
    if isinstance(precision, Int8Options) and not validate:
        raise InputError("int8 needs data: give validate, data sets with ground truth")
    dynamic = dynamic or size is None
    size = size or DEFAULT_SIZE
    try:
        check_size(size)
    except ValueError as error:
        raise InputError(str(error)) from error
    target = Path(onnx_path)
    _check_target(target, Path(checkpoint_path), overwrite=overwrite)
    triton_folder = None if triton_dir is None else Path(triton_dir) / target.stem
    if triton_folder is not None:
        require_model_folder(triton_folder, overwrite=overwrite)
    checkpoint = load_checkpoint(checkpoint_path)
    _require_finite(checkpoint.model)
    try:
        check_output(checkpoint.model)
    except ValueError as error:
        raise ExportError(f"{checkpoint_path}: {error}") from error
    if isinstance(precision, Int8Options):
        from export.int8 import require_frames  # needs the packages of training

        require_frames(precision, validate, checkpoint)
    graph = DeployGraph(checkpoint.model, with_logits=with_logits)
    model = trace(graph, size=size, dynamic=dynamic, opset=opset)
    contract = _contract(checkpoint, _digest(checkpoint_path), size=size, opset=opset)
    frames = _frames(size, dynamic=dynamic, max_depth_m=contract.max_depth_m)
    settings = Settings("ssdnet-export", "frame" if dynamic else None, provider="torch")
    with contextlib.ExitStack() as written:
        temporary = written.enter_context(atomic_file(target, overwrite=overwrite, durable=True))
        file = Path(temporary.name)
        recorder = None
        if record_dir is not None:
            recorder = written.enter_context(
                record(Path(record_dir), settings, overwrite=overwrite)
            )
        _write(model, file, contract)
        measure = partial(measure_parity, checkpoint.model, file, dynamic=dynamic)
        parity = measure(frames)
        _require_parity(parity)
        if precision is not Precision.FP32 or validate:
            model, contract = _finish(model, contract, precision, validate)
            _write(model, file, contract)
            # On synthetic frames half precision rounds too much, so recorded frames are used.
            if precision is Precision.FP16:
                frames = recorded_frames(size)
            parity = measure(frames)
        if precision is Precision.FP16:
            _require_parity(parity, "; leave out --precision fp16")
        figures = {head: dict(measured.figures) for head, measured in parity.items()}
        contract = replace(contract, parity=figures)
        num_bytes = _write(model, file, contract)
        if recorder is not None:
            _record(checkpoint.model, graph.heads, frames, recorder)
            recorder.finish(file)
        if triton_folder is not None:
            write_triton_model(triton_folder, model, file.read_bytes(), overwrite=overwrite)
    return ExportReport(
        target, size, dynamic, graph.heads, parity, len(frames), num_bytes, contract
    )


def _check_target(target: Path, checkpoint: Path, *, overwrite: bool) -> None:
    if target.is_dir():
        raise OutputError(f"{target} is a folder: give the name of a file")
    if target.exists() and checkpoint.exists() and target.samefile(checkpoint):
        raise OutputError(f"{target} is the checkpoint itself: choose another name")
    if target.exists() and not overwrite:
        raise OutputError(f"{target} exists: choose another name, or replace it with --overwrite")
    if not target.parent.is_dir():
        raise OutputError(f"{target.parent} is not a folder: create it first")


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
    checkpoint: Checkpoint, digest: str, *, size: tuple[int, int], opset: int
) -> Contract:
    config = checkpoint.model.config
    return Contract(
        schema_version=SCHEMA_VERSION,
        model_name=config.name,
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


def _finish(
    model: onnx.ModelProto,
    contract: Contract,
    precision: Precision | Int8Options,
    validate: Sequence[str],
) -> tuple[onnx.ModelProto, Contract]:
    """Return the graph in the requested precision, and its contract with accuracy."""
    if precision is Precision.FP16:
        model = to_half(model)
    contract = replace(
        contract, precision="int8" if isinstance(precision, Int8Options) else precision.value
    )
    if not validate:
        return model, contract
    from export.accuracy import measure_accuracy, repeat_command  # needs the packages of training

    if isinstance(precision, Int8Options):
        from export.int8 import quantize_within

        names = [info.name for info in contract.classes]
        write = partial(_write, contract=contract)
        quantized = quantize_within(model, precision, validate=validate, classes=names, write=write)
        model, accuracy = quantized.model, quantized.accuracy
        contract = replace(contract, quantization=quantized.facts)
    else:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "model.onnx"
            _write(model, path, contract)
            accuracy = measure_accuracy(path, validate)
    measured = {
        "repeat": repeat_command(validate, accuracy),
        "rows": [asdict(row) for row in accuracy],
    }
    return model, replace(contract, accuracy=measured)


def _record(
    model: Network, heads: Sequence[str], frames: Sequence[ProbeFrame], recorder: Recorder
) -> None:
    """Record PyTorch's answers to each frame for the heads of the file."""
    for frame in frames:
        answers = reference(model, frame)
        recorder.add(
            RecordedFrame(f"{frame.name}, {frame.rgb.shape[0]} x {frame.rgb.shape[1]}"),
            frame.rgb,
            frame.sparse_depth,
            {head: answers[head] for head in heads},
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
