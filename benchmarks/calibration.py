"""Whether ssdnet-calibrate is as certain as it states, on rigs whose calibration is known.

    python benchmarks/calibration.py --data DIR [--model NAME] [--sets N]

DIR holds kitti_streets, kitti_drive_0009, kitti_stream, kitti_object, pandaset_front (the LiDAR
that sees all around) and view_of_delft; missing ones are left out. The sets of 5 successive frames
of a rig are disjoint, and so are those of 20 spread frames, because starting again on the same
frames would be no new trial. Each set starts from a rotation that is wrong by up to 2 degrees in
each axis.

The floors of the uncertainty were set on these rigs. Leaving rigs out estimates whether they hold
for another rig: each axis of the floors is scaled by the smallest factor with which all trials of
the other rigs lie within it, and the trials of the left-out rig are counted again.

First, each rig has a line with the verdicts for the right calibration and for the scans of the next
frames. Then each rig and number of frames has a line: trials; the median and the largest deviation
of yaw, pitch and roll from the known calibration; trials in which all axes that are seen lie within
the stated uncertainty, within that of floors from the other recordings, and within that from other
vehicles; medians of the stated uncertainty; trials in which yaw and pitch are not seen. The last
lines are the factors.
"""

import argparse
import itertools
import json
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from runtime import CalibrationResult, Predictor, Rig, open_source
from runtime.alignment.calibrate import judge, uncertainty_of
from runtime.alignment.figures import rotation
from runtime.alignment.pairing import Neighbours
from runtime.alignment.search import find_rotation
from runtime.alignment.view import View, points_in_time, view_of
from runtime.recordings.source import Source
from runtime.streams.frame import Frame

WRONG_DEGREES, SIZES = 2.0, (5, 20)
KITTI = ("kitti_streets", "kitti_drive_0009", "kitti_stream")


@dataclass(frozen=True, eq=False)
class Trial:
    """A frame of a rig, prepared for any number of trials."""

    frame: Frame
    view: View
    points: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Measured:
    """A set of frames in which yaw and pitch are seen; arrays are float64 (3,), degrees per axis.

    Attributes:
        rig: name of its recording.
        frames: number of frames.
        left: deviation from the known calibration that is left.
        within: the stated uncertainty; infinite for an axis that is not seen.
        scatter: the part of it that follows from the differences between the frames.
        floor: the part that was set on these rigs.
    """

    rig: str
    frames: int
    left: NDArray[np.float64]
    within: NDArray[np.float64]
    scatter: NDArray[np.float64]
    floor: NDArray[np.float64]

    @property
    def vehicle(self) -> str:
        """The vehicle; KITTI's recordings share one."""
        return self.rig.split("_", maxsplit=1)[0]

    def needed(self) -> NDArray[np.float64]:
        """The factors of the floor with which the deviation is just within the uncertainty."""
        needed = np.sqrt(np.maximum(self.left**2 - self.scatter**2, 0)) / self.floor
        return np.where(np.isfinite(self.within), needed, 0)

    def is_within(self, factors: NDArray[np.float64]) -> bool:
        """Whether the axes that are seen lie within the scatter and the scaled floor."""
        most = np.hypot(self.scatter, factors * self.floor)
        return bool((np.abs(self.left) <= np.where(np.isfinite(self.within), most, np.inf)).all())


def open_rigs(data: Path, scratch: Path) -> Iterator[tuple[str, Source]]:
    """Yield the recordings that exist."""
    calibrations = {"kitti_streets": "kitti_streets/calib.txt"}
    for name in KITTI:
        if (root := data / name).is_dir():
            points, calibration = root / "velodyne_fov", data / calibrations.get(name, name)
            images = root / "image_02"
            yield name, open_source("folders", images, Rig(calibration=calibration), points=points)
    folders = (
        ("kitti_object", "image_2", "velodyne_fov"),
        ("view_of_delft", "image", "velodyne"),
    )
    for name, images, scans in folders:
        if (root := data / name).is_dir():
            rig = Rig(calibration=root / "calib")
            yield name, open_source("folders", root / images, rig, points=root / scans)
    if (root := data / "pandaset_front").is_dir():
        camera = json.loads((root / "intrinsics.json").read_text())
        rows = [[camera["fx"], 0, camera["cx"]], [0, camera["fy"], camera["cy"]], [0, 0, 1]]
        toml = scratch / "panda.toml"
        toml.write_text(f'intrinsics = {rows}\npoints_in = "camera"\n')
        for path in (root / "points").glob("*.bin"):
            points = np.fromfile(path, np.float32).reshape(-1, 6)
            np.save(scratch / f"{path.stem}.npy", points[points[:, 4] == 0, :3])
        rig = Rig(calibration=toml)
        yield root.name, open_source("folders", root / "image", rig, points=scratch)


def read_rig(source: Source, predictor: Predictor) -> list[Trial]:
    """Predict every frame that has a scan."""
    trials = []
    for listed in source.list_frames():
        if not listed.complete:
            continue
        frame = source.read(listed)
        assert frame.calibration is not None
        focal_px = frame.calibration.focal_length_px
        view = view_of(frame, predictor.predict(frame.rgb, None, focal_length_px=focal_px))
        points = points_in_time(frame)
        if view is not None and points is not None:
            trials.append(Trial(frame, view, points))
    return trials


def turned_views(trials: Sequence[Trial], wrong: NDArray[np.float64]) -> list[View]:
    """Return the views of some frames with a rotation that is wrong by these angles."""
    views = []
    for trial in trials:
        extrinsics = trial.view.calibration.extrinsics.copy()
        extrinsics[:3, :3] = rotation(wrong) @ extrinsics[:3, :3]
        calibration = replace(trial.view.calibration, extrinsics=extrinsics)
        views.append(trial.view.with_scan(trial.points, calibration))
    return views


def judge_set(
    trials: Sequence[Trial], views: list[View], neighbours: Sequence[Neighbours] | None = None
) -> CalibrationResult:
    """Judge some frames."""
    beside = list(neighbours or [(None, None)] * len(views))
    scans = [trial.points for trial in trials]
    return judge(views, scans, beside, views[0].calibration, trials[0].frame)


def measure(rig: str, trials: Sequence[Trial], wrong: NDArray[np.float64]) -> Measured | None:
    """Return what is left of a rotation by these angles; None if the axes are not seen."""
    views = turned_views(trials, wrong)
    result = judge_set(trials, views)
    if result.off_degrees is None or result.within_degrees is None:
        return None
    seen = [view for view in views if view.has_structure]
    scatter, floor = uncertainty_of(find_rotation(seen), len(seen), result.scenes)
    left = np.asarray(result.off_degrees - wrong)
    return Measured(rig, len(trials), left, result.within_degrees, scatter, floor)


def disjoint(trials: Sequence[Trial], size: int, most: int) -> list[Sequence[Trial]]:
    """Return sets of so many frames, each frame in one: 5 successive ones, or 20 spread ones."""
    count = max(1, len(trials) // size)
    if size == SIZES[0]:
        step = -(-count // most)
        return [trials[size * each : size * (each + 1)] for each in range(0, count, step)]
    return [trials[each::count][:size] for each in range(count)][:most]


def cell(values: Sequence[NDArray[np.float64]]) -> str:
    """Return the median and the largest absolute value of three angles."""
    sizes = np.abs(values)
    pairs = zip(np.median(sizes, axis=0), sizes.max(axis=0), strict=True)
    return ", ".join(f"{middle:.2f} ({most:.2f})" for middle, most in pairs)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--model", default=None)
    parser.add_argument("--sets", type=int, default=4, help="most sets of a rig and size")
    args = parser.parse_args()
    random = np.random.default_rng(2)
    found: dict[tuple[str, int], list[Measured | None]] = {}
    with (
        tempfile.TemporaryDirectory() as scratch,
        Predictor(args.model, threads=1, warmup=0) as predictor,
    ):
        for name, source in open_rigs(args.data, Path(scratch)):
            with source:
                trials = read_rig(source, predictor)
            for size in SIZES if len(trials) >= SIZES[1] else SIZES[:1]:
                sets = disjoint(trials, size, args.sets)
                starts = random.uniform(-WRONG_DEGREES, WRONG_DEGREES, (len(sets), 3))
                found[name, len(sets[0])] = [
                    measure(name, each, wrong) for each, wrong in zip(sets, starts, strict=True)
                ]
            report_verdicts(name, trials)
    report_coverage(found)


def floors_without(
    measured: Sequence[Measured], left_out: Callable[[Measured], bool]
) -> NDArray[np.float64] | None:
    """Return the factors of the floors, (3,), from the other trials; None if there are none."""
    others = [each.needed() for each in measured if not left_out(each)]
    return np.max(others, axis=0) if others else None


def report_coverage(found: dict[tuple[str, int], list[Measured | None]]) -> None:
    """Print the lines for the rigs and numbers of frames, and the factors of the floors."""
    everything = [each for trials in found.values() for each in trials if each is not None]
    factors = {}
    for (name, frames), trials in found.items():
        seen = [each for each in trials if each is not None]
        line = f"| {name} | {frames} | {len(trials)} | "
        if seen:
            vehicle = seen[0].vehicle
            recording = floors_without(everything, lambda each, name=name: each.rig == name)
            elsewhere = floors_without(everything, lambda each, v=vehicle: each.vehicle == v)
            factors[f"without {name}"], factors[f"without all of {vehicle}"] = recording, elsewhere
            counts = [
                "" if each is None else f"{sum(m.is_within(each) for m in seen)} of {len(seen)}"
                for each in (np.ones(3), recording, elsewhere)
            ]
            stated = np.median([each.within for each in seen], axis=0)
            texts = (f"{each:.2f}" if np.isfinite(each) else "not visible" for each in stated)
            line += f"{cell([m.left for m in seen])} | {' | '.join(counts)} | {', '.join(texts)} | "
        else:
            line += "| | | | | "
        print(f"{line}{len(trials) - len(seen)} |", flush=True)
    for name, each in factors.items():
        print(f"  floors {name}: {each if each is None else np.round(each, 2)} of the stated")


def report_verdicts(name: str, trials: Sequence[Trial]) -> None:
    """Print the verdicts with the right calibration, and with the scans of the next frames."""
    (some,) = disjoint(trials, SIZES[1], 1)
    right = judge_set(some, [trial.view for trial in some]).verdict
    later = [replace(trial, points=after.points) for trial, after in itertools.pairwise(trials)]
    shifted = [replace(each, view=each.view.with_scan(each.points)) for each in later]
    beside: list[Neighbours] = [(trial.points, None) for trial in trials[:-1]]
    step = max(1, len(shifted) // SIZES[1])
    some = shifted[::step]
    paired = judge_set(some, [trial.view for trial in some], beside[::step]).verdict
    print(f"  {name}: right calibration: {right}; scans of the next frames: {paired}", flush=True)


if __name__ == "__main__":
    main()
