"""The options of `ssdnet-export`, defined once and checked before anything is read."""

# ruff: noqa: RUF009 - what is called in `ExportOptions` returns a field

from collections.abc import Sequence
from dataclasses import MISSING, dataclass
from pathlib import Path

import typer

from export.precision import ENOUGH_FRAMES, LEAST_FRAMES, MAX_DROP_MIOU, MAX_RISE_MAE, Precision
from runtime.base.errors import InputError, OutputError
from runtime.command.options import UsageError, option_group
from runtime.contract.contract import check_name, check_size

# (height, width) at which a model of any size is verified: half the size of Cityscapes, as in the
# paper.
DEFAULT_SIZE = (512, 1024)
# PyTorch's exporter writes this operator set without a conversion; ONNX Runtime reads it since
# 1.14.
DEFAULT_OPSET = 18
_option = option_group()


@dataclass(frozen=True, kw_only=True)
class ExportOptions:
    """The options of `ssdnet-export`; `export_checkpoint` describes them.

    Raises:
        InputError: if the size or the name is invalid, or if int8 lacks data, or other precisions
            have data to calibrate.
        OutputError: if a target exists (without `overwrite`) or cannot be written.
    """

    checkpoint_path: Path = _option(
        "Checkpoint written by ssdnet-train, or the folder of its run.",
        default=MISSING,
        kind=typer.Argument,
        metavar="CHECKPOINT",
    )
    onnx_path: Path = _option(
        "ONNX file to write.", default=MISSING, kind=typer.Argument, metavar="MODEL"
    )
    size: tuple[int, int] | None = None
    dynamic: bool = _option(
        "Accept images of any size although --height and --width are given, the size at which the "
        "file is verified.",
        "--dynamic",
        default=False,
    )
    opset: int = _option("ONNX operator set.", default=DEFAULT_OPSET, min=DEFAULT_OPSET)
    with_logits: bool = _option(
        "Add the class scores to the outputs.", "--with-logits", default=False
    )
    record_dir: Path | None = _option(
        "Folder for a reference of PyTorch's answers: ssdnet-verify then repeats the comparison on "
        "the target, without PyTorch.",
        "--record",
        metavar="DIR",
    )
    triton_dir: Path | None = _option(
        "Put the file into this Triton model repository too.", "--triton", metavar="DIR"
    )
    precision: Precision = _option(
        "Precision of the trunk: fp16 for GPUs, int8 for processors (needs --calibrate and "
        "--validate).",
        default=Precision.FP32,
    )
    calibrate: Sequence[str] = _option(
        "Frames from which the value ranges of int8 are calibrated, with and without LiDAR, as "
        f"KIND:FOLDER[,KEY=VALUE...] like in ssdnet-eval: {LEAST_FRAMES} or more, better "
        f"{ENOUGH_FRAMES}. May be repeated.",
        default=(),
        given=list[str] | None,
        metavar="DATA",
    )
    validate: Sequence[str] = _option(
        "Frames with labels or depth on which the accuracy in the metadata is measured, as "
        "KIND:FOLDER[,KEY=VALUE...]; take none of --calibrate. int8 needs "
        f"{LEAST_FRAMES} or more, better {ENOUGH_FRAMES}. A warning counts frames that served for "
        "training. May be repeated.",
        default=(),
        given=list[str] | None,
        metavar="DATA",
    )
    max_drop_miou: float = _option(
        "Largest loss of mIoU by int8 on any data set, in points.", default=MAX_DROP_MIOU, min=0
    )
    max_rise_mae: float = _option(
        "Largest rise of the depth's MAE by int8 on any data set, in %.",
        default=MAX_RISE_MAE,
        min=0,
    )
    name: str | None = _option(
        "Name of the model in reports.",
        show_default="that of the run's folder; for other files the network's",
    )
    overwrite: bool = _option(
        "Replace an older file, reference and Triton model.", "--overwrite", default=False
    )

    def __post_init__(self) -> None:
        """Check the facts of the file, and that it and the other targets can be written."""
        for path in ("checkpoint_path", "onnx_path", "record_dir", "triton_dir"):
            if (given := getattr(self, path)) is not None:
                object.__setattr__(self, path, Path(given))
        try:
            object.__setattr__(self, "precision", Precision(self.precision))
        except ValueError:
            raise InputError(
                f"precision {self.precision!r} is unknown: give one of {', '.join(Precision)}"
            ) from None
        is_int8 = self.precision is Precision.INT8
        if is_int8 and not (self.calibrate and self.validate):
            raise UsageError(
                "int8 needs data: give `calibrate=`, and `validate=` with ground truth"
            )
        if self.calibrate and not is_int8:
            raise UsageError("`calibrate=` is for int8: give precision int8, or leave it out")
        try:
            check_size(self.native_size)
            if self.model_name is not None:
                check_name(self.model_name, "name")
        except ValueError as error:
            raise InputError(str(error)) from error
        target, source = self.onnx_path, self.source
        if target.is_dir():
            raise OutputError(f"{target} is a folder: give the name of a file")
        if target.exists() and source.exists() and target.samefile(source):
            raise OutputError(f"{target} is the checkpoint itself: choose another name")
        if target.exists() and not self.overwrite:
            raise OutputError(
                f"{target} exists: choose another name, or replace it with --overwrite"
            )
        if not target.parent.is_dir():
            raise OutputError(f"{target.parent} is not a folder: create it first")
        if self.triton_folder is not None:
            from export.triton import require_model_folder

            require_model_folder(self.triton_folder, overwrite=self.overwrite)

    @property
    def source(self) -> Path:
        """The file of the checkpoint; of a run's folder its model.pt."""
        from models.checkpoint import FINAL  # slow, and --help needs no PyTorch

        path = self.checkpoint_path
        return path / FINAL if path.is_dir() else path

    @property
    def model_name(self) -> str | None:
        """The name in reports; None: that of the network."""
        from models.checkpoint import run_folder

        run = run_folder(self.source)
        return run.name if self.name is None and run is not None else self.name

    @property
    def native_size(self) -> tuple[int, int]:
        """(height, width) at which the graph is traced."""
        return self.size or DEFAULT_SIZE

    @property
    def any_size(self) -> bool:
        """Whether the model takes frames of other sizes, too."""
        return self.dynamic or self.size is None

    @property
    def triton_folder(self) -> Path | None:
        """The folder of the model in the Triton repository."""
        return None if self.triton_dir is None else self.triton_dir / self.onnx_path.stem
