"""The options of `ssdnet-run`: collected once, checked before anything is opened."""

import itertools
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TypeVar

from runtime.contract import MAX_FOCAL_PX, MIN_FOCAL_PX
from runtime.errors import InputError
from runtime.network_size import NetworkSize, parse_network_size
from runtime.run.outputs.output import FILE_SUFFIXES, RERUN_LIVE, is_rerun_file
from runtime.run.run_folder import KINDS, SUFFIXES
from runtime.sources.bundled_stream import BUNDLED_FOCAL_LENGTH_PX, bundled_stream
from runtime.sources.registry import choose_source, detect_kind
from runtime.sources.source import Source

MAX_SHARDS = 1_000_000
_OUT = Path("ssdnet-run")

Item = TypeVar("Item")


class UsageError(InputError):
    """Options that are wrong by themselves, whatever the files hold."""


@dataclass(frozen=True)
class RunOptions:
    """What `ssdnet-run` is asked for; the fields are its options, see `ssdnet-run --help`.

    Raises:
        UsageError: if an option is out of range, or options contradict each other.
        InputError: if `path` is no source, or `demo` is set and the bundled stream is missing.
    """

    path: Path | None = None
    rgb: Path | None = None
    depth: Path | None = None
    points: Path | None = None
    source: str | None = None
    demo: bool = False
    model: str | None = None
    sha256: str | None = None
    out: Path | None = None
    provider: str = "cpu"
    size: str = "auto"
    focal_length: float | None = None
    threads: int | None = None
    depth_scale: float | None = None
    point_columns: int | None = None
    calibration: Path | None = None
    camera: int | None = None
    image_topic: str | None = None
    depth_topic: str | None = None
    info_topic: str | None = None
    max_skew_ms: float | None = None
    deadline_ms: float | None = None
    rate: float | None = None
    limit: int | None = None
    shard: str | None = None
    warmup: int = 3
    save: Sequence[str] | None = None
    record: Path | None = None
    video: Path | None = None
    report: Path | None = None
    mcap: Path | None = None
    rerun: str | None = None
    overwrite: bool = False

    def __post_init__(self) -> None:
        """Check every option."""
        given = [source for source in (self.path, self.rgb, self.source) if source is not None]
        if self.demo + len(given) != 1 or (self.demo and (self.depth or self.points)):
            raise UsageError(
                "give one of PATH, --demo, --rgb (with --depth or --points) and --source"
            )
        _require_range("--depth-scale", self.depth_scale, 1e-3, 1e6)
        _require_range("--deadline-ms", self.deadline_ms, 1e-6, 1e9)
        _require_range("--rate", self.rate, 1e-3, 1e6)
        _require_range("--focal-length", self.focal_length, MIN_FOCAL_PX, MAX_FOCAL_PX)
        _require_range("--max-skew-ms", self.max_skew_ms, 0, 1e6)
        for option, path in self.named_files.items():
            if path.suffix.lower() != FILE_SUFFIXES[option]:
                raise UsageError(f"--{option} writes {FILE_SUFFIXES[option]} files, got {path}")
        if self.record is not None:
            self._require_apart(self.record)
        if self.rerun is not None and not (is_rerun_file(self.rerun) or is_viewer(self.rerun)):
            raise UsageError(
                f"--rerun takes a file that ends in {FILE_SUFFIXES['rerun']}, {RERUN_LIVE}, or a "
                f"viewer's rerun+http://HOST:PORT/proxy, got {self.rerun!r:.80}"
            )
        _ = self.kinds, self.network_size, self._shard, self.open_source

    @cached_property
    def kinds(self) -> tuple[str, ...]:
        """The files of a frame that --save names."""
        asked = [kind.strip() for text in self.save or ["all"] for kind in text.split(",")]
        if asked in (["all"], ["none"]):
            return KINDS if asked == ["all"] else ()
        if unknown := [kind for kind in asked if kind not in SUFFIXES]:
            raise UsageError(f"--save knows {', '.join(SUFFIXES)}, all and none, not {unknown}")
        return tuple(kind for kind in SUFFIXES if kind in asked)

    @cached_property
    def folder(self) -> Path:
        """The folder of the results: --out, else ssdnet-run, ssdnet-run-2 and so on, a new one."""
        if self.out is not None or self.overwrite:
            return self.out or _OUT
        later = (_OUT.with_name(f"{_OUT}-{number}") for number in itertools.count(2))
        return next(path for path in itertools.chain([_OUT], later) if not os.path.lexists(path))

    @cached_property
    def network_size(self) -> NetworkSize:
        """--size, as `Predictor` takes it."""
        try:
            return parse_network_size(self.size)
        except InputError as error:
            raise UsageError(str(error)) from error

    @cached_property
    def source_name(self) -> str:
        """The source as KIND:PATH."""
        if self.path is not None:
            return f"{detect_kind(self.path)}:{self.path}"
        return self.source or f"folders:{bundled_stream()[0] if self.demo else self.rgb}"

    @cached_property
    def open_source(self) -> Callable[[], Source]:
        """Opens the source."""
        name, depth = self.source_name, bundled_stream()[1] if self.demo else self.depth
        try:
            return choose_source(
                name,
                depth=depth,
                points=self.points,
                depth_scale=self.depth_scale,
                point_columns=self.point_columns,
                calibration=self.calibration,
                camera=self.camera,
                image_topic=self.image_topic,
                depth_topic=self.depth_topic,
                info_topic=self.info_topic,
                max_skew_ms=self.max_skew_ms,
            )
        except InputError as error:
            raise UsageError(str(error)) from error

    @property
    def named_files(self) -> dict[str, Path]:
        """Option -> the file that it names, without those that were not given."""
        rerun = Path(self.rerun) if self.rerun and is_rerun_file(self.rerun) else None
        files = {"video": self.video, "report": self.report, "mcap": self.mcap, "rerun": rerun}
        return {option: path for option, path in files.items() if path is not None}

    def focal_length_px(self, source: Source) -> float | None:
        """The focal length of the run: --focal-length, else that of the source."""
        if self.focal_length is not None:
            return self.focal_length
        if self.demo:
            return BUNDLED_FOCAL_LENGTH_PX
        return None if source.calibration is None else source.calibration.focal_length_px

    def shard_of(self, frames: Sequence[Item]) -> Sequence[Item]:
        """The frames that --shard names."""
        part, parts = self._shard
        return frames[part - 1 :: parts]

    def _require_apart(self, record: Path) -> None:
        """Raise UsageError if the recording shares its folder with other results."""
        recording, out = os.path.realpath(record), os.path.realpath(self.folder)
        folders = [os.path.realpath(path.parent) for path in self.named_files.values()]
        inside = [os.path.commonpath([recording, each]) == recording for each in [out, *folders]]
        if any(inside) or os.path.commonpath([recording, out]) == out:
            raise UsageError(f"--record {record} needs a folder of its own, apart from --out")

    @cached_property
    def _shard(self) -> tuple[int, int]:
        part, _, parts = (self.shard or "1/1").partition("/")
        digits = len(str(MAX_SHARDS))
        numbers = [text.isdecimal() and len(text) <= digits for text in (part, parts)]
        if not (all(numbers) and 1 <= int(part) <= int(parts) <= MAX_SHARDS):
            raise UsageError(
                f"--shard is I/N with 1 <= I <= N <= {MAX_SHARDS}, such as 2/4, got "
                f"{self.shard!r:.80}"
            )
        return int(part), int(parts)


def is_viewer(target: str) -> bool:
    """Whether --rerun names a viewer."""
    return target == RERUN_LIVE or target.startswith(
        ("rerun://", "rerun+http://", "rerun+https://")
    )


def _require_range(option: str, value: float | None, least: float, most: float) -> None:
    """Raise UsageError for a number out of range; None is not given."""
    if value is not None and not least <= value <= most:
        raise UsageError(f"{option} must be a number from {least:g} to {most:g}, got {value}")
