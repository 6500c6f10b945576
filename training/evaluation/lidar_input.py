"""Which LiDAR a network is fed for an evaluation, and what can be wrong with it."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from runtime.errors import InputError
from training.datasets.kitti_lidar import withhold_occluded
from training.datasets.sample import Sample, nothing_known
from training.lidar import random_share, scan_lines
from training.loading.augment import keep_every_line, masked

Depth = NDArray[np.float32]
Fault = Literal["none", "nan", "shift", "dropout"]

#: Share of the measurements that the fault "nan" makes NaN, infinite or negative.
NAN_SHARE = 0.3
#: How far the fault "shift" moves the whole scan: right and down [share of the width].
SHIFT = (0.01, 0.004)
#: Share of the width, in the middle, whose measurements the fault "dropout" takes away.
DROPOUT_SHARE = 1 / 3


class LidarSplit(NamedTuple):
    """A frame with the depth to feed and the depth to score, float32 (H, W), metres, 0 = none."""

    sample: Sample
    fed: Depth
    target: Depth


@dataclass(frozen=True)
class LidarInput:
    """A LiDAR of so many lines, a random share of the pixels, the set's own input, or none."""

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
            if not number and int(word) > 0 and 64 % int(word) == 0:
                return cls("lines", lines=int(word))
        except ValueError:
            pass
        raise InputError(
            f"--lidar {text!r}; expected a number of lines that divides 64, random:SHARE with a "
            "share above 0 and up to 1, none, or own."
        )

    def __str__(self) -> str:
        """The text that `parse` reads."""
        return {
            "own": "own",
            "none": "none",
            "lines": str(self.lines),
            "random": f"random:{self.share:g}",
        }[self.kind]

    def split(self, sample: Sample, rng: Generator) -> LidarSplit | None:
        """Choose what of a frame's depth is fed and what is scored; None if it cannot be done.

        The scored pixels do not depend on the LiDAR, so that rows of a table compare.

        - Dense depth: all of it is scored. "own" is 64 simulated lines.
        - A recorded scan: its odd lines, less the returns hidden behind nearer ones, are scored,
          and the even ones are fed: all of them ("own", 32), every second of them (16), and so
          on, or a random share of their returns. 64 lines would leave nothing to score.
        - An input recorded beside its target: as it is ("own") or a random share of its returns.
        - No depth: neither.
        """
        if not sample.depth.any():
            return LidarSplit(sample, nothing_known(sample.size), sample.depth)
        if sample.scan_line is not None:
            even = keep_every_line(sample, 2, 0)
            target = withhold_occluded(masked(sample.depth, even == 0), sample.depth)
            if self.kind == "lines" and self.lines > 32:
                return None
            step = 64 // self.lines if self.kind == "lines" else 2
            fed = keep_every_line(sample, step, 0)
        elif sample.sparse_depth is not None:
            if self.kind == "lines":
                return None
            fed, target = sample.sparse_depth, sample.depth
        else:
            target = sample.depth
            if self.kind == "random":
                return LidarSplit(sample, random_share(sample.depth, self.share, rng), target)
            if sample.intrinsics is None:
                return None
            lines = self.lines if self.kind == "lines" else 64
            fed = scan_lines(sample.depth, sample.intrinsics, lines, rng)
        if self.kind == "none":
            fed = nothing_known(sample.size)
        if self.kind == "random":
            fed = random_share(fed, self.share, rng)
        return LidarSplit(sample, fed, target)


def split_lidar(sample: Sample) -> LidarSplit:
    """Choose what is fed and scored of a frame as the set itself has it, see `LidarInput.split`.

    Raises ValueError for dense depth without intrinsics.
    """
    frame = LidarInput("own").split(sample, np.random.default_rng(0))
    if frame is None:
        raise ValueError(f"{sample.name} has dense depth but no intrinsics to draw scan lines with")
    return frame


def add_fault(fed: Depth, fault: Fault, rng: Generator) -> Depth:
    """Return a damaged copy of a sparse depth map float32 (H, W) [m], 0 = none.

    "nan": `NAN_SHARE` of the measurements are NaN, infinite or negative, a third each. "shift":
    the scan lies `SHIFT` beside its place, as after a knock on the sensor. "dropout": the middle
    `DROPOUT_SHARE` of the picture has no measurement. "none": nothing is wrong.
    """
    damaged = fed.copy()
    width = fed.shape[1]
    if fault == "nan":
        row, column = np.nonzero(fed)
        hit = rng.random(len(row)) < NAN_SHARE
        nonsense = np.array([np.nan, np.inf, -1.0], dtype=np.float32)
        damaged[row[hit], column[hit]] = nonsense[rng.integers(0, 3, int(hit.sum()))]
    elif fault == "shift":
        across, down = (max(1, round(part * width)) for part in SHIFT)
        damaged = np.zeros_like(fed)
        damaged[down:, across:] = fed[:-down, :-across]
    elif fault == "dropout":
        start = round((1 - DROPOUT_SHARE) / 2 * width)
        damaged[:, start : width - start] = 0
    return damaged
