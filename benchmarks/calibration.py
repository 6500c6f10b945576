"""Is the answer of ssdnet-calibrate as sure as it says? Rigs whose calibration is known.

    python benchmarks/calibration.py --data DIR [--model NAME] [--sets N]

DIR holds kitti_streets, kitti_drive_0009, kitti_stream, kitti_object, pandaset_front (the LiDAR
that sees all around) and view_of_delft; missing ones are left out. The sets of 5 successive frames
of a rig are disjoint, and so are those of 20 spread frames, because starting again on the same
frames would be no new trial. Each set starts from a rotation that is wrong by up to 2 degrees in
each axis.

How large the floors of the uncertainty must be for another vehicle is estimated from the vehicles
here. Their deviations are taken to be normally distributed around zero, so one more vehicle lies,
with 95 %, within their root mean square times the quantile of Student's t-distribution for their
number. Deviations are divided by the stated floor, and their squares are averaged over the trials
of a recording, the recordings of a vehicle, and the vehicles.

First, each rig has a line with the verdicts for the right calibration and for the scans of the next
frames. Then each rig and number of frames has a line: trials; the median and the largest deviation
of yaw, pitch and roll from the known calibration; trials in which all axes that are seen lie within
the stated uncertainty, and within that of floors from the other vehicles alone; medians of the
stated uncertainty; trials in which yaw and pitch are not seen. The last lines are the floors as
shares of the stated ones.
"""

import argparse
import itertools
import json
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from runtime import Predictor, Rig, open_source
from runtime.alignment.calibrate import SEEN_DEGREES, count_scenes, judge, uncertainty_of
from runtime.alignment.fit_scores import rotation
from runtime.alignment.search import find_rotation
from runtime.alignment.view import View, view_of
from runtime.recordings.source import Source
from runtime.streams.frame import Frame

WRONG_DEGREES, SIZES = 2.0, (5, 20)
KITTI = ("kitti_streets", "kitti_drive_0009", "kitti_stream")
STUDENT = (12.71, 4.30, 3.18, 2.78, 2.57)  # 95 %, of 1 to 5 vehicles


@dataclass(frozen=True, eq=False)
class Measured:
    """A set of frames; arrays are float64 (3,), degrees per axis.

    Attributes:
        rig: name of its recording.
        left: deviation from the known calibration that is left.
        scatter: the part of the uncertainty that follows from the differences between the frames.
        floor: the part that was set on these rigs.
    """

    rig: str
    left: NDArray[np.float64]
    scatter: NDArray[np.float64]
    floor: NDArray[np.float64]

    @property
    def vehicle(self) -> str:
        """The vehicle; KITTI's recordings share one."""
        return self.rig.split("_", maxsplit=1)[0]

    @property
    def within(self) -> NDArray[np.float64]:
        """The stated uncertainty; infinite for an axis that is not seen."""
        stated = np.hypot(self.scatter, self.floor)
        return np.where(stated <= SEEN_DEGREES, stated, np.inf)

    @property
    def is_seen(self) -> bool:
        """Whether yaw and pitch are seen."""
        return bool(np.isfinite(self.within[:2]).all())

    def is_within(self, factors: NDArray[np.float64]) -> bool:
        """Whether the axes that are seen lie within the scatter and the scaled floor."""
        most = np.hypot(self.scatter, factors * self.floor)
        return bool((np.abs(self.left) <= np.where(np.isfinite(self.within), most, np.inf)).all())


def open_rigs(data: Path, scratch: Path) -> Iterator[tuple[str, Source]]:
    """Yield the recordings that are there."""
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


def read_rig(source: Source, predictor: Predictor) -> tuple[list[View], Frame]:
    """Answer every frame with a scan; the last frame, too."""
    views = []
    for listed in source.list_frames():
        if listed.complete:
            frame = source.read(listed)
            assert frame.calibration is not None
            focal_px = frame.calibration.focal_length_px
            answer = predictor.predict(frame.rgb, None, focal_length_px=focal_px)
            if (view := view_of(frame, answer)) is not None:
                views.append(view)
    return views, frame


def measure(rig: str, views: Sequence[View], wrong: NDArray[np.float64]) -> Measured | None:
    """What is left of a rotation by these angles; None: too few frames have structure."""
    turned = []
    for view in views:
        extrinsics = view.calibration.extrinsics.copy()
        extrinsics[:3, :3] = rotation(wrong) @ extrinsics[:3, :3]
        turned.append(view.with_extrinsics(extrinsics))
    seen = [view for view in turned if view.has_structure]
    if len(seen) < 3:
        return None
    best = find_rotation(seen)
    return Measured(rig, -best.angles - wrong, *uncertainty_of(best, len(seen), count_scenes(seen)))


def disjoint(views: Sequence[View], size: int, most: int) -> list[Sequence[View]]:
    """Sets of so many frames, each frame in one: 5 successive ones, or 20 spread ones."""
    count = max(1, len(views) // size)
    if size == SIZES[0]:
        step = -(-count // most)
        return [views[size * each : size * (each + 1)] for each in range(0, count, step)]
    return [views[each::count][:size] for each in range(count)][:most]


def cell(values: Sequence[NDArray[np.float64]]) -> str:
    """Median and largest of the sizes of three angles."""
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
                views, frame = read_rig(source, predictor)
            for size in SIZES if len(views) >= SIZES[1] else SIZES[:1]:
                sets = disjoint(views, size, args.sets)
                starts = random.uniform(-WRONG_DEGREES, WRONG_DEGREES, (len(sets), 3))
                found[name, len(sets[0])] = [
                    measure(name, each, wrong) for each, wrong in zip(sets, starts, strict=True)
                ]
            report_verdicts(name, views, frame)
    report_coverage(found)


def floors_of(measured: Sequence[Measured]) -> NDArray[np.float64]:
    """Factors of the stated floors, (3,), with which one more vehicle lies within."""
    squares: dict[str, dict[str, list[NDArray[np.float64]]]] = {}
    for each in measured:
        recordings = squares.setdefault(each.vehicle, {})
        recordings.setdefault(each.rig, []).append((each.left / each.floor) ** 2)
    vehicles = [
        np.mean([np.mean(trials, axis=0) for trials in recordings.values()], axis=0)
        for recordings in squares.values()
    ]
    return np.asarray(STUDENT[len(vehicles) - 1] * np.sqrt(np.mean(vehicles, axis=0)))


def report_coverage(found: dict[tuple[str, int], list[Measured | None]]) -> None:
    """Print the lines of the rigs and numbers of frames, and the factors of the floors."""
    everything = [each for trials in found.values() for each in trials if each is not None]
    factors = {"all vehicles": floors_of(everything)}
    for (name, frames), trials in found.items():
        seen = [each for each in trials if each is not None and each.is_seen]
        line = f"| {name} | {frames} | {len(trials)} | "
        if seen:
            vehicle = seen[0].vehicle
            others = floors_of([each for each in everything if each.vehicle != vehicle])
            factors[f"all but {vehicle}"] = others
            counts = [
                f"{sum(m.is_within(each) for m in seen)} of {len(seen)}"
                for each in (np.ones(3), others)
            ]
            stated = np.median([each.within for each in seen], axis=0)
            texts = (f"{each:.2f}" if np.isfinite(each) else "not visible" for each in stated)
            line += f"{cell([m.left for m in seen])} | {' | '.join(counts)} | {', '.join(texts)} | "
        else:
            line += "| | | | "
        print(f"{line}{len(trials) - len(seen)} |", flush=True)
    for name, each in factors.items():
        print(f"  floors from {name}: {np.round(each, 2)} of the stated")


def report_verdicts(name: str, views: Sequence[View], frame: Frame) -> None:
    """Print the verdicts with the right calibration, and with the scans of the next frames."""
    (some,) = disjoint(views, SIZES[1], 1)
    calibration = views[0].calibration
    right = judge(list(some), calibration, frame).verdict
    step = max(1, (len(views) - 1) // SIZES[1])
    shifted = [
        replace(view.with_scan(after.points), neighbours=(view.points, None))
        for view, after in list(itertools.pairwise(views))[::step]
    ]
    paired = judge(shifted, calibration, frame).verdict
    print(f"  {name}: right calibration: {right}; scans of the next frames: {paired}", flush=True)


if __name__ == "__main__":
    main()
