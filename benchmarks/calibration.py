"""Is the answer of ssdnet-calibrate as sure as it says? Rigs whose calibration is known.

    python benchmarks/calibration.py --data DIR [--model NAME] [--sets N]

DIR holds kitti_streets, kitti_drive_0009, kitti_stream, kitti_object, pandaset_front (its LiDAR
all around) and view_of_delft; what is missing is left out. Of each rig the sets of 5 successive
frames and of 20 spread ones are disjoint: starting again on the same frames would be no new trial.
Each set starts from a rotation that is wrong by up to 2 degrees in each axis.

A line for each rig and number of frames: trials; the median and the largest deviation of yaw,
pitch and roll from the known calibration; trials in which all axes that are seen lie within the
stated uncertainty; its medians; trials in which yaw and pitch are not seen. Then the verdict with
the right calibration, and with the scans of the next frames.
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

from runtime import CalibrationResult, Predictor, open_source
from runtime.alignment.calibrate import judge
from runtime.alignment.figures import rotation
from runtime.alignment.pairing import Neighbours
from runtime.alignment.view import View, points_in_time, view_of
from runtime.recordings.source import Source
from runtime.streams.frame import Frame

WRONG_DEGREES, SIZES = 2.0, (5, 20)
KITTI = ("kitti_streets", "kitti_drive_0009", "kitti_stream")


@dataclass(frozen=True, eq=False)
class Trial:
    """A frame of a rig, ready for any number of trials."""

    frame: Frame
    view: View
    points: NDArray[np.float32]


def open_rigs(data: Path, scratch: Path) -> Iterator[tuple[str, Source]]:
    """Yield the recordings that are there."""
    calibrations = {"kitti_streets": "kitti_streets/calib.txt"}
    for name in KITTI:
        if (root := data / name).is_dir():
            points, calibration = root / "velodyne_fov", data / calibrations.get(name, name)
            images = root / "image_02"
            yield name, open_source("folders", images, points=points, calibration=calibration)
    folders = (
        ("kitti_object", "image_2", "velodyne_fov"),
        ("view_of_delft", "image", "velodyne"),
    )
    for name, images, scans in folders:
        if (root := data / name).is_dir():
            given = {"points": root / scans, "calibration": root / "calib"}
            yield name, open_source("folders", root / images, **given)
    if (root := data / "pandaset_front").is_dir():
        camera = json.loads((root / "intrinsics.json").read_text())
        rows = [[camera["fx"], 0, camera["cx"]], [0, camera["fy"], camera["cy"]], [0, 0, 1]]
        toml = scratch / "panda.toml"
        toml.write_text(f'intrinsics = {rows}\npoints_in = "camera"\n')
        for path in (root / "points").glob("*.bin"):
            points = np.fromfile(path, np.float32).reshape(-1, 6)
            np.save(scratch / f"{path.stem}.npy", points[points[:, 4] == 0, :3])
        given = {"points": scratch, "calibration": toml}
        yield root.name, open_source("folders", root / "image", **given)


def read_rig(source: Source, predictor: Predictor) -> list[Trial]:
    """Answer every frame with a scan."""
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


def judge_set(
    trials: Sequence[Trial],
    wrong: NDArray[np.float64],
    neighbours: Sequence[Neighbours] | None = None,
) -> CalibrationResult:
    """Judge some frames with a rotation that is wrong by these angles."""
    views = []
    for trial in trials:
        extrinsics = trial.view.calibration.extrinsics.copy()
        extrinsics[:3, :3] = rotation(wrong) @ extrinsics[:3, :3]
        calibration = replace(trial.view.calibration, extrinsics=extrinsics)
        views.append(trial.view.with_scan(trial.points, calibration))
    beside = list(neighbours or [(None, None)] * len(views))
    scans = [trial.points for trial in trials]
    return judge(views, scans, beside, views[0].calibration, trials[0].frame)


def disjoint(trials: Sequence[Trial], size: int, most: int) -> list[Sequence[Trial]]:
    """Sets of so many frames, each frame in one: 5 successive ones, or 20 spread ones."""
    count = max(1, len(trials) // size)
    if size == SIZES[0]:
        step = -(-count // most)
        return [trials[size * each : size * (each + 1)] for each in range(0, count, step)]
    return [trials[each::count][:size] for each in range(count)][:most]


def deviation(result: CalibrationResult, wrong: NDArray[np.float64]) -> NDArray[np.float64]:
    """What is left of a rotation by these angles after the correction, degrees."""
    assert result.off_degrees is not None
    return np.asarray(result.off_degrees - wrong)


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
    with (
        tempfile.TemporaryDirectory() as scratch,
        Predictor(args.model, threads=1, warmup=0) as predictor,
    ):
        for name, source in open_rigs(args.data, Path(scratch)):
            with source:
                trials = read_rig(source, predictor)
            for size in SIZES if len(trials) >= SIZES[1] else SIZES[:1]:
                report_size(name, disjoint(trials, size, args.sets), random)
            report_verdicts(name, trials)


def report_size(name: str, sets: list[Sequence[Trial]], random: np.random.Generator) -> None:
    """Print the line of a rig and a number of frames."""
    left, within, covered, unseen = [], [], 0, 0
    for each in sets:
        wrong = random.uniform(-WRONG_DEGREES, WRONG_DEGREES, 3)
        result = judge_set(each, wrong)
        if result.off_degrees is None or result.within_degrees is None:
            unseen += 1
            continue
        left.append(deviation(result, wrong))
        within.append(result.within_degrees)
        covered += bool((np.abs(left[-1]) <= within[-1]).all())
    line = f"| {name} | {len(sets[0])} | {len(sets)} | "
    if left:
        stated = ", ".join(f"{each:.2f}" for each in np.median(within, axis=0))
        line += f"{cell(left)} | {covered} of {len(left)} | {stated} | "
    else:
        line += "| | | "
    print(f"{line}{unseen} |", flush=True)


def report_verdicts(name: str, trials: Sequence[Trial]) -> None:
    """Print the verdicts with the right calibration, and with the scans of the next frames."""
    (some,) = disjoint(trials, SIZES[1], 1)
    right = judge_set(some, np.zeros(3)).verdict
    later = [replace(trial, points=after.points) for trial, after in itertools.pairwise(trials)]
    shifted = [replace(each, view=each.view.with_scan(each.points)) for each in later]
    beside: list[Neighbours] = [(trial.points, None) for trial in trials[:-1]]
    step = max(1, len(shifted) // SIZES[1])
    paired = judge_set(shifted[::step], np.zeros(3), beside[::step])
    print(f"  {name}: right calibration: {right}; scans of the next frames: {paired.verdict}")


if __name__ == "__main__":
    main()
