"""The LiDAR input of a frame, simulated or a part of what was recorded; the rest is the target.

Training and evaluation split a frame by the same function, `split_lidar`.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from runtime.base.errors import InputError
from training.datasets.sample import Sample, nothing_known
from training.lidar.simulate import SENSOR_LINES, Depth, is_kept, random_share, scan_lines


@dataclass(frozen=True)
class OcclusionFilter:
    """Removes returns that the camera cannot see because something nearer is in front of them.

    A LiDAR above or beside the camera looks past near objects, so far returns show through them in
    the projection. A return at depth d is removed if one nearer than `d * (1 - relative_gap) -
    gap_m` lies in the window around it. Background seen right beside an object's edge goes too;
    surfaces at a grazing angle stay.

    Attributes:
        window: (height, width), odd, pixels. The default bridges the gap between two of 64 scan
            lines in images of 1242 x 375.
        relative_gap: share of the depth.
        gap_m: metres.
    """

    window: tuple[int, int] = (15, 9)
    relative_gap: float = 0.1
    gap_m: float = 0.5

    def apply(self, target: Depth, returns: Depth) -> Depth:
        """Return a depth map without its hidden returns.

        Args:
            target: float32 (H, W), metres, 0 = none.
            returns: float32 (H, W), metres: all returns of the frame, whatever part of them
                `target` holds.

        Returns:
            float32 (H, W), a new array.
        """
        measured = np.where(returns > 0, returns, np.float32(np.inf))
        nearest = cv2.erode(measured, np.ones(self.window, dtype=np.uint8))
        visible = nearest >= target * np.float32(1 - self.relative_gap) - np.float32(self.gap_m)
        return np.where(visible, target, np.float32(0))


@dataclass(frozen=True)
class LidarInput:
    """The LiDAR input: the set's own, scan lines, a random share of the measurements, or none.

    Attributes:
        lines: a divisor of 64, for "lines".
        share: 0 to 1, for "random": of the pixels of dense depth, or of the returns of recorded
            depth.
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
            f"unknown LiDAR {text!r}; expected a number of lines that divides "
            f"{SENSOR_LINES}, random:SHARE with a share above 0 and up to 1, none, or own"
        )

    def thin(self, depth: Depth, scan_line: NDArray[np.int16] | None, rng: Generator) -> Depth:
        """Return the measurements that are part of the input; `scan_line` is that of each pixel."""
        if self.kind == "none":
            return nothing_known((depth.shape[0], depth.shape[1]))
        if self.kind == "random":
            return random_share(depth, self.share, rng)
        if self.kind == "lines" and scan_line is not None:
            return masked(depth, is_kept(scan_line, self.lines))
        return depth

    def __str__(self) -> str:
        """The text that `parse` reads."""
        texts = {"lines": str(self.lines), "random": f"random:{self.share:g}"}
        return texts.get(self.kind, self.kind)


class LidarSplit(NamedTuple):
    """A frame with its depth input and target, float32 (H, W), metres, 0 = none."""

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
    """Split the depth of a frame into input and target.

    - An input recorded beside its target: all of it ("own"), a random share of its returns, or the
      requested lines if its scan lines are known. The target does not change.
    - Only a recorded scan: some of its returns are the input, the others the target, without
      occluded ones. With `same_target`, for evaluation, the odd lines are always the target, so
      that scores of LiDARs compare, and the input is from the even ones: all ("own", 32), every
      second of them (16), and so on, or a random share. Without, for training, all other returns
      are the target. 64 lines would leave no target.
    - Dense depth: the input is simulated lines ("own" is 64; they need intrinsics) or a random
      share of the pixels. The target is all of it.
    - No depth: no input.

    Args:
        sample: a frame.
        lidar: the requested input.
        rng: for random shares and simulated lines.
        same_target: see above.
        first_line: shift of the lines that are kept of a recorded scan.

    Returns:
        The split, or None if the frame cannot give this input.
    """
    lines = lidar.lines if lidar.kind == "lines" else None
    returns = sample.returns
    scan_line = None if sample.scan_line is None else sample.scan_line + first_line
    if returns is not None and not sample.is_scan:
        if lines is not None and scan_line is None:
            return None
        fed = lidar.thin(returns, scan_line, rng)
        return LidarSplit(sample, fed, sample.depth)
    if returns is not None and scan_line is not None:
        half = SENSOR_LINES // 2
        if lines is not None and lines > half:
            return None
        to_feed = returns
        if same_target or lidar.kind == "own":
            to_feed = masked(returns, is_kept(scan_line, half))
        fed = lidar.thin(to_feed, scan_line, rng)
        target = masked(returns, (to_feed if same_target else fed) == 0)
        return LidarSplit(sample, fed, OcclusionFilter().apply(target, returns))
    if lidar.kind in ("own", "lines") and sample.depth.any():
        if sample.intrinsics is None:
            return None
        fed = scan_lines(sample.depth, sample.intrinsics, lines or SENSOR_LINES, rng)
        return LidarSplit(sample, fed, sample.depth)
    return LidarSplit(sample, lidar.thin(sample.depth, None, rng), sample.depth)


def frame_generator(index: int) -> Generator:
    """Return the random numbers of a frame, independent of other frames."""
    return np.random.default_rng([0, index])


def masked(depth: Depth, kept: NDArray[np.bool_]) -> Depth:
    """Return the depth where `kept`, 0 elsewhere."""
    return np.where(kept, depth, np.float32(0))
