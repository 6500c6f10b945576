"""What of a frame's depth is fed to a network and what is its target: one rule for all.

Training and evaluation split a frame by the same function, `split_lidar`.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from runtime.errors import InputError
from runtime.projection import OcclusionFilter
from training.datasets.sample import Sample, nothing_known
from training.lidar.simulate import SENSOR_LINES, is_kept, random_share, scan_lines

Depth = NDArray[np.float32]


@dataclass(frozen=True)
class LidarInput:
    """A LiDAR of so many lines, a random share of the measurements, the set's own, or none.

    lines: a divisor of 64, for "lines". share: 0..1, of the pixels of dense depth, of the returns
    of recorded depth, for "random".
    """

    kind: Literal["own", "lines", "random", "none"] = "own"
    lines: int = 0
    share: float = 0.0

    @classmethod
    def parse(cls, text: str) -> "LidarInput":
        """Read "64", "random:0.05", "none" or "own". Raises InputError."""
        if text in ("own", "none"):
            return cls("own" if text == "own" else "none")
        word, _, number = text.partition(":")
        try:
            if word == "random" and 0 < float(number) <= 1:
                return cls("random", share=float(number))
            if not number and int(word) > 0 and SENSOR_LINES % int(word) == 0:
                return cls("lines", lines=int(word))
        except ValueError:
            pass
        raise InputError(
            f"the LiDAR {text!r} is not known; expected a number of lines that divides "
            f"{SENSOR_LINES}, random:SHARE with a share above 0 and up to 1, none, or own."
        )

    def __str__(self) -> str:
        """The text that `parse` reads."""
        return {
            "own": "own",
            "none": "none",
            "lines": str(self.lines),
            "random": f"random:{self.share:g}",
        }[self.kind]


class LidarSplit(NamedTuple):
    """A frame with the depth to feed and its target, float32 (H, W), metres, 0 = none."""

    sample: Sample
    fed: Depth
    target: Depth


def split_lidar(
    sample: Sample,
    lidar: LidarInput,
    rng: Generator,
    *,
    same_target: bool = True,
    first_line: int = 0,
) -> LidarSplit | None:
    """Choose what of a frame's depth is fed and what is the target; None if it cannot be done.

    - An input recorded beside its target: all of it ("own"), a random share of its returns, or the
      lines asked for where its scan lines are known. The target stays as it is.
    - A recorded scan alone: some of its returns are fed, others are the target, less those hidden
      behind nearer ones. With ``same_target``, for evaluation, the odd lines are the target
      whatever is fed, so that LiDARs compare, and the even ones may be fed: all ("own", 32), every
      second of them (16), and so on, or a random share. Without, for training, the target is what
      is not fed. 64 lines would leave no target.
    - Dense depth: simulated lines ("own" is 64; they need intrinsics) or a random share of the
      pixels is fed. The target is all of it.
    - No depth: nothing is fed, whatever was asked for.

    ``first_line`` shifts which lines of a recorded scan are kept.
    """
    lines = lidar.lines if lidar.kind == "lines" else None
    if sample.sparse_depth is not None:
        if lines is not None and sample.scan_line is None:
            return None
        fed = _thin(sample.sparse_depth, sample.scan_line, lidar, rng, first_line)
        return LidarSplit(sample, fed, sample.depth)
    if sample.scan_line is not None:
        half = SENSOR_LINES // 2
        if lines is not None and lines > half:
            return None
        to_feed = sample.depth
        if same_target or lidar.kind == "own":
            to_feed = masked(sample.depth, is_kept(sample.scan_line + first_line, half))
        fed = _thin(to_feed, sample.scan_line, lidar, rng, first_line)
        target = masked(sample.depth, (to_feed if same_target else fed) == 0)
        return LidarSplit(sample, fed, OcclusionFilter().apply(target, sample.depth))
    if lidar.kind in ("own", "lines") and sample.depth.any():
        if sample.intrinsics is None:
            return None
        fed = scan_lines(sample.depth, sample.intrinsics, lines or SENSOR_LINES, rng)
        return LidarSplit(sample, fed, sample.depth)
    return LidarSplit(sample, _thin(sample.depth, None, lidar, rng, 0), sample.depth)


def frame_generator(index: int) -> Generator:
    """Return a frame's own random numbers: the same whatever else is evaluated."""
    return np.random.default_rng([0, index])


def masked(depth: Depth, kept: NDArray[np.bool_]) -> Depth:
    """Return the depth where ``kept``, 0 elsewhere."""
    return np.where(kept, depth, np.float32(0))


def _thin(
    depth: Depth,
    scan_line: NDArray[np.int16] | None,
    lidar: LidarInput,
    rng: Generator,
    first_line: int,
) -> Depth:
    """What the LiDAR leaves of the measurements."""
    if lidar.kind == "none":
        return nothing_known((depth.shape[0], depth.shape[1]))
    if lidar.kind == "random":
        return random_share(depth, lidar.share, rng)
    if lidar.kind == "lines" and scan_line is not None:
        return masked(depth, is_kept(scan_line + first_line, lidar.lines))
    return depth
