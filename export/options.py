"""What is asked of an export, checked before anything is read."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from export.precision import MAX_DROP_MIOU, MAX_RISE_MAE, Precision
from export.trace import DEFAULT_OPSET
from export.triton import require_model_folder
from models.checkpoint import FINAL, run_folder
from runtime import InputError, OutputError
from runtime.contract.contract import check_name, check_size

# (height, width) at which a model of any size is verified: half the size of Cityscapes, as in the
# paper.
DEFAULT_SIZE = (512, 1024)


@dataclass(frozen=True, kw_only=True)
class ExportOptions:
    """The options of `ssdnet-export`; `export_checkpoint` describes them.

    Raises:
        InputError: if the size or the name is invalid, or if int8 lacks data, or other precisions
            have data to calibrate.
        OutputError: if a target exists (without `overwrite`) or cannot be written.
    """

    checkpoint: Path
    target: Path
    size: tuple[int, int] | None = None
    dynamic: bool = False
    opset: int = DEFAULT_OPSET
    with_logits: bool = False
    record_dir: Path | None = None
    triton_dir: Path | None = None
    precision: Precision = Precision.FP32
    calibrate: Sequence[str] = ()
    validate: Sequence[str] = ()
    max_drop_miou: float = MAX_DROP_MIOU
    max_rise_mae: float = MAX_RISE_MAE
    name: str | None = None
    overwrite: bool = False

    def __post_init__(self) -> None:
        """Check the facts of the file, and that it and the other targets can be written."""
        try:
            object.__setattr__(self, "precision", Precision(self.precision))
        except ValueError:
            raise InputError(
                f"precision {self.precision!r} is unknown: give one of {', '.join(Precision)}"
            ) from None
        is_int8 = self.precision is Precision.INT8
        if is_int8 and not (self.calibrate and self.validate):
            raise InputError("int8 needs data: give calibrate, and validate with ground truth")
        if self.calibrate and not is_int8:
            raise InputError("calibrate is for int8: give precision int8, or leave it out")
        try:
            check_size(self.native_size)
            if self.model_name is not None:
                check_name(self.model_name, "name")
        except ValueError as error:
            raise InputError(str(error)) from error
        target, source = self.target, self.source
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
            require_model_folder(self.triton_folder, overwrite=self.overwrite)

    @property
    def source(self) -> Path:
        """The file of the checkpoint; of a run's folder its model.pt."""
        return self.checkpoint / FINAL if self.checkpoint.is_dir() else self.checkpoint

    @property
    def model_name(self) -> str | None:
        """The name in reports; None: that of the network."""
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
        return None if self.triton_dir is None else self.triton_dir / self.target.stem
