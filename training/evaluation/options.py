"""What is asked of an evaluation, checked before anything is opened."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

from runtime.base.errors import InputError, OutputError
from runtime.contract.network_size import NetworkSize
from runtime.files.atomic_write import require_writable
from training.base.processes import parse_device
from training.datasets.any_source import parse_data
from training.datasets.source_recipe import SourceRecipe
from training.evaluation.own_frames import OwnFrames
from training.lidar.faults import LidarFault
from training.lidar.split import LidarInput
from training.loading.camera_faults import CAMERA_FAULTS, CameraFault
from training.scores.depth_folder import DepthFolder

Fault = Literal["none"] | LidarFault | CameraFault
FAULTS = ("none", *get_args(LidarFault), *CAMERA_FAULTS)


@dataclass(frozen=True, kw_only=True)
class EvaluationOptions:
    """The options of `ssdnet-eval`; `evaluate` describes those that it takes, too.

    Attributes:
        leave_out_fed: a LiDAR that feeds the depth to score has no row, instead of raising an
            error.
        frames: folders of a user's frames, which are scored after the sets in `data`.
        sets: the recipes of the data sets in `data`.
        inputs: the LiDAR inputs in `lidars`.
        page: HTML page to write, for which the worst frames are drawn; None: none.
        json: file to which all figures are written; None: none.
        save: folder to which the depth of every answer is written; None: none.
        overwrite: whether the page, and depth of the same names, are replaced.

    Raises:
        InputError: if an option is invalid by itself.
        OutputError: if a file exists or cannot be written.
    """

    models: Sequence[str | Path] = ()
    data: Sequence[str | SourceRecipe] = ()
    frames: OwnFrames | None = None
    lidars: Sequence[str | LidarInput] | None = None
    faults: Sequence[Fault] = ("none",)
    predictions: Sequence[str] = ()
    adapters: Sequence[Path] = ()
    join: Mapping[str, Sequence[str]] | None = None
    device: str = "cpu"
    threads: int = 2
    size: NetworkSize = None
    limit: int | None = None
    farthest_m: float | None = None
    leave_out_fed: bool = False
    page: Path | None = None
    json: Path | None = None
    save: Path | None = None
    overwrite: bool = False
    sets: Sequence[SourceRecipe] = field(init=False)
    inputs: Sequence[LidarInput] = field(init=False)

    def __post_init__(self) -> None:
        """Check each option by itself."""
        if not self.models and not self.predictions:
            raise InputError("nothing to score: name a model, a method or --predictions DIR")
        parse_device(self.device)  # also for methods, which have no device
        if unknown := [fault for fault in self.faults if fault not in FAULTS]:
            known = ", ".join(FAULTS[1:])
            raise InputError(f"--faults {unknown[0]!r}: is unknown: give one of {known}")
        sets = [parse_data(item) if isinstance(item, str) else item for item in self.data]
        object.__setattr__(self, "sets", sets)
        object.__setattr__(self, "inputs", [_parse_lidar(item) for item in self.lidars or ()])
        for file in (self.json, self.page):
            if file is not None:
                require_writable(file)
        if self.page is not None and self.page.exists() and not self.overwrite:
            raise OutputError(
                f"{self.page} exists: choose another name, or replace it with --overwrite"
            )
        if self.depth_folder is not None:
            self.depth_folder.require_free()

    def feeds(self, default: str) -> list[tuple[LidarInput, str]]:
        """Return every LiDAR input with every fault; without a named input `default`."""
        inputs = dict.fromkeys(self.inputs or [_parse_lidar(default)])
        return [(each, fault) for each in inputs for fault in dict.fromkeys(self.faults)]

    @property
    def depth_folder(self) -> DepthFolder | None:
        """The folder in `save`."""
        return None if self.save is None else DepthFolder(self.save, self.overwrite)


def _parse_lidar(item: str | LidarInput) -> LidarInput:
    return LidarInput.parse(item) if isinstance(item, str) else item
