"""The options of `ssdnet-run`, defined once and checked before anything is opened."""

# ruff: noqa: RUF009 - what is called in `RunOptions` returns a field

import contextlib
import dataclasses
import itertools
import os
import re
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from runtime.app.run.frame_record import REASONS
from runtime.base.arguments import shown
from runtime.base.errors import InputError
from runtime.base.stamp import DEFAULT_MAX_SKEW_MS, DEFAULT_REUSE_DEPTH_MS
from runtime.checks.catalog import FINDINGS
from runtime.command.options import Provider, UsageError, option_group
from runtime.contract.contract import MAX_FOCAL_PX, MAX_PIXELS, MIN_FOCAL_PX
from runtime.contract.heads import HEADS, Head
from runtime.contract.network_size import NetworkSize, parse_network_size
from runtime.drawing.encode import METRES_PNG_SCALE
from runtime.engine.bundled_models import DEFAULT_MODEL, list_bundled_models
from runtime.engine.predictor import Predictor
from runtime.geometry.odometry import ODOMETRY
from runtime.geometry.rig import LONGEST_MEMORY_S
from runtime.recordings import registry
from runtime.recordings.bundled_stream import BUNDLED_FOCAL_LENGTH_PX, bundled_stream
from runtime.recordings.scan import SCAN_SUFFIXES
from runtime.recordings.source import Source
from runtime.streams.memory import DEFAULT_MEMORY_S

OVERLAY, CLOUD = "overlay", "cloud"


def saved_heads() -> dict[str, Head]:
    """Return the head of each kind of file that holds one, as far as `HEADS` lists them."""
    return {head.saved_as: head for head in HEADS.values() if head.saved_as}


# Suffix of each kind of file of a frame; the kind is also the name of its subfolder.
SUFFIXES = {**dict.fromkeys(saved_heads(), ".png"), OVERLAY: ".jpg", CLOUD: ".ply"}
# Kinds that are written unless others are requested; the remaining kinds are large.
KINDS = tuple(kind for kind in SUFFIXES if kind != CLOUD)
MAX_OVERLAY_WIDTH = 8192  # five such panels side by side fit into a JPEG
# Suffix of the file that an option names.
FILE_SUFFIXES = {"video": ".mp4", "page": ".html", "mcap": ".mcap"}
MCAP_VOXEL_M = 0.1  # side of the cubes of --mcap, unless --cloud-voxel is given
DEFAULT_RATE_HZ = 10.0  # for frames without stamps: the rate of a LiDAR
_RIG_OPTIONS = ("calibration", "max_skew_ms", "reuse_depth_ms")  # attributes of the `Rig`
_OUT = Path("ssdnet-run")


# In the order of the groups in --help.
_input, _outputs, _model, _timing = map(option_group, ("Input", "Outputs", "Model", "Timing"))


_ACCEPTED = "; ".join(kind.accepted for kind in registry.SOURCES.values())
_KEYS = "; ".join(f"{kind} ({', '.join(registry.keys_of(kind))})" for kind in registry.SOURCES)


@dataclass(frozen=True)
class RunOptions:
    """The options of `ssdnet-run`, see `ssdnet-run --help`.

    Attributes:
        folder: folder of the results: --out, else the first of ssdnet-run, ssdnet-run-2 and so on
            that was free when these options were made.
        failing: the reasons that --fail-on names.
        accepted: the findings that --accept names.
        kinds: the files per frame that --save names.
        network_size: the size in --size, as `Predictor` takes it.
        part: the frames that --shard names.
        source_path: the source with its kind and keys.
        open_cameras: opens a source for each camera, see `Source.open_cameras`.

    Raises:
        UsageError: if an option is out of range, or options contradict each other.
        InputError: if `path` is not a source, or if `demo` is set and the bundled stream is
            missing.
    """

    path: Path | None = _input(
        f"Recording to read: {_ACCEPTED}. The kind is found from the files.",
        kind=typer.Argument,
        metavar="PATH",
    )
    rgb: Path | None = _input(
        f"Folder of the images (PNG or JPEG, at most {MAX_PIXELS // 10**6} megapixels)."
    )
    depth: Path | None = _input(
        "Folder of sparse depth maps, or the depth map of a single image, instead of --points: "
        "PNG, TIFF or .npy of 16 bits (depth_scale in --source), or TIFF or .npy of floats in "
        "metres. [default: camera only]"
    )
    points: Path | None = _input(
        f"Folder of LiDAR scans, or the scan of a single image: {', '.join(SCAN_SUFFIXES)}. Needs "
        "--calibration."
    )
    calibration: Path | None = _input(
        "Calibration of camera and LiDAR: a TOML file, or a calibration file or folder of KITTI. "
        "[default: that of the recording]"
    )
    rectify: bool = _input(
        "Remove the distortion of the images with the lens of the calibration, before the network "
        "sees them. [default: the returns are projected through the lens]",
        "--rectify",
        default=False,
    )
    demo: bool = _input("Run the bundled stream.", "--demo", default=False)
    limit: int | None = _input("Stop after this many complete frames of each camera.", min=1)
    focal_length: float | None = _input(
        "Focal length (fx) of the images in pixels; models without a canonical focal length ignore "
        "it. [default: that of the calibration, else unknown]",
        min=MIN_FOCAL_PX,
        max=MAX_FOCAL_PX,
    )
    reuse_depth_ms: float | None = _input(
        "An image without depth of its own takes the last depth, unless that is older than this; "
        f"0 turns it off. [default: {DEFAULT_REUSE_DEPTH_MS:g}, in folders only with --poses or "
        "timestamps in --source]",
        min=0,
        max=1e6,
    )
    memory: float | None = _input(
        "Feed the returns of so many seconds before, too, moved by the poses, where the present "
        f"ones do not contradict them, such as {DEFAULT_MEMORY_S:g}. [default: each frame alone]",
        metavar="SECONDS",
        min=0,
        max=LONGEST_MEMORY_S,
    )
    poses: Path | None = _input(
        "Poses in KITTI's or TUM's format, by which the scans of a folder are moved to the time of "
        "the image. Needs pose_frame in --source. Drives of KITTI and bags hold their own poses. "
        f"{ODOMETRY} finds them from the scans of a folder or drive (extra odometry).",
        metavar=f"FILE|{ODOMETRY}",
    )
    source: str | None = _input(
        f"A path with its kind, and options of this kind: {_KEYS}. --rgb DIR is the same as "
        "folders:DIR. The options are explained in docs/recordings.md.",
        metavar="KIND:PATH[,KEY=VALUE...]",
    )
    shard: str | None = _input(
        "Run part I of N of the recording, from 1/N to N/N: every N-th frame, of the first --limit "
        "frames if that is given. All parts together give the results of one run.",
        metavar="I/N",
    )
    out: Path | None = _outputs(
        "Folder of the results. [default: ssdnet-run, then ssdnet-run-2, ...]"
    )
    overwrite: bool = _outputs(
        "Replace the files of an earlier run in --out, and the files that the options below name. "
        "Other files in --out are never replaced.",
        "--overwrite",
        default=False,
    )
    save: list[str] | None = _outputs(
        f"Files to write for each frame: {', '.join(SUFFIXES)}; all, which is every kind that the "
        "model answers except clouds; or none. May be repeated. Depth and uncertainty are metres x "
        f"{METRES_PNG_SCALE}; a cloud needs --calibration or --focal-length. [default: all]",
        metavar="KIND,...",
    )
    overlay_width: int | None = _outputs(
        "Largest width of a panel of the overlays and the video in pixels. [default: such that an "
        "overlay fits 1920 x 1080; in the video the width of the frame]",
        min=16,
        max=MAX_OVERLAY_WIDTH,
    )
    page: Path | None = _outputs(
        "Write an HTML page with the latency over time, its stages, the health of the sensors, "
        "sample frames and the facts of the run. --report is the same.",
        "--page",
        "--report",
        metavar=f"FILE{FILE_SUFFIXES['page']}",
    )
    video: Path | None = _outputs(
        f"Write the overlays as a video, at --rate or at {DEFAULT_RATE_HZ:g} Hz.",
        metavar=f"FILE{FILE_SUFFIXES['video']}",
    )
    mcap: Path | None = _outputs(
        "Write the results as standard ROS 2 messages with the stamps of the camera, or at --rate "
        "if there are none. Needs the extra bag.",
        metavar=f"FILE{FILE_SUFFIXES['mcap']}",
    )
    cloud_voxel: float | None = _outputs(
        "In the clouds of --save and --mcap, keep one point in each cube of this side, the most "
        f"certain one. [default: all points in --save, {MCAP_VOXEL_M:g} in --mcap]",
        metavar="METRES",
        min=0.01,
        max=1e3,
    )
    max_uncertainty: float | None = _outputs(
        "Leave points out of these clouds if their uncertainty is a larger share of their depth.",
        metavar="SHARE",
        min=0,
        max=1e3,
    )
    record: Path | None = _outputs(
        "Keep frames, answers and model as a reference for ssdnet-verify; about 9 bytes per pixel "
        "and frame.",
        metavar="DIR",
    )
    fail_on: list[str] | None = _outputs(
        "End with exit code 5 if one of these is found: "
        f"{', '.join(REASONS)}. May be repeated. [default: none]",
        metavar="REASON,...",
    )
    accept: list[str] | None = _outputs(
        "Do not report this finding, nor flag frames for it; ssdnet-doctor --readings lists the "
        "names. May be repeated. [default: none]",
        metavar="NAME,...",
    )
    model: str | None = _model(
        f"Name of a bundled model ({', '.join(list_bundled_models())}), or path of an ONNX file "
        f"made by ssdnet-export (ends in .onnx or contains a /). [default: {DEFAULT_MODEL}]",
        metavar="NAME|PATH",
    )
    provider: Provider = _model("Execution provider of the model.", default=Provider.cpu)
    size: str = _model(
        "Size at which the network runs: auto (about the height it was trained for, if the frame "
        "is much larger), frame, ROWS, or HEIGHTxWIDTH. Results have the size of the frame.",
        default="auto",
    )
    threads: int | None = _model("Threads of inference. [default: physical cores]", min=1)
    sha256: str | None = _model("Required SHA-256 of the model file. [default: any]")
    deadline_ms: float | None = _timing(
        "Deadline of a prediction, without reading and writing. With --rate it counts from the "
        "time at which the frame is due.",
        min=1e-6,
        max=1e9,
    )
    deadline_p99_ms: float | None = _timing(
        "Deadline of 99 % of the predictions, like --deadline-ms. Needs 100 answers.",
        min=1e-6,
        max=1e9,
    )
    rate: float | None = _timing(
        "Frames per second: frames are due at fixed times as from a sensor (constant-stream), and "
        "their age and jitter are reported. [default: a frame starts when the one before it is "
        "done (single-stream)]",
        min=1e-3,
        max=1e6,
    )
    warmup: int = _timing(
        "Predictions before the first frame, which the statistics leave out.", default=3, min=0
    )
    max_skew_ms: float | None = _timing(
        "Largest difference between the stamps of an image and its depth, for recordings with "
        f"stamps of both. [default: {DEFAULT_MAX_SKEW_MS:g}]",
        min=0,
        max=1e6,
    )
    # These fields follow from the options:
    folder: Path = dataclasses.field(init=False)
    failing: tuple[str, ...] = dataclasses.field(init=False)
    accepted: tuple[str, ...] = dataclasses.field(init=False)
    kinds: tuple[str, ...] = dataclasses.field(init=False)
    network_size: NetworkSize = dataclasses.field(init=False)
    part: slice = dataclasses.field(init=False)
    source_path: registry.SourcePath = dataclasses.field(init=False)
    open_cameras: Callable[[], dict[str, Source]] = dataclasses.field(init=False)

    def __post_init__(self) -> None:
        """Check every option, and parse those that are text."""
        sources = [source for source in (self.path, self.rgb, self.source) if source is not None]
        if self.demo + len(sources) != 1 or (self.demo and (self.depth or self.points)):
            raise UsageError(
                "give one of PATH, --demo, --rgb (with --depth or --points) and --source"
            )
        if self.shard is not None and self.memory:
            raise UsageError("--memory needs the frames in order, but --shard reads every N-th one")
        if self.rectify and self.depth is not None:
            raise UsageError(
                "--rectify goes with --points: depth maps (--depth) lie on the pixels of the "
                "distorted images; leave --rectify out, or give the scans"
            )
        folder = self.out or (_OUT if self.overwrite else _free_folder())
        object.__setattr__(self, "folder", folder)
        for option, path in self.named_files.items():
            if path.suffix.lower() != FILE_SUFFIXES[option]:
                raise UsageError(f"--{option} writes {FILE_SUFFIXES[option]} files, got {path}")
        if self.record is not None:
            others = (self.folder, *(path.parent for path in self.named_files.values()))
            record, out, *files = (Path(os.path.realpath(each)) for each in (self.record, *others))
            inside = [folder for folder in (out, *files) if record in (folder, *folder.parents)]
            if inside or out in record.parents:
                raise UsageError(f"--record {record} needs a folder apart from other results")
        with _usage_errors():
            network_size = parse_network_size(self.size)
        source_path = self._find_source()
        for name, value in (
            ("kinds", self._read_kinds()),
            ("failing", _read_names("fail-on", self.fail_on, REASONS)),
            ("accepted", _read_names("accept", self.accept, FINDINGS)),
            ("network_size", network_size),
            ("part", self._read_shard()),
            ("source_path", source_path),
            ("open_cameras", self._choose_cameras(source_path)),
        ):
            object.__setattr__(self, name, value)

    def _read_kinds(self) -> tuple[str, ...]:
        texts = ",".join(self.save or ["all"])
        requested = {kind.strip() for kind in texts.split(",")}
        if requested == {"none"}:
            return ()
        if "all" in requested:  # "all,cloud" adds the clouds
            requested = (requested - {"all"}) | set(KINDS)
        others = sorted(requested - SUFFIXES.keys())  # heads of other packages
        if not all(kind in HEADS and HEADS[kind].saved_as == kind for kind in others):
            raise UsageError(
                f"--save is none, or some of all, {', '.join(SUFFIXES)}, got {shown(texts)}"
            )
        return *(kind for kind in SUFFIXES if kind in requested), *others

    def with_folder(self) -> "RunOptions":
        """The options with --out; if it was not given, a folder is made that no run shares."""
        folder = self.folder
        while self.out is None and not self.overwrite:
            try:
                folder.mkdir()
            except FileExistsError:  # another run has made it
                folder = _free_folder()
                continue
            except OSError:  # reported when the folder is used
                pass
            break
        return dataclasses.replace(self, out=folder)

    def _find_source(self) -> registry.SourcePath:
        if self.path is not None:
            return registry.detect_source(self.path)
        if self.source is not None:
            with _usage_errors():
                return registry.parse_source(self.source)
        folder = bundled_stream()[0] if self.demo else Path(self.rgb or "")
        return registry.SourcePath("folders", folder, {})

    def _choose_cameras(self, source: registry.SourcePath) -> Callable[[], dict[str, Source]]:
        names = {name for source in registry.SOURCES.values() for name in source.options}
        source_options = {name: getattr(self, name) for name in names - registry.SOURCE_KEYS.keys()}
        if self.demo:
            source_options["depth"] = bundled_stream()[1]
        rig_options = {name: getattr(self, name) for name in _RIG_OPTIONS}
        known = {name: value for name, value in rig_options.items() if value is not None}
        with _usage_errors():
            rig = dataclasses.replace(source.rig, **known)
            source_options |= source.keys
            return registry.choose_cameras(source.kind, source.path, rig, **source_options)

    def open_predictor(self) -> Predictor:
        """Open the model, which is not warmed up."""
        return Predictor(
            self.model,
            sha256=self.sha256,
            provider=str(self.provider),
            size=self.network_size,
            focal_length_px=self.focal_length_px,
            threads=self.threads,
            warmup=0,
        )

    @property
    def named_files(self) -> dict[str, Path]:
        """The files that were given, by the options that name them."""
        named = {option: getattr(self, option) for option in FILE_SUFFIXES}
        return {option: path for option, path in named.items() if path is not None}

    def of_camera(self, camera: str) -> "RunOptions":
        """The options of one camera of a rig, with its own outputs; "" is the only camera."""
        if not camera:
            return self
        files: dict[str, Any] = {
            option: path.with_stem(f"{path.stem}-{camera}")
            for option, path in self.named_files.items()
        }
        record = self.record and self.record / camera
        return dataclasses.replace(self, out=self.folder / camera, record=record, **files)

    @property
    def focal_length_px(self) -> float | None:
        """--focal-length, else that of the --demo camera; None: that of the calibration."""
        is_known = self.demo and self.focal_length is None
        return BUNDLED_FOCAL_LENGTH_PX if is_known else self.focal_length

    def _read_shard(self) -> slice:
        numbers = re.fullmatch("([0-9]{1,7})/([0-9]{1,7})", self.shard or "1/1")
        part, parts = map(int, numbers.groups()) if numbers else (0, 0)
        if not 1 <= part <= parts:
            raise UsageError(
                f"--shard is I/N with 1 <= I <= N, such as 2/4, got {shown(self.shard)}"
            )
        return slice(part - 1, None, parts)


def _free_folder() -> Path:
    """Return the first of ssdnet-run, ssdnet-run-2 and so on that does not exist."""
    numbered = (_OUT.with_name(f"{_OUT}-{number}") for number in itertools.count(2))
    return next(path for path in itertools.chain([_OUT], numbered) if not os.path.lexists(path))


@contextlib.contextmanager
def _usage_errors() -> Iterator[None]:
    """Turn an InputError of the block into a UsageError."""
    try:
        yield
    except InputError as error:
        raise UsageError(str(error)) from error


def _read_names(option: str, given: list[str] | None, known: Collection[str]) -> tuple[str, ...]:
    """Names of an option that may be repeated. Raises UsageError for an unknown one."""
    names = [each.strip() for each in ",".join(given or []).split(",") if each.strip()]
    if unknown := [each for each in names if each not in known]:
        raise UsageError(f"--{option} takes some of {', '.join(known)}, got {shown(unknown[0])}")
    return tuple(dict.fromkeys(names))
