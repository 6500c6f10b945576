"""Street frames, synthetic and recorded, for comparing two implementations."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.contract.contract import MIN_SIDE, farthest_return
from runtime.contract.resize import move_returns, resize_image
from runtime.recordings.bundled_stream import bundled_frames


@dataclass(frozen=True)
class ProbeFrame:
    """A named frame: rgb uint8 (H, W, 3), sparse_depth float32 (H, W) in metres."""

    name: str
    rgb: NDArray[np.uint8]
    sparse_depth: NDArray[np.float32]


def probe_frames(size: tuple[int, int], *, max_depth_m: float) -> list[ProbeFrame]:
    """Return two scenes with scan lines; the second also with an empty, full and faulty depth map.

    Args:
        size: (height, width).
        max_depth_m: range of the network. The faulty map has NaN, Inf, negative values and values
            beyond the range among valid ones.
    """
    frames = []
    for seed in (0, 1):
        rgb, depth = _street(size, seed=seed, max_depth_m=max_depth_m)
        frames.append(ProbeFrame(f"scan lines {seed}", rgb, _scan_lines(depth, seed=seed)))
    frames.append(ProbeFrame("empty", rgb, np.zeros_like(depth)))
    frames.append(ProbeFrame("full", rgb, depth))
    faulty = _scan_lines(depth, seed=seed)
    clipped_m = (max_depth_m + farthest_return(max_depth_m)) / 2
    no_return_m = 2 * farthest_return(max_depth_m)
    faults = np.array([np.nan, np.inf, -np.inf, -5.0, clipped_m, no_return_m], dtype=np.float32)
    rng = np.random.default_rng(seed)
    hit = rng.random(size) < 0.05
    faulty[hit] = rng.choice(faults, size=int(hit.sum()))
    frames.append(ProbeFrame("faulty", rgb, faulty))
    return frames


def frames_of(size: tuple[int, int], *, dynamic: bool, max_depth_m: float) -> list[ProbeFrame]:
    """Return frames of the native size; for a free size also of two other sizes, one odd."""
    sizes = [size]
    if dynamic:
        sizes.append((max(size[0] // 2 | 1, MIN_SIDE), max(size[1] // 2 | 1, MIN_SIDE)))
        sizes.append((MIN_SIDE + 1, MIN_SIDE + 31))
    return [frame for each in sizes for frame in probe_frames(each, max_depth_m=max_depth_m)]


def recorded_frames(size: tuple[int, int]) -> list[ProbeFrame]:
    """Return frames of the bundled recording at a (height, width)."""
    return [
        ProbeFrame(each.name, resize_image(each.rgb, size), move_returns(each.sparse_depth, size))
        for each in bundled_frames()[::5]
    ]


def _street(
    size: tuple[int, int], *, seed: int, max_depth_m: float
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Return a textured ground plane with boxes under a sky, and its dense depth."""
    rng = np.random.default_rng(seed)
    height, width = size
    rows = np.arange(height, dtype=np.float32)[:, None].repeat(width, axis=1)
    horizon = height * rng.uniform(0.3, 0.5)
    below = np.maximum(rows - horizon, 1e-3)
    depth = np.minimum(1.6 * height / below, 0.9 * max_depth_m).astype(np.float32)
    picture = np.where(rows[..., None] > horizon, rng.uniform(60, 120, 3), rng.uniform(150, 230, 3))
    for distance in np.sort(rng.uniform(0.05, 0.6, 12))[::-1] * max_depth_m:
        foot = int(min(horizon + 1.6 * height / distance, height))
        box_height = int(rng.uniform(2, 8) * height / distance)
        box_width = int(rng.uniform(1, 6) * height / distance) + 1
        left, top = int(rng.integers(-box_width, width)), max(foot - box_height, 0)
        box = np.s_[top:foot, max(left, 0) : max(left + box_width, 0)]
        picture[box] = rng.uniform(0, 255, 3)
        depth[box] = distance
    for cells in (8, 32, 128):
        noise = rng.normal(0, 12, (cells, 2 * cells, 3))
        picture += cv2.resize(noise, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.clip(picture, 0, 255).astype(np.uint8), depth


def _scan_lines(depth: NDArray[np.float32], *, seed: int) -> NDArray[np.float32]:
    """Sample a dense depth map like a spinning LiDAR: sloping lines with drop-outs."""
    rng = np.random.default_rng(seed)
    rows, columns = np.indices(depth.shape)
    on_line = (rows + columns // 64) % 4 == 0
    seen = on_line & (rows > 0.3 * depth.shape[0]) & (rng.random(depth.shape) < 0.5)
    noisy = depth + rng.normal(0, 0.02, depth.shape)
    return np.where(seen, noisy, 0).astype(np.float32)
