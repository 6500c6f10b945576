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

Before that, each recording has a line: windows of five successive frames, those with a false alarm,
and those in which nothing can be judged. Then recordings are made wrong on purpose, and the last
table has the smallest fault of each reading that is found in five spread frames. aimotive_night,
pandaset_street and the bundled stream are used for these two alone.
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

from runtime import Predictor, Rig, open_source
from runtime.alignment.calibrate import SEEN_DEGREES, count_scenes, judge, uncertainty_of
from runtime.checks.fit import turned
from runtime.checks.judge import FIRST_FRAMES, NO_EVIDENCE, Judge
from runtime.checks.search import find_rotation
from runtime.checks.view import UPSIDE_DOWN, Answer, View
from runtime.engine.prediction import Prediction
from runtime.geometry.lens import Lens
from runtime.recordings.bundled_stream import BUNDLED_FOCAL_LENGTH_PX, bundled_stream
from runtime.recordings.source import Source
from runtime.streams.frame import Frame
from runtime.streams.frame_view import view_of
from training.recipes.pandaset_street import CAMERAS

WRONG_DEGREES, SIZES = 2.0, (5, 20)
NIGHT = "aimotive_night"
KITTI = ("kitti_streets", "kitti_drive_0009", "kitti_stream")
Change = Callable[[View], View | None]
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
    focal = BUNDLED_FOCAL_LENGTH_PX
    (toml := scratch / "bundled.toml").write_text(
        f"intrinsics = [[{focal}, 0, 415.5], [0, {focal}, 127.5], [0, 0, 1]]\n"
        'points_in = "camera"\n'
    )
    images, depth = bundled_stream()
    yield "bundled", open_source("folders", images, Rig(calibration=toml), depth=depth)
    if (root := data / NIGHT).is_dir():
        rig = Rig(calibration=root / "calibration.toml")
        yield NIGHT, open_source("folders", root / "image", rig, points=root / "scan")
    for camera, (fx, fy, cx, cy) in CAMERAS.items():
        if (root := data / "pandaset_street" / camera).is_dir():
            rows = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]
            matrix = (np.diag([800 / 1920, 800 / 1920, 1]) @ rows).tolist()
            toml = scratch / f"{camera}.toml"
            toml.write_text(f'intrinsics = {matrix}\npoints_in = "camera"\n')
            rig, depth = Rig(calibration=toml), root / "lidar"
            yield f"street_{camera}", open_source("folders", root / "image", rig, depth=depth)


def read_rig(source: Source, predictor: Predictor) -> tuple[list[View], Frame]:
    """Answer every frame with depth; the last frame, too."""

    def answer_alone(frame: Frame, _: NDArray[np.float32]) -> Prediction:
        focal_px = frame.calibration and frame.calibration.focal_length_px
        return predictor.predict(frame.rgb, None, focal_length_px=focal_px)

    views = []
    for listed in source.list_frames():
        if listed.complete:
            frame = source.read(listed)
            assert frame.calibration is not None
            focal_px = frame.calibration.focal_length_px
            answer = predictor.predict(frame.rgb, None, focal_length_px=focal_px)
            if (view := view_of(frame, answer, predict=answer_alone)) is not None:
                views.append(view)
    return views, frame


def measure(rig: str, views: Sequence[View], wrong: NDArray[np.float64]) -> Measured | None:
    """What is left of a rotation by these angles; None: too few frames have structure."""
    seen = [each for each in (turned(view, wrong) for view in views) if each.has_structure]
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


def with_extrinsics(change: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Change:
    """Change the extrinsics of scans; a depth map has none."""
    return lambda view: (
        None if view.is_map else replace(view, extrinsics=change(view.extrinsics.copy()))
    )


def with_camera(focal: float = 1.0, centre: float = 1.0, **lens: Lens) -> Change:
    """Change the focal length, the principal point or the lens."""

    def change(view: View) -> View:
        matrix = view.intrinsics.copy()
        matrix[[0, 1], [0, 1]] *= focal
        matrix[:2, 2] *= centre
        return replace(view, intrinsics=matrix, **lens)

    return change


def moved(metres: float, axis: int) -> Change:
    """Move the LiDAR along an axis of the camera."""

    def change(view: View) -> View:
        extrinsics = view.extrinsics.copy()
        extrinsics[axis, 3] += metres
        return view.near(extrinsics=extrinsics)

    return change


def flipped(*way: slice) -> Change:
    """Flip the answer to the image."""
    return lambda view: replace(
        view, answer=Answer(view.answer.boundary[way], view.answer.log_depth[way])
    )


def times(factor: float) -> Change:
    """Scale the returns."""
    return lambda view: replace(view, points=view.points * np.float32(factor))


def mapped(change: Callable[[NDArray[np.float32]], NDArray[np.float32]]) -> Change:
    """Change the returns of depth maps."""
    return lambda view: replace(view, points=change(view.points)) if view.is_map else None


def upside_down(view: View) -> View | None:
    """Turn the image, as the model sees it."""
    answer = view.others(UPSIDE_DOWN)
    right = {UPSIDE_DOWN: view.answer}
    return None if answer is None else replace(view, answer=answer, others=right.get)


TO_CAMERA = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])
BARREL = {k1: Lens.of("plumb_bob", (k1, 0, 0, 0)) for k1 in (-0.1, -0.2, -0.3, -0.4)}
# Each reading with faults from small to large, in words and as a change of a right view.
WRONG: dict[str, dict[str, Change]] = {
    "turned": {
        **{f"yaw {a:g}": (lambda view, a=a: turned(view, (a, 0, 0))) for a in (0.5, 1, 1.5)},
        **{f"pitch {a:g}": (lambda view, a=a: turned(view, (0, a, 0))) for a in (0.5, 1, 1.5)},
    },
    "inverse_extrinsics": {"the inverse": with_extrinsics(np.linalg.inv)},
    "swapped_axes": {"axes swapped": with_extrinsics(lambda given: TO_CAMERA.T @ given)},
    "turned_lidar": {"half a turn": with_extrinsics(lambda given: given @ np.diag([-1, -1, 1, 1]))},
    "image_size": {f"{s:g} times the size": with_camera(s, s) for s in (0.8, 1.25, 0.5, 2.0)},
    "mirrored": {"mirrored": flipped(np.s_[:], np.s_[::-1])},
    "depth_upside_down": {"rows in reverse": flipped(np.s_[::-1], np.s_[:])},
    "image_upside_down": {"upside down": upside_down},
    "unit": {f"{s:g} times": times(s) for s in (2.56, 3.9, 10, 100)},
    "inverse_depth": {"1 / depth": mapped(lambda points: points * 100 / points[:, 2:] ** 2)},
    "range_instead_of_depth_along_axis": {
        "range": mapped(
            lambda points: points * np.linalg.norm(points, axis=1)[:, None] / points[:, 2:]
        )
    },
    "other_lens": {
        f"k1 {k1:g} of rectified images": with_camera(lens=each) for k1, each in BARREL.items()
    },
    "focal_length": {f"{f:g} times": with_camera(f) for f in (0.95, 1.05, 0.9, 1.1, 0.8, 1.25)},
    "other_camera": {f"{m:g} m beside": moved(m, 0) for m in (0.12, 0.24, 0.54)},
    "delay_or_ahead": {f"{m:g} m ahead": moved(m, 2) for m in (0.5, 1, 2)},
}
WRONG["depth_camera"] = {f"{1 / f:.2g} times": with_camera(f) for f in (0.9, 1.1, 0.8, 1.25, 1.6)}


def report_readings(name: str, views: Sequence[View], smallest: dict[str, list[str]]) -> None:
    """Print false alarms, and add the smallest fault of each reading that is found."""
    alarms, silent, windows = 0, 0, 0
    judging = Judge()
    for number, view in enumerate(views, 1):
        judging.add(view)
        if number >= min(FIRST_FRAMES, len(views)):
            windows += 1
            found = {each.name for each in judging.judgement().findings}
            silent += NO_EVIDENCE in found
            alarms += bool(found - {NO_EVIDENCE})
    print(f"  {name}: {windows} windows, {alarms} false alarms, {silent} not judged", flush=True)
    some = views[:: -(-len(views) // FIRST_FRAMES)]
    for row, faults in WRONG.items():
        for words, change in faults.items():
            wrong = [change(view) for view in some]
            if any(each is None for each in wrong):
                continue
            judging = Judge()
            for each in wrong:
                judging.add(each)
            findings = judging.judgement().findings
            if findings and findings[0].name == row:
                smallest[row].append(f"{words} ({name})")
                break


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--model", default=None)
    parser.add_argument("--sets", type=int, default=4, help="most sets of a rig and size")
    args = parser.parse_args()
    random = np.random.default_rng(2)
    found: dict[tuple[str, int], list[Measured | None]] = {}
    smallest: dict[str, list[str]] = {each: [] for each in WRONG}
    with (
        tempfile.TemporaryDirectory() as scratch,
        Predictor(args.model, threads=1, warmup=0) as predictor,
    ):
        for name, source in open_rigs(args.data, Path(scratch)):
            with source:
                views, frame = read_rig(source, predictor)
            report_readings(name, views, smallest)
            if views[0].is_map or name == NIGHT:
                continue
            for size in SIZES if len(views) >= SIZES[1] else SIZES[:1]:
                sets = disjoint(views, size, args.sets)
                starts = random.uniform(-WRONG_DEGREES, WRONG_DEGREES, (len(sets), 3))
                found[name, len(sets[0])] = [
                    measure(name, each, wrong) for each, wrong in zip(sets, starts, strict=True)
                ]
            report_verdicts(name, views, frame)
    report_coverage(found)
    for row, places in smallest.items():
        print(f"| `{row}` | {'; '.join(places) or 'none'} |")


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
    calibration = frame.calibration
    assert calibration is not None
    right = judge(list(some), calibration, frame).verdict
    step = max(1, (len(views) - 1) // SIZES[1])
    shifted = [
        replace(view, points=after.points, beside={"the frame before": view.points})
        for view, after in list(itertools.pairwise(views))[::step]
    ]
    paired = judge(shifted, calibration, frame).verdict
    print(f"  {name}: right calibration: {right}; scans of the next frames: {paired}", flush=True)


if __name__ == "__main__":
    main()
