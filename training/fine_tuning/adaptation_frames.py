"""The frames of a recording to which a network is adapted, and those that are kept apart."""

import json
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from runtime.base.errors import InputError
from runtime.contract.network_size import network_size
from runtime.contract.resize import move_returns
from runtime.files.atomic_write import atomic_write
from runtime.geometry.odometry import ODOMETRY
from runtime.recordings.listing import ListedFrame
from runtime.recordings.registry import SOURCES, parse_source
from runtime.recordings.source import Source
from runtime.streams.frame import Frame
from training.base.stop_signal import Stop, StopRequested
from training.base.tables import build
from training.datasets.recording import RecordingRecipe, beside
from training.run.run_folder import folder_errors
from training.scores.metrics import FARTHEST_M

# Largest number of frames that are read, and their least number.
MOST_FRAMES, LEAST_FRAMES = 600, 5
# Least number of returns within the range of scores of a frame that is used.
LEAST_RETURNS = 20
# Share of the time of the frames with returns, at its end, that is kept apart.
KEPT_APART = 0.1


@dataclass(frozen=True)
class ChosenFrames:
    """Numbers of frames in the list of a recording.

    Attributes:
        train: frames of the training.
        kept_apart: later frames, on which the models are scored.
        size: (height, width) at which the network runs; None: the frames' own size.
    """

    train: tuple[int, ...]
    kept_apart: tuple[int, ...]
    size: tuple[int, int] | None

    def of(self, recording: RecordingRecipe) -> tuple[RecordingRecipe, RecordingRecipe]:
        """Return the data sets of the training and of the frames kept apart."""
        train, apart = (
            replace(recording, frames=part, size=self.size)
            for part in (self.train, self.kept_apart)
        )
        return train, apart


def is_named(recording: str) -> bool:
    """Return whether a text names the kind of a recording, KIND:PATH[,KEY=VALUE...]."""
    return recording.partition(":")[0] in SOURCES


def describe_recording(recording: str, **files: str | Path | None) -> tuple[RecordingRecipe, Path]:
    """Return a recording as a data set, and the folder that holds it.

    Args:
        recording: a path or KIND:PATH[,KEY=VALUE...].
        **files: depth, points, calibration and poses, as far as they are given.

    Raises:
        InputError: if the text names an unknown key, or a value is wrong.
    """
    source, path, keys = None, Path(recording), dict[str, Any]()
    if is_named(recording):
        found = parse_source(recording)
        source, path = found.kind, found.path
        given = {**found.keys, **{name: getattr(found.rig, name) for name in found.rig.given}}
        # Numbers and truth values stay; paths and kinds become text.
        keys = {n: v if isinstance(v, int | float) else str(v) for n, v in given.items()}
    path = path.absolute()
    below: dict[str, Any] = {
        name: ODOMETRY
        if str(file) == ODOMETRY
        else os.path.relpath(Path(file).absolute(), beside(path))
        for name, file in files.items()
        if file is not None
    }
    return RecordingRecipe(path=path.name, source=source, keys=keys, **below), path.parent


def find_frames(
    recording: RecordingRecipe,
    root: Path,
    kept: Path,
    *,
    trained_height: int | None,
    stop: Stop,
) -> ChosenFrames:
    """Choose the frames of a recording that have returns; the end of their time is kept apart.

    Args:
        recording: the recording.
        root: folder that holds it.
        kept: file to which the choice is written, and from which it is read by a later call.
        trained_height: see `network_size`.
        stop: called between two frames; True stops.

    Raises:
        InputError: if the recording cannot be opened, has too few frames with returns, or has
            frames of different sizes or focal lengths; if `kept` cannot be read.
        StopRequested: once `stop` returns True; nothing is written then.
    """
    if kept.is_file():
        tqdm.write(f"{kept}: the frames of an earlier start are taken", file=sys.stderr)
        try:
            return build(ChosenFrames, json.loads(kept.read_text(encoding="utf-8")))
        except (OSError, ValueError, InputError) as error:
            raise InputError(f"{kept}: cannot be read ({error}): choose another --out") from error
    with recording.open_source(root / recording.path) as source:
        for note in source.notes:
            tqdm.write(note, file=sys.stderr)
        frames = choose_frames(source.list_frames())
        times, size = _with_returns(_read(source, frames, stop), trained_height)
    (begin, *_), (*_, end) = times.values(), times.values()
    from_time = end - KEPT_APART * (end - begin)
    apart = tuple(number for number, time in times.items() if time > from_time) or (max(times),)
    train = tuple(number for number in times if number not in apart)
    chosen = ChosenFrames(train, apart, size)
    with folder_errors(kept.parent):
        kept.parent.mkdir(parents=True, exist_ok=True)
        atomic_write(kept, json.dumps(asdict(chosen)).encode())
    return chosen


def choose_frames(listed: Sequence[ListedFrame]) -> list[tuple[ListedFrame, float]]:
    """Choose frames at equal distances of time, each with its time, 0 to 1.

    If there are no stamps, the order of the frames is the time. InputError for too few frames with
    depth.
    """
    found = [frame for frame in listed if frame.complete and frame.depth is not None]
    if len(found) < LEAST_FRAMES:
        raise InputError(
            f"the recording has {len(found)} frames with a scan or depth; expected at least "
            f"{LEAST_FRAMES}: for a folder of images give --points and --calibration, or --depth"
        )
    stamped = all(frame.image_stamp_ns is not None for frame in found)
    times = np.array([frame.image_stamp_ns if stamped else i for i, frame in enumerate(found)])
    times = (times - times[0]) / max(1, times[-1] - times[0])
    chosen = np.arange(len(found))
    if len(found) > MOST_FRAMES:
        wanted = np.linspace(0, 1, MOST_FRAMES)
        chosen = np.unique(np.searchsorted(times, wanted).clip(0, len(found) - 1))
    return [(found[i], float(times[i])) for i in chosen]


def _read(
    source: Source, frames: Sequence[tuple[ListedFrame, float]], stop: Stop
) -> Iterator[tuple[int, float, Frame]]:
    """Yield number, time and content of the frames that can be read."""
    for listed, time in tqdm(frames, desc="frames", disable=None):
        if stop():
            raise StopRequested
        try:
            yield listed.sequence, time, source.read(listed)
        except InputError as error:
            tqdm.write(f"left out: {error}", file=sys.stderr)


def _with_returns(
    frames: Iterator[tuple[int, float, Frame]], trained_height: int | None
) -> tuple[dict[int, float], tuple[int, int] | None]:
    """Return the times of the frames with returns by number, and `ChosenFrames.size`."""
    sizes: set[tuple[int, int]] = set()
    focals: set[float] = set()
    times: dict[int, float] = {}
    whole, empty = (0, 0), 0
    for number, time, frame in frames:
        whole = frame.size
        size = network_size(None, whole, trained_height=trained_height)
        focal_px = frame.calibration.focal_length_px if frame.calibration else 0.0
        focals.add(round(focal_px * size[1] / whole[1], 2))
        sizes.add(size)
        returns = frame.sparse_depth if size == whole else move_returns(frame.sparse_depth, size)
        if np.count_nonzero((returns > 0) & (returns <= FARTHEST_M)) < LEAST_RETURNS:
            empty += 1
        else:
            times[number] = time
    if empty:
        text = f"left out: {empty} frames with fewer than {LEAST_RETURNS} returns"
        tqdm.write(text, file=sys.stderr)
    if empty and not times:
        raise InputError(
            "no frame has returns in the image: check the extrinsics of the calibration, or "
            "/tf_static of a bag; the camera looks along z"
        )
    if len(times) < LEAST_FRAMES:
        raise InputError(
            f"{len(times)} frames could be read and have returns; expected at least "
            f"{LEAST_FRAMES}: give a longer recording"
        )
    if len(sizes) > 1 or max(focals) > 1.01 * min(focals):
        raise InputError(
            f"the frames have {len(sizes)} sizes and {len(focals)} focal lengths; expected one "
            "camera: adapt to one camera at a time"
        )
    (size,) = sizes
    return times, None if size == whole else size
