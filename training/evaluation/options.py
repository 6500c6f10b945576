"""The options of `ssdnet-eval`, defined once and checked before anything is opened."""

# ruff: noqa: RUF009 - what is called in `EvaluationOptions` returns a field

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Union, get_args

import typer

from runtime.base.errors import InputError
from runtime.command.json_file import require_json
from runtime.command.options import UsageError, option_group
from runtime.contract.network_size import NetworkSize, parse_network_size
from runtime.files.atomic_write import require_writable
from runtime.files.read_input import read_toml
from training.base.palette import PALETTE_HELP, Palette

if TYPE_CHECKING:  # heavy, and --help is to be quick
    from training.datasets.source_recipe import SourceRecipe
    from training.lidar.split import LidarInput
    from training.scores.depth_folder import DepthFolder

_option = option_group()
_TEXTS = list[str] | None


def _split(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _read_groups(path: Path) -> dict[str, list[str]]:
    """Read a TOML file of joint classes, `vehicle = ["car", "truck"]`. Raises InputError."""
    groups = read_toml(path)
    for group, names in groups.items():
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise InputError(
                f'{path}: {group} is not a list of classes: write {group} = ["car", "truck"]'
            )
    return groups


@dataclass(frozen=True, kw_only=True)
class EvaluationOptions:
    """The options of `ssdnet-eval`; `evaluate` describes those that it takes, too.

    Attributes:
        overwrite: whether the files of `page` and `json`, and depth of the same names, are
            replaced.

    Raises:
        InputError: if an option is invalid by itself.
        OutputError: if a file exists or cannot be written.
    """

    models: Sequence[str | Path] = _option(
        "Folders of runs, checkpoints (*.pt), exported models (*.onnx), networks of others "
        "(*.onnx, see --adapter), bundled models by name (ssdnet-lite) and classical methods "
        "(nearest, linear, planes, ip-basic, ip-basic-multiscale, mrf, tgv). Others are compared "
        "with the first.",
        default=(),
        kind=typer.Argument,
        given=_TEXTS,
        metavar="MODEL",
    )
    data: Sequence[Union[str, "SourceRecipe"]] = _option(
        "KIND:FOLDER[,KEY=VALUE...], a data set as in a recipe, for example "
        "cityscapes:/data/cityscapes,split=val,size=[512,1024]; name=TEXT is its title. May be "
        "repeated. [default: the validation sets of the first run]",
        default=(),
        given=_TEXTS,
        metavar="DATA",
    )
    images: Path | None = _option(
        "Folder of your own images, as for ssdnet-finetune.", metavar="DIR"
    )
    labels: Path | None = _option(
        "Labels of --images: PNGs of class ids or of colours.", metavar="DIR"
    )
    classes: Path | None = _option(
        "Names of the classes of --labels, as for ssdnet-finetune. [default: those of the first "
        "run]",
        metavar="FILE",
    )
    palette: Palette | None = _option(PALETTE_HELP)
    depth: Path | None = _option("LiDAR depth of --images: 16-bit PNGs.", metavar="DIR")
    depth_scale: float | None = _option("Units of --depth per metre. [default: 256]", min=1e-6)
    lidars: Sequence[Union[str, "LidarInput"]] | None = _option(
        "LiDAR inputs to score: own, 64, 32, 16, 8, 4, 2, 1, random:SHARE, none. [default: that of "
        "the run's validation, or own]",
        "--lidar",
        given=str | None,
        read=_split,
        metavar="LIDAR,...",
    )
    faults: Sequence[str] = _option(
        "Score also with simulated faults of the LiDAR (nan, shift, dropout) or the camera "
        "(blurred, dark, noisy, overexposed, covered, black, grey, white).",
        default=("none",),
        given=str | None,
        read=lambda text: ("none", *_split(text)),
        metavar="FAULT,...",
    )
    predictions: Sequence[str] = _option(
        "Folder of answers to score, named like the frames: PNGs of class ids or with palettes, "
        "16-bit PNGs of depth (depth_scale=256), or .npy files. classes=cityscapes or a list names "
        "the ids. May be repeated.",
        default=(),
        given=_TEXTS,
        metavar="DIR[,KEY=VALUE...]",
    )
    adapters: Sequence[Path] = _option(
        "File that says what goes into a network of others and what it returns; if it is missing, "
        "a draft is printed. May be repeated, in the order of these networks. [default: the file "
        "beside the network, with its name]",
        "--adapter",
        default=(),
        given=list[Path] | None,
        metavar="FILE.toml",
    )
    join: Mapping[str, Sequence[str]] | None = _option(
        'Classes of data sets and models that count as one: vehicle = ["car", "truck"].',
        given=Path | None,
        read=_read_groups,
        metavar="FILE.toml",
    )
    device: str = _option("'cpu', 'cuda' or 'cuda:N'.", default="cpu")
    threads: int = _option("CPU threads.", default=2, min=1)
    size: NetworkSize = _option(
        "Size at which models of free size run: auto (about the height that they were trained for, "
        "if a frame is much larger), frame, ROWS, or HEIGHTxWIDTH. Scores are computed at the size "
        "of the frame. [default: auto]",
        given=str | None,
        read=parse_network_size,
    )
    limit: int | None = _option("Frames to score of each set, evenly spread.", min=1)
    farthest_m: float | None = _option(
        "Farthest true depth that is scored [m]. [default: that of the run's validation, or 100]",
        "--farthest",
        min=1,
    )
    page: Path | None = _option(
        "Write an HTML page with the tables, the differences, the confusion of classes, the errors "
        "by distance, the reliability of the uncertainty, and the ten worst frames of each model.",
        metavar="FILE.html",
    )
    json: Path | None = _option(
        "Write all figures as one JSON document; - prints it instead of the tables.",
        metavar="FILE",
    )
    save: Path | None = _option(
        "Write the depth of every frame below this folder, also of frames without ground truth: "
        "16-bit PNGs of metres x 256 as MODEL/SET/LIDAR/FRAME.png.",
    )
    overwrite: bool = _option(
        "Replace the files of --page and --json, and the depth in --save.",
        "--overwrite",
        default=False,
    )

    def __post_init__(self) -> None:
        """Check each option by itself."""
        if not self.models and not self.predictions:
            raise UsageError("name a model, the folder of a run, a method or --predictions DIR")
        # Heavy imports are here, so that --help answers at once.
        from training.base.processes import parse_device
        from training.lidar.faults import LidarFault
        from training.loading.camera_faults import CAMERA_FAULTS

        parse_device(self.device)  # also for methods, which have no device
        known = *get_args(LidarFault), *CAMERA_FAULTS
        if unknown := [fault for fault in self.faults if fault not in ("none", *known)]:
            raise InputError(f"--faults {unknown[0]!r}: is unknown: give one of {', '.join(known)}")
        of_frames = self.labels, self.classes, self.palette, self.depth, self.depth_scale
        if self.images is None and any(of_frames):
            raise InputError(
                "--labels, --classes, --palette and --depth belong to --images: give it"
            )
        for option, value, needed, given in (
            ("--classes", self.classes, "--labels", self.labels),
            ("--palette", self.palette, "--classes", self.classes),
            ("--depth-scale", self.depth_scale, "--depth", self.depth),
        ):
            if value is not None and given is None:
                raise InputError(f"{option} belongs to {needed}: give both, or neither")
        require_json(self.json, overwrite=self.overwrite)
        if self.page is not None:
            require_writable(self.page, overwrite=self.overwrite)
        if self.save_to is not None:
            self.save_to.require_free()

    @property
    def sets(self) -> "list[SourceRecipe]":
        """The recipes of the data sets in `data`."""
        from training.datasets.registry import parse_data

        return [parse_data(each) if isinstance(each, str) else each for each in self.data]

    @property
    def inputs(self) -> "list[LidarInput]":
        """The LiDAR inputs in `lidars`."""
        from training.lidar.split import LidarInput

        given = self.lidars or ()
        return [LidarInput.parse(each) if isinstance(each, str) else each for each in given]

    @property
    def save_to(self) -> "DepthFolder | None":
        """The folder in `save`."""
        from training.scores.depth_folder import DepthFolder

        return None if self.save is None else DepthFolder(self.save, self.overwrite)
