"""Changes of a sample's pixels: magnified, cropped, resized and mirrored maps and intrinsics."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from runtime.contract.resize import (
    RESIZE,
    move_returns,
    move_scan_lines,
    resize_image,
    resize_nearest,
)
from training.datasets.sample import Sample, make_frame, target_kind
from training.loading.augment_config import AugmentConfig
from training.loading.depth_values import has_dense_depth, scale_depth

# The value of unknown pixels, for each channel if there are several.
Fill = float | Sequence[float]
# RGB of padding: the mean colour by which networks normalise.
_FILL_RGB = (124, 116, 104)


def scale_and_crop(
    sample: Sample,
    config: AugmentConfig,
    rng: Generator,
    *,
    is_closer: bool = False,
    rare: Sequence[int] = (),
) -> Sample:
    """Magnify by a random factor and cut a random window of `config.drawn_size`.

    Some windows are chosen for the classes `rare`, see `AugmentConfig.rare_crops`. Padding has
    the mean colour, no depth and no label. The factor scales the intrinsics; if `is_closer`, it
    divides the depth instead.
    """
    scale = float(np.exp(rng.uniform(*np.log(config.scale))))
    height, width = config.drawn_size
    window = (round(height / scale), round(width / scale))  # in pixels of the sample
    chosen = rare and config.rare_crops and rng.random() < config.rare_crops
    count = config.crop_candidates if chosen else 1
    offsets = [_random_offset(sample.size, window, rng) for _ in range(count)]
    top, left = choose_crop(sample.semantic, window, offsets, rare)
    is_dense = has_dense_depth(sample)  # before cropping: a crop of dense depth may be mostly sky
    sample = resize(cut(sample, top, left, window), config.drawn_size, is_dense=is_dense)
    return scale_depth(sample, 1 / scale) if is_closer else sample


def _change_maps(
    sample: Sample,
    change: Callable[[NDArray[Any], Fill], NDArray[Any]],
    intrinsics: NDArray[np.float64] | None,
) -> Sample:
    """Apply `change(map, fill)` to every map of a sample; fill: the value of unknown pixels."""

    def change_known(array: NDArray[Any] | None, unknown: Fill) -> NDArray[Any] | None:
        return None if array is None else change(array, unknown)

    rgb, returns = change(sample.rgb, _FILL_RGB), change_known(sample.returns, 0)
    targets = {
        name: change(labels, target_kind(name).unlabelled)
        for name, labels in sample.targets.items()
    }
    frame = make_frame(rgb, sample.name, returns=returns, intrinsics=intrinsics)
    scan_line = change_known(sample.scan_line, -1)
    return replace(sample, frame=frame, targets=targets, scan_line=scan_line)


def cut(sample: Sample, top: int, left: int, window: tuple[int, int]) -> Sample:
    """Cut (height, width) at (top, left); the window may reach beyond the image."""
    intrinsics = sample.intrinsics
    if intrinsics is not None:
        intrinsics = intrinsics - np.array([[0, 0, left], [0, 0, top], [0, 0, 0]], np.float64)
    height, width = window

    def take(array: NDArray[Any], fill: Fill) -> NDArray[Any]:
        inner = array[max(top, 0) : top + height, max(left, 0) : left + width]
        above, before = max(-top, 0), max(-left, 0)
        below, behind = height - above - inner.shape[0], width - before - inner.shape[1]
        border = cv2.BORDER_CONSTANT
        return cv2.copyMakeBorder(inner, above, below, before, behind, border, value=fill)

    return _change_maps(sample, take, intrinsics)


def resize(sample: Sample, size: tuple[int, int], *, is_dense: bool | None = None) -> Sample:
    """Resize to (height, width) by the engine's rule, see `runtime.contract.resize`.

    Labels are resized by the rule of their head, dense depth by nearest neighbour. Recorded returns
    are moved one by one: none is duplicated, and of several on a pixel the nearest is kept.
    `is_dense`: whether the depth is dense; None: by its share of known pixels.
    """
    if size == sample.size:
        return sample
    fx, fy = size[1] / sample.size[1], size[0] / sample.size[0]

    intrinsics = sample.intrinsics
    if intrinsics is not None:
        # Pixel centres are integers in K: u' = (u + 0.5) f - 0.5.
        cx, cy = (intrinsics[0, 2] + 0.5) * fx - 0.5, (intrinsics[1, 2] + 0.5) * fy - 0.5
        intrinsics = np.array(
            [[intrinsics[0, 0] * fx, 0, cx], [0, intrinsics[1, 1] * fy, cy], [0, 0, 1]]
        )
    returns, scan_line = sample.returns, sample.scan_line
    rules = {name: RESIZE[target_kind(name).resize] for name in sample.targets}
    if "depth" in rules:
        if is_dense is None:
            is_dense = has_dense_depth(sample)
        rules["depth"] = move_returns if returns is not None and not is_dense else resize_nearest
    if returns is not None and scan_line is not None:
        returns, scan_line = move_scan_lines(returns, scan_line, size)
    elif returns is not None:
        returns = move_returns(returns, size)
    rgb = resize_image(sample.rgb, size)
    frame = make_frame(rgb, sample.name, returns=returns, intrinsics=intrinsics)
    targets = {name: rules[name](labels, size) for name, labels in sample.targets.items()}
    return replace(sample, frame=frame, targets=targets, scan_line=scan_line)


def flip(sample: Sample) -> Sample:
    """Mirror left and right; the principal point moves with the pixels."""
    intrinsics = sample.intrinsics
    if intrinsics is not None:
        intrinsics = intrinsics.copy()
        intrinsics[0, 2] = sample.size[1] - 1 - intrinsics[0, 2]
    return _change_maps(sample, lambda array, _: cv2.flip(array, 1), intrinsics)


def _random_offset(
    size: tuple[int, int], window: tuple[int, int], rng: Generator
) -> tuple[int, int]:
    """Return a random (row, column) of a window's upper left corner.

    Along an axis where the window is larger than the image, it covers the whole image.
    """

    def start(room: int) -> int:
        return int(rng.integers(min(0, room), max(0, room) + 1))

    return start(size[0] - window[0]), start(size[1] - window[1])


def choose_crop(
    semantic: NDArray[np.uint8],
    window: tuple[int, int],
    offsets: Sequence[tuple[int, int]],
    classes: Sequence[int],
) -> tuple[int, int]:
    """Return the offset (top, left) whose window has most pixels of the classes.

    Ties keep the first, so that frames without labels are cut at random.

    Args:
        semantic: uint8 (H, W), class ids.
        window: (height, width) [px]; larger than the image, it covers it.
        offsets: the candidates.
        classes: ids of the rare classes.
    """
    if len(offsets) == 1:
        return offsets[0]
    is_rare = np.zeros(256, np.bool_)
    is_rare[list(classes)] = True
    rare = is_rare[semantic]
    height, width = window

    def count(offset: tuple[int, int]) -> int:
        top, left = offset
        return int(rare[max(top, 0) : top + height, max(left, 0) : left + width].sum())

    return max(offsets, key=count)
